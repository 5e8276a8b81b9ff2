"""The committed page read back: what it says of a section that has not been measured on this machine.

The page is written by :mod:`benchmarks.page` alone, so its own headings and tables are all there is to understand.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

NOT_MEASURED = "**Not measured yet.**"
KEPT_NOTE = "Kept from an earlier page; other sections may be newer."
_ROW = re.compile(r"\| (?P<title>.+?) \| (?P<met>\d+) of (?P<all>\d+) \| (?P<mark>.*) \|")
_MACHINE = re.compile(r"Machine(?: for (?P<names>[^:]+))?: (?P<text>.+)")
_MISSED, _ERRORS = "Missed:", "Runs that ended with an error:"


@dataclass(frozen=True)
class KeptSection:
    """One section of a page: its lines below the heading, its row of the summary, what it missed and what failed.

    ``row`` is None where it has no targets. ``missed`` and ``errors`` are whole list items, "- " included.
    """

    lines: list[str]
    row: list[str] | None
    missed: list[str]
    errors: list[str]
    machine: str

    def noted(self) -> list[str]:
        """The lines, with a word that they were kept below the date."""
        if KEPT_NOTE in self.lines:
            return self.lines
        return [*self.lines[:1], "", KEPT_NOTE, *self.lines[1:]]


def read_page(path: Path, titles: dict[str, str]) -> dict[str, KeptSection]:
    """What a page says of each section that it holds with numbers; ``titles`` gives the heading of each name."""
    if not path.is_file():
        return {}
    blocks = _blocks(path.read_text(encoding="utf-8"))
    head, summary = blocks.get("", []), blocks.get("Summary", [])
    rows = {found["title"]: found for line in summary if (found := _ROW.fullmatch(line))}
    missed, errors = _items(summary, _MISSED), _items(summary, _ERRORS)
    # The items stand in the order of the rows, as many of each as its row says.
    of_title: dict[str, list[str]] = {}
    for title, found in rows.items():
        count = int(found["all"]) - int(found["met"])
        of_title[title], missed = missed[:count], missed[count:]
    kept = {}
    for name, title in titles.items():
        lines = blocks.get(title)
        if not lines or NOT_MEASURED in lines:
            continue
        row = rows.get(title)
        kept[name] = KeptSection(
            lines,
            None if row is None else [title, f"{row['met']} of {row['all']}", row["mark"]],
            of_title.get(title, []),
            [item for item in errors if item.startswith(f"- {title}: ")],
            _machine(head, name),
        )
    return kept


def _blocks(text: str) -> dict[str, list[str]]:
    """The lines below each heading of the second level, without empty ones around them; those above all under ""."""
    blocks: dict[str, list[str]] = {"": []}
    title = ""
    for line in text.splitlines():
        if line.startswith("## "):
            title = line.removeprefix("## ")
            blocks[title] = []
        else:
            blocks[title].append(line)
    return {title: "\n".join(lines).strip("\n").split("\n") for title, lines in blocks.items()}


def _items(lines: list[str], heading: str) -> list[str]:
    """The list below a line."""
    if heading not in lines:
        return []
    items = []
    for line in lines[lines.index(heading) + 2 :]:
        if not line.startswith("- "):
            break
        items.append(line)
    return items


def _machine(head: list[str], name: str) -> str:
    """The machine that a section was measured on, in the page's words."""
    found = [match for line in head if (match := _MACHINE.fullmatch(line))]
    for match in found:
        if match["names"] is None or name in match["names"].split(", "):
            return match["text"]
    return "not known"
