"""Write docs/options.md from the declarations of the options: ``python docs/write_options.py``."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.cli.arguments import flag_of
from nrsfm.methods import get_method, method_names
from nrsfm.options import field_types
from nrsfm.pipeline import STAGE_OPTIONS

PAGE = Path(__file__).with_name("options.md")

_HEAD = """\
# Options

Written by `python docs/write_options.py` from the declarations in the code; do not edit.

Every option is a keyword of `nrsfm.reconstruct` and a flag of `nrsfm reconstruct`. A switch `--flag` has a `--no-flag`
beside it. `None` means "chosen from the data", and is spelled `auto` on the command line. A value of the wrong type or
outside what is allowed, and a name that the chosen method does not know, are refused. What the letters mean is in
[methods](methods.md), and in [cameras](cameras.md) for the cameras; what an option was when a result was made is in
`result.options`.
"""


def page() -> str:
    """The whole page."""
    parts = [
        _HEAD,
    ]
    for name, cls in STAGE_OPTIONS.items():
        words = " ".join((cls.__doc__ or "").split("\n\n")[0].split())
        parts += _section(name.capitalize(), f"{words} Every method takes these.", cls)
    options = {name: get_method(name).Options for name in method_names()}
    for declaring in _declaring(options.values()):
        takers = {name: cls for name, cls in options.items() if issubclass(cls, declaring)}
        names = ", ".join(f"`{name}`" for name in takers)
        title = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", declaring.__name__.removesuffix("Options")).capitalize()
        text = (declaring.__doc__ or "").split("\n\n")[0]
        parts += _section(title, f"{' '.join(text.split())} Taken by {names}.", declaring, takers)
    return "\n".join(parts).rstrip() + "\n"


def _declaring(classes: Iterable[type]) -> list[type]:
    """The classes that declare fields of their own, the shared ones first, each once."""
    lines = [base for cls in classes for base in reversed(cls.__mro__) if _new_fields(base)]
    return list(dict.fromkeys(lines))


def _new_fields(cls: type) -> list[dataclasses.Field[Any]]:
    """Fields that ``cls`` declares, without those that only give a field of its base another default."""
    if not dataclasses.is_dataclass(cls):
        return []
    rules = [
        {field.name: field.metadata for field in dataclasses.fields(base)}
        for base in cls.__mro__[1:]
        if dataclasses.is_dataclass(base)
    ]
    own = inspect.get_annotations(cls)
    return [
        field
        for field in dataclasses.fields(cls)
        if field.name in own and not any(rule.get(field.name) == field.metadata for rule in rules)
    ]


def _declarer(name: str, cls: type) -> type:
    """The class from which ``cls`` has the option of that name."""
    return next(base for base in cls.__mro__ if name in (field.name for field in _new_fields(base)))


def _section(title: str, text: str, cls: type, takers: dict[str, type] | None = None) -> list[str]:
    rows = [
        "| option | flag | symbol | default | allowed | meaning |",
        "|---|---|---|---|---|---|",
        *(_row(field, cls, takers or {"": cls}) for field in _new_fields(cls)),
    ]
    return [f"## {title}", "", textwrap.fill(text, 120, break_on_hyphens=False), "", *rows, ""]


def _row(field: dataclasses.Field[Any], cls: type, takers: dict[str, type]) -> str:
    kind, optional = field_types(cls)[field.name]
    cells = [
        f"`{field.name}`",
        f"`{flag_of(field.name)}`",
        field.metadata["symbol"],
        _defaults(field.name, {name: taker for name, taker in takers.items() if _declarer(field.name, taker) is cls}),
        _allowed(field, kind) + (", or `None`" if optional else ""),
        " ".join(field.metadata["doc"].split()),
    ]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _defaults(name: str, takers: dict[str, type]) -> str:
    """The default; where methods differ, each value with the methods that have it."""
    found: dict[str, list[str]] = {}
    for method, cls in takers.items():
        field = next(field for field in dataclasses.fields(cls) if field.name == name)
        found.setdefault(f"`{_literal(field.default)}`", []).append(f"`{method}`")
    if len(found) == 1:
        return next(iter(found))
    return "; ".join(f"{value} ({', '.join(methods)})" for value, methods in found.items())


def _literal(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:g}" if isinstance(value, float) else str(value)


def _allowed(field: dataclasses.Field[Any], kind: type) -> str:
    rule = field.metadata
    if rule["choices"]:
        return ", ".join(f"`{_literal(choice)}`" for choice in rule["choices"])
    if kind is bool:
        return "`True`, `False`"
    bounds = [("above", ">"), ("minimum", "≥"), ("maximum", "≤")]
    parts = [f"{sign} {rule[name]:g}" for name, sign in bounds if rule[name] is not None]
    what = {int: "whole number", float: "number", str: "word", np.ndarray: "array"}[kind]
    return f"{what} {', '.join(parts)}".strip()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
