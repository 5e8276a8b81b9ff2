"""Tracks that stay in their file: an HDF5 dataset, a zarr array, a mapped file of another type of number.

Nothing is read until a block is asked for, and another process is sent the path of the file alone. What comes out is
always (F, n, 2) float32 or float64, whatever the layout and the type in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.streaming.sending import opening

LAYOUTS = ("frame-first", "point-first", "matrix")


def is_stored(value: Any) -> bool:
    """Whether this is an array of a file library, which is read when it is sliced: h5py's or zarr's."""
    return type(value).__module__.partition(".")[0] in ("h5py", "zarr") and hasattr(value, "shape")


def _opened(function: Callable[..., Any], arguments: tuple[Any, ...], layout: str) -> StoredPoints:
    return StoredPoints(function(*arguments), layout)


class StoredPoints:
    """Points (F, P, 2) in a file, read by slices.

    Parameters
    ----------
    array
        Anything with ``shape``, ``dtype`` and slicing: h5py dataset, zarr array, memory map.
    layout
        How it lies there: ``"frame-first"`` (F, P, 2), ``"point-first"`` (P, F, 2), or ``"matrix"`` (2F×P).
    """

    ndim = 3

    def __init__(self, array: Any, layout: str = "frame-first") -> None:
        self.array, self.layout = array, layout
        shape = tuple(int(n) for n in array.shape)
        if layout == "matrix":
            shape = (shape[0] // 2, shape[1], 2)
        elif layout == "point-first":
            shape = (shape[1], shape[0], shape[2])
        self.shape = shape
        kept = array.dtype in (np.dtype(np.float32), np.dtype(np.float64))
        small = array.dtype.kind == "f" and array.dtype.itemsize <= 4
        self.dtype = np.dtype(array.dtype) if kept else np.dtype(np.float32 if small else np.float64)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return int(np.prod(self.shape))

    @property
    def nbytes(self) -> int:
        """Bytes that all of it takes in memory."""
        return self.size * self.dtype.itemsize

    def read(self, frames: Any = slice(None), points: Any = slice(None)) -> np.ndarray:
        """The points (F, n, 2) of some frames and points, each a slice; points also sorted indices."""
        if not isinstance(points, slice):
            return self._picked(frames, np.asarray(points))
        if self.layout == "matrix":
            start, stop, step = frames.indices(self.shape[0])
            if step != 1:
                return self.read(slice(None), points)[frames]
            rows = np.asarray(self.array[2 * start : 2 * stop, points])
            part = rows.reshape(len(rows) // 2, 2, rows.shape[1]).transpose(0, 2, 1)
        elif self.layout == "point-first":
            part = np.asarray(self.array[points, frames]).transpose(1, 0, 2)
        else:
            part = np.asarray(self.array[frames, points])
        return part.astype(self.dtype, copy=False)

    def _picked(self, frames: Any, points: np.ndarray) -> np.ndarray:
        """Some points by their indices, through the contiguous stretches that hold them."""
        if points.dtype == np.bool_:
            points = np.flatnonzero(points)
        order = np.argsort(points, kind="stable")
        wanted = points[order]
        count = len(range(*frames.indices(self.shape[0])))
        out = np.empty((count, len(points), 2), dtype=self.dtype)
        step = max(1, (1 << 22) // max(count, 1))
        first = 0
        while first < len(wanted):
            start = int(wanted[first])
            last = int(np.searchsorted(wanted, start + step))
            block = self.read(frames, slice(start, int(wanted[last - 1]) + 1))
            out[:, order[first:last]] = block[:, wanted[first:last] - start]
            first = last
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        return _opened, (*opening(self.array), self.layout)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> np.ndarray:
        keys = key if isinstance(key, tuple) else (key,)
        if len(keys) > 2 or any(k is None or k is Ellipsis for k in keys):
            return np.asarray(self)[key]
        frames, points = keys[0], keys[1] if len(keys) == 2 else slice(None)
        if isinstance(frames, (int, np.integer)):
            index = int(frames) % self.shape[0]
            return self[index : index + 1, points][0]
        if not isinstance(frames, slice):
            return np.asarray(self)[key]
        if isinstance(points, (int, np.integer)):
            index = int(points) % self.shape[1]
            return self.read(frames, slice(index, index + 1))[:, 0]
        return self.read(frames, points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        whole = self.read()
        return whole if dtype is None else whole.astype(dtype, copy=False)

    def __repr__(self) -> str:
        return f"StoredPoints({self.shape}, {self.dtype}, {self.layout} in {type(self.array).__name__})"
