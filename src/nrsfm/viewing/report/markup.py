"""HTML from values: every text is escaped, unless it is HTML that was made here.

Source: ours; what is escaped follows the HTML standard (WHATWG), section 13.1.
"""

from __future__ import annotations

import html
import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Any

_PLAIN = ("br", "img", "meta", "link")
_VOID = {*_PLAIN, "line", "rect", "circle", "path", "polyline", "polygon"}


_SPACE, _NARROW = "\N{NO-BREAK SPACE}", "\N{NARROW NO-BREAK SPACE}"
_SHARE = re.compile(r"(?<=\d) (?=%)")
_FLAG = re.compile(r"--[a-z][a-z-]*[a-z]")


class Html(str):
    """Text that is HTML already. Everything else is escaped where it enters a page."""

    __slots__ = ()


Child = Any
"""``Html``, a text, a number, ``None`` (nothing), or an iterable of these."""


def escape(text: Any) -> Html:
    """Return the text as HTML; control characters, which no page may hold, and lone surrogates are replaced."""
    clean = "".join(
        "\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t" else c
        for c in str(text)
    )
    return Html(html.escape(clean, quote=True))


def join(children: Child) -> Html:
    """Return the children one after the other."""
    if children is None:
        return Html("")
    if isinstance(children, Html):
        return children
    if isinstance(children, str) or not isinstance(children, Iterable):
        return escape(children)
    return Html("".join(join(child) for child in children))


def prose(text: str) -> Html:
    """The text as HTML, with options such as ``--mirror`` as code that is not broken."""
    return Html(_FLAG.sub(lambda found: f'<code class="flag">{found[0]}</code>', escape(_SHARE.sub(_SPACE, text))))


def el(name: str, /, *children: Child, **attributes: Any) -> Html:
    """Return an element. ``class_`` means ``class``, ``data_x`` ``data-x``; ``None`` and ``False`` are left out."""
    words = []
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        spelled = key.rstrip("_").replace("_", "-")
        words.append(f" {spelled}" if value is True else f' {spelled}="{escape(value)}"')
    if name in _VOID and not children:
        return Html(f"<{name}{''.join(words)}{'' if name in _PLAIN else '/'}>")
    return Html(f"<{name}{''.join(words)}>{join(children)}</{name}>")


def table(header: Sequence[Child], rows: Iterable[Sequence[Child]], caption: str = "", *, text: int = 1) -> Html:
    """Return a table in a frame that scrolls where it is too wide; the first ``text`` columns are no numbers."""

    def kind(k: int) -> str | None:
        return None if k < text else "number"

    head = el("tr", [el("th", cell, scope="col", class_=kind(k)) for k, cell in enumerate(header)])
    body = [
        el("tr", [el("td", cell, class_=kind(k)) if k else el("th", cell, scope="row") for k, cell in enumerate(row)])
        for row in rows
    ]
    made = el("table", el("caption", caption) if caption else None, el("thead", head), el("tbody", body))
    return el("div", made, class_="wide", tabindex="0", role="region", aria_label=caption or "Table")


def number(value: float | None, digits: int = 3) -> str:
    """A number to read: so many digits, a thousand comma, a true minus sign, powers of ten where they are needed."""
    if value is None or value != value:
        return "–"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1e6 or size < 1e-4:
        base, power = f"{value:.{digits - 1}e}".split("e")
        if "." in base:
            base = base.rstrip("0").rstrip(".")
        superscript = str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        text = f"10{superscript}" if base == "1" else f"{base} · 10{superscript}".replace(" ", _NARROW)
    elif size >= 10 ** (digits - 1):
        text = f"{value:,.0f}"
    else:
        text = f"{value:.{digits}g}"
        if "e" in text:
            text = f"{value:.0f}"
    return text.replace("-", "−")


def percent(share: float) -> str:
    """One digit after the point, and never 0 % or 100 % of what is some but not all."""
    if 0 < share < 0.0005:
        return f"<{_SPACE}0.1{_SPACE}%"
    if 0.9995 <= share < 1:
        return f">{_SPACE}99.9{_SPACE}%"
    return f"{100 * share:.1f}{_SPACE}%"


def relative(value: float) -> str:
    """A relative error as a percentage of three digits, zeros at its end included."""
    if not 0 < value < 10:
        return f"{number(100 * value)}{_SPACE}%"
    return f"{100 * value:.{max(0, -math.floor(math.log10(value)))}f}{_SPACE}%"


def plural(count: int, word: str) -> str:
    """``1 point``, ``2,000 points``."""
    return f"{count:,} {word}{'' if count == 1 else 's'}"
