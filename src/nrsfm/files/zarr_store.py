"""Zarr stores: a folder with one array, or a group of named ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.container import NAMELESS, Entry


def import_zarr() -> Any:
    """Return zarr. Raises ``FileError`` where it is not installed."""
    try:
        import zarr
    except ImportError as error:
        raise FileError("zarr stores need the package zarr: pip install 'nrsfm[zarr]'") from error
    return zarr


def read(path: Path) -> dict[str, Entry]:
    """Return the arrays of a store by path; one that is no group has one array without a name."""
    zarr = import_zarr()
    opened = zarr.open(str(path), mode="r")
    if isinstance(opened, zarr.Array):
        return {NAMELESS: _entry(opened)}
    return {name: _entry(item) for name, item in opened.members(max_depth=None) if isinstance(item, zarr.Array)}


def _entry(array: Any) -> Entry:
    return Entry(tuple(array.shape), str(array.dtype), lambda: np.asarray(array[...]), lambda: array)
