"""Arrays that stay in their file, as descriptions that another process can open: path, name, and where it lies.

The file must have the same path there. What is in no file is refused: it would be sent as a whole, unasked.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError

Opening = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and its arguments that give the array again."""


def opening(array: Any) -> Opening:
    """How another process opens an array of h5py or zarr, or a memory map.

    Raises ``InputError`` where the array is in no file.
    """
    library = type(array).__module__.partition(".")[0]
    if library == "h5py":
        path = str(array.file.filename)
        if os.path.isfile(path):
            return open_hdf5, (os.path.abspath(path), str(array.name))
    elif library == "zarr":
        root = getattr(array.store, "root", None)
        if isinstance(root, os.PathLike) and os.path.isdir(root):
            return open_zarr, (os.path.abspath(root), str(array.path))
    elif isinstance(array, np.memmap):
        place = place_of(array)
        if place is not None:
            return open_map, (*place, array.shape, array.strides, array.dtype)
    raise InputError(
        f"points: what is sent to other processes must lie in a file, received {type(array).__name__} {array.shape}, "
        "which does not"
    )


def open_hdf5(path: str, name: str) -> Any:
    """A dataset of an HDF5 file, which stays open as long as it is used."""
    import h5py

    _require(path)
    return h5py.File(path, "r")[name]


def open_zarr(path: str, name: str) -> Any:
    """An array of a zarr store."""
    from nrsfm.files.zarr_store import import_zarr

    _require(path)
    return import_zarr().open_array(path, path=name, mode="r")


def anywhere(array: Any) -> Any:
    """A zarr array that is written from other folders too: its store by the whole path."""
    from nrsfm.files.zarr_store import import_zarr

    root = os.path.abspath(array.store.root)
    return import_zarr().open_array(root, path=str(array.path), mode="r+")


def open_map(path: str, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], dtype: np.dtype) -> Any:
    """An array that lies in a file with these strides, its first number at byte ``offset``."""
    _require(path)
    whole = np.memmap(path, dtype=np.uint8, mode="r")
    first: Any = whole[offset : offset + dtype.itemsize].view(dtype)
    return np.lib.stride_tricks.as_strided(first, shape, strides, subok=True, writeable=False)


def place_of(points: np.ndarray) -> tuple[str, int] | None:
    """Path and byte of a mapped array's first number, or ``None`` where it is not known."""
    mapped: Any = getattr(points, "_mmap", None)
    if not isinstance(points, np.memmap) or mapped is None or points.mode == "c" or points.filename is None:
        return None
    first = np.frombuffer(mapped, dtype=np.uint8, count=1).__array_interface__["data"][0]
    within = int(points.__array_interface__["data"][0]) - int(first)
    start = points.offset - points.offset % mmap.ALLOCATIONGRANULARITY
    path = os.fspath(points.filename)
    if not 0 <= within < len(mapped) or not os.path.isfile(path):
        return None
    return str(path), start + within


def _require(path: str) -> None:
    if not os.path.exists(path):
        raise FileError(f"cannot read '{path}': no such file on this machine")
