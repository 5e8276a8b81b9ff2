"""Values of the library as one file: arrays, numbers, words, and dataclasses made of them; never unpickled.

An uncompressed ``.npz`` of the arrays, and of a member ``value`` that says in JSON how they hang together. Only
dataclasses of this package are made again, by their names.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.atomic import atomic_file

_VALUE = "value"
_DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError, ImportError, EOFError, zipfile.BadZipFile)
_PACKAGE = __name__.split(".", maxsplit=1)[0]
_KIND, _ITEMS = "kind", "items"


def save_value(path: str | os.PathLike[str], value: Any, held: Sequence[Any] = ()) -> None:
    """Write a value to a file that appears whole or not at all.

    Parameters
    ----------
    path
        The file; replaced where it exists.
    value
        ``None``, numbers, words, arrays, and lists, tuples, dicts and dataclasses of such.
    held
        Objects that the reader has: where one of them is met it is not written. ``load_value`` gets the same ones.

    Raises ``TypeError`` for anything else, ``FileError`` where the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_plain(value, arrays, held))
    with atomic_file(path) as stream:
        np.savez(stream, allow_pickle=False, **arrays, **{_VALUE: np.frombuffer(text.encode(), dtype=np.uint8)})


def load_value(path: str | os.PathLike[str], held: Sequence[Any] = ()) -> Any:
    """Read what ``save_value`` wrote; raises ``FileError`` where the file is damaged or of another making."""
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            tree = json.loads(bytes(archive[_VALUE]))
            return _value(tree, archive, held)
    except _DAMAGE as error:
        raise FileError(f"cannot read '{path}': it is damaged, or of another version ({error})") from error


def _plain(value: Any, arrays: dict[str, np.ndarray], held: Sequence[Any]) -> Any:
    for number, known in enumerate(held):
        if value is known and known is not None:
            return {_KIND: "held", _ITEMS: number}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return {_KIND: "scalar", _ITEMS: _stored(np.asarray(value), arrays)}
    if isinstance(value, np.ndarray):
        return {_KIND: "array", _ITEMS: _stored(value, arrays)}
    if isinstance(value, (list, tuple)):
        kind = "list" if isinstance(value, list) else "tuple"
        return {_KIND: kind, _ITEMS: [_plain(one, arrays, held) for one in value]}
    if isinstance(value, dict):
        pairs = [[_plain(k, arrays, held), _plain(v, arrays, held)] for k, v in value.items()]
        return {_KIND: "dict", _ITEMS: pairs}
    if dataclasses.is_dataclass(value) and type(value).__module__.split(".")[0] == _PACKAGE:
        fields = {f.name: _plain(getattr(value, f.name), arrays, held) for f in dataclasses.fields(value)}
        return {_KIND: f"{type(value).__module__}:{type(value).__qualname__}", _ITEMS: fields}
    raise TypeError(f"a value of type {type(value).__name__} cannot be kept in a file")


def _stored(array: np.ndarray, arrays: dict[str, np.ndarray]) -> str:
    if array.dtype.hasobject:
        raise TypeError("an array of objects cannot be kept in a file")
    name = f"a{len(arrays)}"
    arrays[name] = array
    return name


def _value(tree: Any, arrays: Any, held: Sequence[Any]) -> Any:
    if not isinstance(tree, dict):
        return tree
    kind, items = tree[_KIND], tree[_ITEMS]
    if kind == "held":
        return held[items]
    if kind == "array":
        return arrays[items]
    if kind == "scalar":
        return arrays[items][()]
    if kind == "list":
        return [_value(one, arrays, held) for one in items]
    if kind == "tuple":
        return tuple(_value(one, arrays, held) for one in items)
    if kind == "dict":
        return {_value(key, arrays, held): _value(one, arrays, held) for key, one in items}
    return _class(kind)(**{name: _value(one, arrays, held) for name, one in items.items()})


def _class(kind: str) -> type:
    module, _, name = kind.partition(":")
    if module.split(".")[0] != _PACKAGE:
        raise ValueError(f"'{kind}' is not a class of this package")
    found = getattr(importlib.import_module(module), name)
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        raise ValueError(f"'{kind}' is not a dataclass")
    return found
