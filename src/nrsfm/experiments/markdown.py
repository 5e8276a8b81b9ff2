"""The little Markdown that the pages of results are written in, and its translation to HTML."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterable, Iterator, Sequence

_CODE = re.compile(r"`([^`]+)`")
_BOLD = re.compile(r"\*\*([^*]+)\*\*")
_ITALIC = re.compile(r"(?<![\w*])\*([^*\s][^*]*)\*(?![\w*])")
_LINK = re.compile(r"\[([^\]]+)\]\(([^()\s]+)\)")
_IMAGE = re.compile(r"!\[([^\]]*)\]\(([^()\s]+)\)$")
_RULE = re.compile(r"\|(?::?-+:?\|)+$")
_RAW = ("<details", "</details", "<summary")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1) -> list[str]:
    """Return a table as lines, with an empty line after it; after the first ``texts`` columns there are numbers."""
    lines = [_row(head), "|" + "---|" * texts + "---:|" * (len(head) - texts)]
    return [*lines, *(_row(row) for row in rows), ""]


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def folded(summary: str, lines: Sequence[str]) -> list[str]:
    """Return lines that a reader has to open."""
    return [f"<details><summary>{html.escape(summary, quote=False)}</summary>", "", *lines, "", "</details>", ""]


def to_html(lines: Sequence[str], image: Callable[[str], str] = lambda link: link) -> str:
    """Translate headings, paragraphs, lists, tables, pictures, folded parts, bold, italics, code and links.

    ``image`` maps the link of a picture to its address in the page.
    """
    return "\n".join(_blocks(list(lines), image)) + "\n"


def _blocks(lines: list[str], image: Callable[[str], str]) -> Iterator[str]:
    i = 0
    while i < len(lines):
        line = lines[i].rstrip()
        if not line:
            i += 1
        elif line.startswith("#"):
            level = len(line) - len(line.lstrip("#"))
            text = line[level:].strip()
            yield f'<h{level} id="{anchor(text)}">{_inline(text)}</h{level}>'
            i += 1
        elif line.startswith(_RAW):
            yield line
            i += 1
        elif (found := _IMAGE.match(line)) is not None:
            yield f'<figure><img alt="{html.escape(found[1])}" src="{html.escape(image(found[2]))}"></figure>'
            i += 1
        elif line.startswith("|"):
            end = _run(lines, i, "|")
            yield _html_table(lines[i:end])
            i = end
        elif line.startswith("- "):
            end = _run(lines, i, "- ")
            yield "<ul>" + "".join(f"<li>{_inline(item[2:])}</li>" for item in lines[i:end]) + "</ul>"
            i = end
        else:
            end = i
            while end < len(lines) and lines[end].strip() and not lines[end].startswith(("|", "- ", "#", "!", *_RAW)):
                end += 1
            end = max(end, i + 1)
            yield f"<p>{_inline(' '.join(part.strip() for part in lines[i:end]))}</p>"
            i = end


def anchor(heading: str) -> str:
    """The name by which a heading is linked to, as code hosts make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _run(lines: list[str], start: int, prefix: str) -> int:
    end = start
    while end < len(lines) and lines[end].startswith(prefix):
        end += 1
    return end


def _html_table(lines: list[str]) -> str:
    rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip()[1:-1])] for line in lines]
    body = rows[2:] if len(lines) > 1 and _RULE.match(lines[1].strip()) else rows
    parts = ['<div class="wide"><table>']
    if body is not rows:
        parts.append("<thead><tr>" + "".join(f"<th>{_cell(c)}</th>" for c in rows[0]) + "</tr></thead>")
    parts.append("<tbody>")
    parts += ["<tr>" + "".join(f"<td>{_cell(c)}</td>" for c in row) + "</tr>" for row in body]
    return "".join([*parts, "</tbody></table></div>"])


def _cell(text: str) -> str:
    return _inline(text.replace("\\|", "|"))


def _inline(text: str) -> str:
    """Escape, then mark up; what stands between backticks is left as it is."""
    parts = _CODE.split(text)
    for i, part in enumerate(parts):
        if i % 2:
            parts[i] = f"<code>{html.escape(part, quote=False)}</code>"
            continue
        plain = html.escape(part, quote=False)
        plain = _LINK.sub(r'<a href="\2">\1</a>', plain)
        plain = _BOLD.sub(r"<strong>\1</strong>", plain)
        parts[i] = _ITALIC.sub(r"<em>\1</em>", plain)
    return "".join(parts)
