"""``python -m benchmarks [SECTION ...]``: measure, print the tables, write docs/benchmarks.md."""

from __future__ import annotations

import argparse
import sys
import time

from benchmarks import store
from benchmarks.children import TaskError
from benchmarks.page import SECTIONS, section_lines, write_page


def main(words: list[str] | None = None) -> int:
    """Run the sections asked for, then rebuild the page from what is measured; it keeps what it has of the others."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "sections",
        nargs="*",
        metavar="SECTION",
        help=f"{', '.join(SECTIONS)}; 'all' (the default); or 'page', which only writes the page again",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=min(store.cores(), 4),
        help="processes for what is not timed, one thread each [default: %(default)s]; what is timed runs alone",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="WORD",
        help="only sequences, or parts of 'size', whose names hold a WORD; the page then goes to bench-output/",
    )
    parser.add_argument("--fresh", action="store_true", help="measure again what is kept and still holds")
    given = parser.parse_args(words)
    known = [*SECTIONS, "all", "page"]
    for name in given.sections:
        if name not in known:
            parser.error(f"section must be one of {', '.join(known)}, received '{name}'")
    if given.jobs < 1:
        parser.error(f"--jobs must be at least 1, received {given.jobs}")
    asked = given.sections or ["all"]
    wanted = [name for name in SECTIONS if name in asked or "all" in asked]
    context = store.Context(given.jobs, tuple(given.only), given.fresh)
    outcomes = {name: _run(name, context) for name in wanted}
    # A part of a section must not replace the whole of it unasked.
    missed, errors = write_page(trial=bool(given.only))
    for check in missed:
        store.say(f"missed: {check.what}: {check.cell()}")
    for outcome in outcomes.values():
        if outcome:
            store.say(outcome)
    return 1 if errors or any(outcome.startswith("FAILED") for outcome in outcomes.values()) else 0


def _run(name: str, context: store.Context) -> str:
    """Measure one section, keep it and print it; returns why not, where that is not possible."""
    start = time.perf_counter()
    try:
        values = SECTIONS[name].measure(context)
    except store.DataAbsentError as error:
        return f"SKIPPED {name}: {error}"
    except TaskError as error:
        return f"FAILED {name}: {error}"
    kept = store.read(name)
    if kept is None or kept["values"] != values:
        store.write(name, values)
    store.say(f"{name}: {time.perf_counter() - start:.0f} s in all")
    kept = store.read(name)
    if kept is not None:
        print("\n".join(section_lines(name, kept)), flush=True)
    return ""


if __name__ == "__main__":
    sys.exit(main())
