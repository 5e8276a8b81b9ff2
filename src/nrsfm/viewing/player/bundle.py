"""Modules of a page joined into one script, for pages that have no other files.

Each module becomes a function that returns what it exports, in an order in which none comes before what it needs. Only
the forms that our modules use are known: ``import { a, b } from "./c.js";`` and ``export`` before a declaration.
Anything else that is an import or an export is an error, so that no page is made that cannot work.

Source: ours.
"""

from __future__ import annotations

import re
from collections.abc import Callable

_IMPORT = re.compile(r'^import \{ ([\w, ]+) \} from "\./(\w+)\.js";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:(?:async )?function|class|const) (\w+))", re.MULTILINE)
_LEFT = re.compile(r"^\s*(?:import\b.*|export\b.*)$|\bimport\(", re.MULTILINE)


def bundle(first: str, read: Callable[[str], str]) -> str:
    """Return the script that runs the module ``first``; ``read`` returns the text of the module of a name.

    Raises ``ValueError`` where a module needs itself, or has an import or export of another form.
    """
    made: dict[str, str] = {}

    def add(name: str, waiting: tuple[str, ...]) -> None:
        if name in waiting:
            raise ValueError(f"module '{name}' needs itself: {' → '.join((*waiting, name))}")
        if name in made:
            return
        text = read(name)
        for found in _IMPORT.finditer(text):
            add(found[2], (*waiting, name))
        names = _EXPORT.findall(text)
        text = _EXPORT.sub("", _IMPORT.sub(lambda m: f"const {{ {m[1]} }} = from_{m[2]};", text))
        left = _LEFT.search(text)
        if left:
            raise ValueError(f"module '{name}': this form of import or export is not known: {left[0].strip()}")
        made[name] = f"const from_{name} = (() => {{\n{text}\nreturn {{ {', '.join(names)} }};\n}})();\n"

    add(first, ())
    return '(() => {\n"use strict";\n' + "".join(made.values()) + "})();\n"
