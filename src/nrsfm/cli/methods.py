"""``nrsfm methods``: the methods, what they assume and what they cost."""

from __future__ import annotations

from collections.abc import Sequence

from nrsfm.cli.arguments import Parser
from nrsfm.cli.text import columns, to_json

_FACTS = ("title", "year", "summary", "assumes", "cost")


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm methods",
        usage="nrsfm methods [--json]",
        description="List the methods. The options of one: nrsfm reconstruct --method M --help",
    )
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    given = parser.parse_strictly(words)

    from nrsfm.methods import get_method, method_names

    methods = [get_method(name) for name in method_names()]
    if given.json:
        print(to_json([{"name": m.name} | {fact: getattr(m, fact) for fact in _FACTS} for m in methods]))
        return 0
    for method in methods:
        print(f"{method.name}: {method.title} ({method.year})")
        lines = [(f"  {fact}", " ".join(str(getattr(method, fact)).split())) for fact in _FACTS[2:]]
        print(columns(lines))
    return 0
