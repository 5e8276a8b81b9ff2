"""The page: one HTML document that needs nothing else, and may not load anything else.

A content security policy forbids every request and every script but our two, which are named by their digests: what
file names and options hold can neither load nor run anything, were it ever not escaped.

Source: ours; W3C, "Content Security Policy Level 3".
"""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib import resources

from nrsfm.viewing import player
from nrsfm.viewing.report.markup import Child, Html, el, escape, join

_ICON = (
    "data:image/svg+xml;base64,"
    + base64.b64encode(
        b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="7" '
        b'fill="#2f6ea8"/>'
        b'<path d="M5 20c5-13 9-13 12-5s6 6 10-5" fill="none" stroke="#fcfbf9" stroke-width="3" '
        b'stroke-linecap="round"/>'
        b"</svg>"
    ).decode()
)


@cache
def _file(name: str) -> str:
    return (resources.files(__package__) / "page" / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


def page(title: str, description: str, *content: Child) -> str:
    """Return the document. ``title`` and ``description`` are texts; ``content`` is HTML."""
    style = _file("report.css") + player.style()
    scripts = [_file("report.js"), player.script()]
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; "
        f"script-src {' '.join(map(_digest, scripts))}; base-uri 'none'; form-action 'none'"
    )
    head = join(
        [
            el("meta", charset="utf-8"),
            el("meta", http_equiv="Content-Security-Policy", content=policy),
            el("meta", name="viewport", content="width=device-width, initial-scale=1"),
            el("meta", name="color-scheme", content="light dark"),
            el("meta", name="description", content=description),
            el("title", title),
            el("link", rel="icon", href=_ICON),
        ]
    )
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n{head.replace("><", chr(62) + chr(10) + chr(60))}\n'
        f"<style>{style}</style>\n</head>\n<body>\n{join(content)}\n"
        + "".join(f"<script>{script}</script>\n" for script in scripts)
        + "</body>\n</html>\n"
    )


def contents(names: list[tuple[str, str]]) -> Html:
    """Return links to the sections: their names in the page, and texts."""
    links = [el("li", el("a", text, href=f"#{escape(name)}")) for name, text in names]
    return el("nav", el("ul", links), aria_label="Sections", class_="contents")
