"""``nrsfm methods``: the methods, what they assume, what they need and what they cost."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.text import table, to_json

_FACTS = ("title", "year", "summary", "assumes", "needs", "cost", "camera_method")


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm methods",
        usage="nrsfm methods [--json]",
        description="List the methods. Cost in F frames, P points, K basis shapes (or cells, or subspaces), N virtual "
        "points (at most 2F a cell). The options of one: nrsfm reconstruct --method M --help",
    )
    parser.add_argument("--json", action="store_true", help="JSON in place of a table, with every fact")
    given = parser.parse_strictly(words)

    from nrsfm.methods import get_method, method_names

    methods = [get_method(name) for name in method_names()]
    if given.json:
        print(to_json([{"name": m.name} | {fact: _fact(m, fact) for fact in _FACTS} for m in methods]))
        return 0
    rows = [[m.name, str(m.year), _fact(m, "assumes"), _fact(m, "needs"), _fact(m, "cost")] for m in methods]
    width = min(shutil.get_terminal_size((120, 24)).columns, 160)
    print(table(["method", "year", "assumes", "needs", "cost"], rows, width))
    return 0


def _fact(method: Any, fact: str) -> Any:
    value = getattr(method, fact)
    return value if isinstance(value, int) else " ".join(str(value).split())
