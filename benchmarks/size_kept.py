"""Parts of the section about size as the committed page has them: each can be measured again by itself, anywhere.

A part is what stands below a heading of the third level; its targets are rows of the section's first table.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from benchmarks import store
from benchmarks.kept_page import read_page
from benchmarks.tables import NO, YES, Check, Fact

NOT_MEASURED = "**Not measured.**"  # of a part; other words than those of a whole section
_KEPT = "Kept from an earlier page, so perhaps from an earlier state of the code; measured on: "
_ROW = re.compile(rf"\| (?P<what>.+) \| (?P<text>.+) (?P<mark>[{YES}{NO}]) \|")


@dataclass(frozen=True)
class KeptPart:
    """The lines below the heading of a part, the rows with targets of the whole section, and the section's machine."""

    lines: list[str]
    rows: dict[str, Fact]
    machine: str

    def noted(self) -> list[str]:
        """The lines, with a word that they were kept, and from which machine, below the date."""
        if any(line.startswith(_KEPT) for line in self.lines):
            return self.lines
        return [*self.lines[:1], "", f"{_KEPT}{self.machine}", *self.lines[1:]]

    def checks(self, numbers: Iterable[Check]) -> list[Check | Fact]:
        """Targets of the same names as the page has them; one that it does not have stays without a number."""
        return [self.rows.get(number.what, number) for number in numbers]


def kept_parts(title: str) -> dict[str, KeptPart]:
    """Parts with numbers by their headings; ``title`` is the section's."""
    section = read_page(store.PAGE, {"size": title}).get("size")
    if section is None:
        return {}
    blocks: dict[str, list[str]] = {"": []}
    name = ""
    for line in section.lines:
        if line.startswith("### "):
            name = line.removeprefix("### ")
            blocks[name] = []
        else:
            blocks[name].append(line)
    rows = {
        found["what"]: Fact(found["what"], found["mark"] == YES, found["text"])
        for line in blocks.pop("")
        if (found := _ROW.fullmatch(line))
    }
    parts = {name: "\n".join(lines).strip("\n").split("\n") for name, lines in blocks.items()}
    return {
        name: KeptPart(lines, rows, section.machine)
        for name, lines in parts.items()
        if NOT_MEASURED not in lines and any(lines)
    }
