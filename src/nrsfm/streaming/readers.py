"""How a pass reads blocks of points: from memory, or from a file without leaving its pages in memory.

A reader can be sent to another process or machine where it reads a file; the file must then have the same path there.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from nrsfm.streaming.sending import opening, place_of
from nrsfm.streaming.stored import StoredPoints

Points = TypeVar("Points", np.ndarray, np.memmap, StoredPoints)


class Reader(Protocol):
    """Source of blocks of points."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(F, P, 2)."""
        ...

    @property
    def dtype(self) -> np.dtype:
        """Of the coordinates."""
        ...

    def read(self, start: int, stop: int) -> np.ndarray:
        """Points ``start`` to ``stop`` in all frames, (F, n, 2)."""
        ...


@dataclass(frozen=True)
class _OfPoints(Generic[Points]):
    """Shape and type of a reader are those of its points."""

    points: Points

    @property
    def shape(self) -> tuple[int, ...]:
        """(F, P, 2)."""
        return self.points.shape

    @property
    def dtype(self) -> np.dtype:
        """Of the coordinates."""
        return self.points.dtype


@dataclass(frozen=True)
class ArrayReader(_OfPoints[np.ndarray]):
    """Points (F, P, 2) in memory; a block is a view."""

    def read(self, start: int, stop: int) -> np.ndarray:
        """See :class:`Reader`."""
        return self.points[:, start:stop]


@dataclass(frozen=True)
class FileReader:
    """Points (F, P, 2) in C order from byte ``offset`` of a file; read frame by frame, never mapped.

    Pages of a map that were touched count as memory of the process; what is read does not stay.
    """

    path: str
    offset: int
    size: tuple[int, ...]
    kind: np.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """(F, P, 2)."""
        return self.size

    @property
    def dtype(self) -> np.dtype:
        """Of the coordinates."""
        return self.kind

    def read(self, start: int, stop: int) -> np.ndarray:
        """See :class:`Reader`."""
        frames, count, _ = self.shape
        out = np.empty((frames, stop - start, 2), dtype=self.dtype)
        point = 2 * self.dtype.itemsize
        handle = os.open(self.path, os.O_RDONLY)
        try:
            for f in range(frames):
                _read_exactly(handle, out[f], self.offset + (f * count + start) * point, self.path)
        finally:
            os.close(handle)
        return out


@dataclass(frozen=True)
class MapReader(_OfPoints[np.memmap]):
    """Points in a memory map of any order; its pages are given back after each block."""

    def read(self, start: int, stop: int) -> np.ndarray:
        """See :class:`Reader`."""
        out = np.array(self.points[:, start:stop])
        release(self.points)
        return out

    def __reduce__(self) -> tuple[Any, ...]:
        return _map_reader, opening(self.points)


@dataclass(frozen=True)
class StoredReader(_OfPoints[StoredPoints]):
    """Points in an HDF5 dataset or a zarr array."""

    def read(self, start: int, stop: int) -> np.ndarray:
        """See :class:`Reader`."""
        return self.points.read(slice(None), slice(start, stop))


class WrittenMap(np.memmap):
    """A read-only map of a file that this process has just written: what is in it need not be checked again."""


def _map_reader(function: Callable[..., Any], arguments: tuple[Any, ...]) -> MapReader:
    return MapReader(function(*arguments))


def reader_of(points: np.ndarray | StoredPoints) -> Reader:
    """The reader that suits an array."""
    if isinstance(points, StoredPoints):
        return StoredReader(points)
    place = place_of(points)
    if place is not None and points.flags.c_contiguous:
        return FileReader(place[0], place[1], points.shape, points.dtype)
    if isinstance(points, np.memmap) and is_mapped(points):
        return MapReader(points)
    return ArrayReader(points)


def is_mapped(array: Any) -> bool:
    """Whether an array is a view of a file, shared with it: what is in memory of it can be read again."""
    return isinstance(array, np.memmap) and getattr(array, "_mmap", None) is not None and array.mode != "c"


def release(array: Any) -> None:
    """Give back the memory that reading a mapped file has taken; nothing else happens, to other arrays nothing."""
    while type(array) is np.ndarray and array.base is not None:
        array = array.base  # a plain view of a map
    if is_mapped(array) and hasattr(mmap, "MADV_DONTNEED"):
        array._mmap.madvise(mmap.MADV_DONTNEED)


def _read_exactly(handle: int, row: np.ndarray, offset: int, path: str) -> None:
    view = memoryview(row.data).cast("B")
    done = 0
    while done < len(view):
        got = os.preadv(handle, [view[done:]], offset + done)
        if got <= 0:
            raise OSError(None, f"'{path}' ended while it was read: it has become shorter")
        done += got
