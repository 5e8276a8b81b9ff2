"""Options are small frozen dataclasses; this module declares, checks and looks up their fields.

One declaration serves the Python call, the command line and the documentation: ``option`` puts the field's
text, symbol and rule beside its default, and ``build_options`` turns keyword arguments into a checked object.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import types
import typing
from typing import Any, TypeVar

import numpy as np

from nrsfm.errors import OptionError, suggest

T = TypeVar("T")


def option(
    default: Any,
    doc: str,
    *,
    symbol: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:
    """Declare one option of a frozen options dataclass.

    ``doc`` says what it does, its unit and its source; ``symbol`` is the paper's letter. ``minimum`` and
    ``maximum`` are inclusive bounds, ``above`` is an exclusive lower bound. A default of ``None`` means "chosen
    from the data".
    """
    metadata = {
        "doc": doc,
        "symbol": symbol,
        "minimum": minimum,
        "maximum": maximum,
        "above": above,
        "choices": choices,
    }
    return dataclasses.field(default=default, metadata=metadata)


def field_types(cls: type) -> dict[str, tuple[type, bool]]:
    """Return for each field its plain type and whether ``None`` is allowed."""
    hints = typing.get_type_hints(cls)
    result: dict[str, tuple[type, bool]] = {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        optional = False
        if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
            members = [h for h in typing.get_args(hint) if h is not type(None)]
            optional = len(members) < len(typing.get_args(hint))
            hint = members[0]
        result[field.name] = (hint, optional)
    return result


def _finite(value: numbers.Real) -> bool:
    try:
        return math.isfinite(float(value))
    except OverflowError:  # a whole number beyond the largest float
        return False


def _checked(field: dataclasses.Field[Any], kind: type, optional: bool, value: Any) -> Any:
    name, rule = field.name, field.metadata
    if value is None:
        if optional:
            return None
        raise OptionError(f"option '{name}': a value of type {kind.__name__} is needed, received None")
    if kind is bool:
        if type(value).__name__ not in ("bool", "bool_"):  # NumPy's own is called one or the other
            raise OptionError(f"option '{name}' must be true or false, received {value!r}")
        return bool(value)
    if kind is int:
        if isinstance(value, bool) or not isinstance(value, numbers.Integral):
            raise OptionError(f"option '{name}' must be a whole number, received {value!r}")
        value = int(value)
    elif kind is float:
        if isinstance(value, bool) or not isinstance(value, numbers.Real) or not _finite(value):
            raise OptionError(f"option '{name}' must be a finite number, received {value!r}")
        value = float(value)
    elif kind is str:
        if not isinstance(value, str):
            raise OptionError(f"option '{name}' must be a word, received {value!r}")
        choices = rule.get("choices")
        if choices and value not in choices:
            listed = ", ".join(choices)
            raise OptionError(f"option '{name}' must be one of {listed}, received {value!r}{suggest(value, choices)}")
        return value
    elif kind is np.ndarray:
        value = np.asarray(value)
        if value.dtype.kind not in "iufb":
            raise OptionError(f"option '{name}' must be an array of numbers, received dtype {value.dtype}")
        return value
    if rule.get("minimum") is not None and value < rule["minimum"]:
        raise OptionError(f"option '{name}' must be at least {rule['minimum']:g}, received {value!r}")
    if rule.get("maximum") is not None and value > rule["maximum"]:
        raise OptionError(f"option '{name}' must be at most {rule['maximum']:g}, received {value!r}")
    if rule.get("above") is not None and value <= rule["above"]:
        raise OptionError(f"option '{name}' must be greater than {rule['above']:g}, received {value!r}")
    return value


def build_options(cls: type[T], values: dict[str, Any]) -> T:
    """Return ``cls(**values)`` with every value checked against its declaration.

    Raises ``OptionError`` for a value of the wrong type or out of range; the caller has already sorted out
    unknown names (see ``split_options``).
    """
    kinds = field_types(cls)
    checked = {}
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        if field.name in values:
            kind, optional = kinds[field.name]
            checked[field.name] = _checked(field, kind, optional, values[field.name])
    return cls(**checked)


def split_options(classes: tuple[type, ...], values: dict[str, Any], where: str) -> list[Any]:
    """Hand each keyword to the one options class that declares it and build all of them.

    Raises ``OptionError`` naming the nearest known options when a keyword belongs to none; ``where`` completes
    the sentence ("... is not an option of ...").
    """
    names = [[f.name for f in dataclasses.fields(c)] for c in classes]
    known = [n for group in names for n in group]
    for key in values:
        if key not in known:
            raise OptionError(f"'{key}' is not an option of {where}{suggest(key, known)}")
    return [
        build_options(c, {k: v for k, v in values.items() if k in group})
        for c, group in zip(classes, names, strict=True)
    ]
