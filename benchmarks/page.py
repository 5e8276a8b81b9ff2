"""``docs/benchmarks.md``: every kept number, beside its target, written by rules."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from benchmarks import (
    ablation,
    accuracy,
    auto,
    auto_speed,
    calibration,
    literature,
    mocap,
    never_worse,
    quiet,
    real,
    repair_growth,
    robust,
    scaling,
    speed,
    start,
    store,
    tracking,
    viewer,
)
from benchmarks.tables import NO, YES, Check, Fact, table
from nrsfm.experiments.machine import in_words

SECTIONS: dict[str, ModuleType] = {
    "auto": auto,
    "never-worse": never_worse,
    "robust": robust,
    "calibration": calibration,
    "auto-ablation": ablation,
    "auto-speed": auto_speed,
    "repair-growth": repair_growth,
    "accuracy": accuracy,
    "real": real,
    "mocap": mocap,
    "literature": literature,
    "speed": speed,
    "scaling": scaling,
    "start": start,
    "tracking": tracking,
    "viewer": viewer,
}


def section_lines(name: str, kept: dict[str, Any]) -> list[str]:
    """One section as Markdown, with what it was measured with."""
    module = SECTIONS[name]
    return [f"## {module.TITLE}", "", f"Measured {kept['date']}.", "", *module.render(kept["values"])]


def write_page() -> tuple[list[Check | Fact], dict[str, str]]:
    """Write the page from what is kept; return the targets that were missed, and the runs that failed.

    A page with a section missing goes to ``bench-output/``, so that it does not replace a complete one.
    """
    from nrsfm.files.atomic import atomic_file

    kept = {name: found for name in SECTIONS if (found := store.read(name)) is not None}
    found = {name: SECTIONS[name].checks(kept[name]["values"]) for name in kept}
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench` (`python -m benchmarks`); do not edit. Every number was measured, with one set of",
        "defaults for every row; nothing was set by the name of a sequence. ✓ and ✗ compare the unrounded number with",
        "its target.",
        "",
        *_machines(kept),
        *_summary(kept, found),
    ]
    for name in SECTIONS:
        if name in kept:
            lines += section_lines(name, kept[name])
        else:
            lines += [f"## {SECTIONS[name].TITLE}", "", "**Not measured yet.**", ""]
    path = store.PAGE if len(kept) == len(SECTIONS) else store.OUTPUT / store.PAGE.name
    with atomic_file(path) as stream:
        stream.write(("\n".join(lines).rstrip() + "\n").encode())
    missing = [name for name in SECTIONS if name not in kept]
    store.say(f"{path.relative_to(store.ROOT)} is written{', without ' if missing else ''}{', '.join(missing)}")
    missed = [check for checks in found.values() for check in checks if not check.passed]
    return missed, _errors(kept)


def _machines(kept: dict[str, Any]) -> list[str]:
    """Each machine that something was measured on, and whether all of it was the same code."""
    by_machine: dict[str, list[str]] = {}
    for name, section in kept.items():
        text = in_words(section["machine"])
        by_machine.setdefault(text, []).append(name)
    lines = []
    for text, names in by_machine.items():
        whose = "Machine" if len(by_machine) == 1 else f"Machine for {', '.join(names)}"
        lines += [f"{whose}: {text}", ""]
    stale = [name for name, section in kept.items() if _digests(section) != {store.code_digest(name)}]
    if stale:
        lines += [f"**Measured with an earlier state of the code: {', '.join(stale)}.**", ""]
    return lines


def _digests(section: dict[str, Any]) -> set[str]:
    records = section["values"].get("records")
    return {section["code"]} if records is None else {record["code"] for record in records.values()}


def _summary(kept: dict[str, Any], found: dict[str, list[Check | Fact]]) -> list[str]:
    rows = []
    for name, module in SECTIONS.items():
        checks = found.get(name)
        if checks is None:
            rows.append([module.TITLE, "not measured", ""])
        elif checks:
            passed = sum(check.passed for check in checks)
            mark = YES if passed == len(checks) else NO
            if quiet.disturbed(kept[name]["values"].get("others")):
                mark += " (measured while other programs ran: not reliable)"
            rows.append([module.TITLE, f"{passed} of {len(checks)}", mark])
    lines = ["## Summary", "", *table(["", "targets met", ""], rows)]
    missed = [check for checks in found.values() for check in checks if not check.passed]
    if missed:
        lines += ["Missed:", "", *(f"- {check.what}: {check.cell()}" for check in missed), ""]
    elif len(kept) == len(SECTIONS):
        lines += ["No target is missed.", ""]
    errors = _errors(kept)
    if errors:
        lines += ["Runs that ended with an error:", "", *(f"- {key}: {text}" for key, text in errors.items()), ""]
    return lines


def _errors(kept: dict[str, Any]) -> dict[str, str]:
    """What the runs that raised said, by key."""
    return {
        key: record["error"]
        for section in kept.values()
        for key, record in section["values"].get("records", {}).items()
        if "error" in record
    }
