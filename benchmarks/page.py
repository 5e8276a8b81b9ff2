"""``docs/benchmarks.md``: every kept number, beside its target, written by rules."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

from benchmarks import (
    ablation,
    accuracy,
    auto,
    auto_speed,
    calibration,
    cluster,
    literature,
    mocap,
    never_worse,
    quiet,
    real,
    repair_growth,
    robust,
    scaling,
    size,
    speed,
    start,
    store,
    tracking,
    viewer,
)
from benchmarks.kept_page import NOT_MEASURED, KeptSection, read_page
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
    "size": size,
    "cluster": cluster,
    "start": start,
    "tracking": tracking,
    "viewer": viewer,
}


def section_lines(name: str, kept: dict[str, Any]) -> list[str]:
    """One section as Markdown, with what it was measured with."""
    module = SECTIONS[name]
    return [f"## {module.TITLE}", "", f"Measured {kept['date']}.", "", *module.render(kept["values"])]


@dataclass(frozen=True)
class _Content:
    """What a page is made of: what was ``measured`` on this machine, its ``checks``, and what is ``kept`` of others."""

    measured: dict[str, dict[str, Any]]
    checks: dict[str, list[Check | Fact]]
    kept: dict[str, KeptSection]

    def absent(self) -> list[str]:
        """Sections that nothing is known of."""
        return [name for name in SECTIONS if name not in self.measured and name not in self.kept]

    def missed(self) -> list[Check | Fact]:
        """Targets that were missed by what was measured."""
        return [check for checks in self.checks.values() for check in checks if not check.passed]


def write_page(*, trial: bool = False) -> tuple[list[Check | Fact], dict[str, str]]:
    """Write the page from what was measured; return the targets that were missed, and the runs that failed.

    A section without a record on this machine stays as the committed page has it, with its date, its machine and its
    place in the summary: sections can be measured again one by one, anywhere. A ``trial`` goes to ``bench-output/``.
    """
    from nrsfm.files.atomic import atomic_file

    measured = {name: found for name in SECTIONS if (found := store.read(name)) is not None}
    checks = {name: SECTIONS[name].checks(measured[name]["values"]) for name in measured}
    before = read_page(store.PAGE, {name: module.TITLE for name, module in SECTIONS.items()})
    content = _Content(measured, checks, {name: found for name, found in before.items() if name not in measured})
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench` (`python -m benchmarks`); do not edit. Every number was measured, with one set of",
        "defaults for every row; nothing was set by the name of a sequence. ✓ and ✗ compare the unrounded number with",
        "its target.",
        "",
        *_machines(content),
        *_summary(content),
    ]
    for name, module in SECTIONS.items():
        if name in measured:
            lines += section_lines(name, measured[name])
        elif name in content.kept:
            lines += [f"## {module.TITLE}", "", *content.kept[name].noted(), ""]
        else:
            lines += [f"## {module.TITLE}", "", NOT_MEASURED, ""]
    path = store.OUTPUT / store.PAGE.name if trial else store.PAGE
    with atomic_file(path) as stream:
        stream.write(("\n".join(lines).rstrip() + "\n").encode())
    absent = content.absent()
    store.say(f"{path.relative_to(store.ROOT)} is written{', without ' if absent else ''}{', '.join(absent)}")
    if content.kept:
        store.say(f"kept as they were: {', '.join(name for name in SECTIONS if name in content.kept)}")
    return content.missed(), {key: text for errors in _errors(measured).values() for key, text in errors.items()}


def _machines(content: _Content) -> list[str]:
    """Each machine that something was measured on, and whether all of it was the same code."""
    by_machine: dict[str, list[str]] = {}
    for name in SECTIONS:
        if name in content.measured:
            by_machine.setdefault(in_words(content.measured[name]["machine"]), []).append(name)
        elif name in content.kept:
            by_machine.setdefault(content.kept[name].machine, []).append(name)
    lines = []
    for text, names in by_machine.items():
        whose = "Machine" if len(by_machine) == 1 else f"Machine for {', '.join(names)}"
        lines += [f"{whose}: {text}", ""]
    stale = [name for name, section in content.measured.items() if _digests(section) != {store.code_digest(name)}]
    if stale:
        lines += [f"**Measured with an earlier state of the code: {', '.join(stale)}.**", ""]
    kept = [name for name in SECTIONS if name in content.kept]
    if kept:
        lines += [
            f"**Kept from an earlier page, so perhaps from an earlier state of the code: {', '.join(kept)}.**",
            "",
        ]
    return lines


def _digests(section: dict[str, Any]) -> set[str]:
    records = section["values"].get("records")
    return {section["code"]} if records is None else {record["code"] for record in records.values()}


def _summary(content: _Content) -> list[str]:
    rows, missed, errors = [], [], []
    failed = _errors(content.measured)
    for name, module in SECTIONS.items():
        if name in content.measured:
            checks = content.checks[name]
            rows += _row(module.TITLE, checks, content.measured[name])
            missed += [f"- {check.what}: {check.cell()}" for check in checks if not check.passed]
            errors += [f"- {module.TITLE}: {key}: {text}" for key, text in failed[name].items()]
        elif name in content.kept:
            found = content.kept[name]
            rows += [] if found.row is None else [found.row]
            missed += found.missed
            errors += found.errors
        else:
            rows.append([module.TITLE, "not measured", ""])
    lines = ["## Summary", "", *table(["", "targets met", ""], rows)]
    if missed:
        lines += ["Missed:", "", *missed, ""]
    elif not content.absent():
        lines += ["No target is missed.", ""]
    if errors:
        lines += ["Runs that ended with an error:", "", *errors, ""]
    return lines


def _row(title: str, checks: list[Check | Fact], section: dict[str, Any]) -> list[list[str]]:
    """The row of a section in the summary; none where it has no targets."""
    if not checks:
        return []
    passed = sum(check.passed for check in checks)
    mark = YES if passed == len(checks) else NO
    if quiet.disturbed(section["values"].get("others")):
        mark += " (measured while other programs ran: not reliable)"
    return [[title, f"{passed} of {len(checks)}", mark]]


def _errors(measured: dict[str, Any]) -> dict[str, dict[str, str]]:
    """What the runs that raised said, by section and key, in one line each."""
    return {
        name: {
            key: " ".join(str(record["error"]).split())
            for key, record in section["values"].get("records", {}).items()
            if "error" in record
        }
        for name, section in measured.items()
    }
