"""Where shapes go, block by block: memory, or a .npy, .npz, HDF5 or zarr file.

A file grows aside and takes its name when it is complete. All but zarr hold each array in one piece, so that blocks are
written in place, from any thread or machine that sees the file, and the result is a map that takes no memory.
"""

from __future__ import annotations

import os
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np

from nrsfm.errors import FileError, OptionError
from nrsfm.files import npz_in_place
from nrsfm.files.npz_in_place import Arrays
from nrsfm.files.zarr_store import import_zarr
from nrsfm.streaming.readers import WrittenMap

EXTENSIONS = (".npy", ".npz", ".h5", ".hdf5", ".zarr")
_CHUNK_BYTES = 4 * 2**20  # of a chunk in zarr


class Writer(Protocol):
    """One array (F, P, ...) that takes blocks of points, also from several threads at once."""

    def room(self, start: int, count: int) -> np.ndarray:
        """An array (F, count, ...) in C order along its last axes, to be filled and then written at ``start``."""
        ...

    def write(self, start: int, block: np.ndarray) -> None:
        """Put (F, n, ...) in the place of points ``start`` to ``start + n``."""
        ...


@dataclass(frozen=True)
class ArrayWriter:
    """An array in memory."""

    array: np.ndarray

    def room(self, start: int, count: int) -> np.ndarray:
        """See :class:`Writer`; the place itself, so that writing it moves nothing."""
        return self.array[:, start : start + count]

    def write(self, start: int, block: np.ndarray) -> None:
        """See :class:`Writer`."""
        place = self.array[:, start : start + block.shape[1]]
        if block.__array_interface__["data"] != place.__array_interface__["data"]:
            place[...] = block


@dataclass(frozen=True)
class FileWriter:
    """An array in C order from byte ``offset`` of a file of full length; written, never mapped."""

    path: str
    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype

    def room(self, start: int, count: int) -> np.ndarray:
        """See :class:`Writer`."""
        return np.empty((self.shape[0], count, *self.shape[2:]), dtype=self.dtype)

    def write(self, start: int, block: np.ndarray) -> None:
        """See :class:`Writer`."""
        block = np.ascontiguousarray(block, dtype=self.dtype)
        point = _count(self.shape[2:]) * self.dtype.itemsize
        handle = os.open(self.path, os.O_WRONLY)
        try:
            for f, row in enumerate(block):
                view, place = memoryview(row).cast("B"), self.offset + (f * self.shape[1] + start) * point
                while view:
                    written = os.pwrite(handle, view, place)
                    view, place = view[written:], place + written
        finally:
            os.close(handle)


@dataclass(frozen=True)
class ZarrWriter:
    """A zarr array; blocks are whole chunks of it."""

    array: Any

    def room(self, start: int, count: int) -> np.ndarray:
        """See :class:`Writer`."""
        return np.empty((self.array.shape[0], count, *self.array.shape[2:]), dtype=self.array.dtype)

    def write(self, start: int, block: np.ndarray) -> None:
        """See :class:`Writer`."""
        self.array[:, start : start + block.shape[1]] = block


class Target:
    """The arrays of one output, by name: made, written by blocks, kept at the end or taken away after a failure.

    Raises ``OptionError`` where the name of the file says no known format.
    """

    def __init__(self, path: str | os.PathLike[str] | None = None) -> None:
        self.path = None if path is None else Path(path)
        self._arrays: dict[str, np.ndarray] = {}
        self._made: dict[str, FileWriter] = {}
        self._files: dict[Path, Path] = {}
        self._names: tuple[str, ...] = ()
        if self.path is not None and self._kind not in EXTENSIONS:
            raise OptionError(
                f"option 'shapes_file' must end in {', '.join(EXTENSIONS[:-1])} or {EXTENSIONS[-1]}, "
                f"received '{self.path}'"
            )

    @property
    def _kind(self) -> str:
        return "" if self.path is None else self.path.suffix.lower()

    @property
    def in_memory(self) -> bool:
        """Whether the arrays that :meth:`finish` returns are in memory."""
        return self.path is None or self._kind == ".zarr"

    def granule(self, frames: int) -> int:
        """Blocks must begin at a multiple of so many points."""
        return max(1, _CHUNK_BYTES // (12 * frames)) if self._kind == ".zarr" else 1

    def make(self, arrays: Arrays) -> dict[str, Writer]:
        """Make room for arrays of these names, shapes and types; returns a writer for each.

        Raises ``FileError`` where the file cannot be written, or the disk has no room for it.
        """
        self._names = tuple(arrays)
        if self.path is None:
            self._arrays = {name: np.empty(shape, dtype) for name, (shape, dtype) in arrays.items()}
            return {name: ArrayWriter(array) for name, array in self._arrays.items()}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._kind == ".zarr":
                return self._make_zarr(arrays)
            self._made = self._make_npy(arrays) if self._kind == ".npy" else self._make_one_file(arrays)
        except OSError as error:
            raise FileError(f"cannot write '{self.path}': {error.strerror or error}") from error
        return dict(self._made)

    def _aside(self, path: Path) -> Path:
        aside = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
        self._files[aside] = path
        return aside

    def _make_npy(self, arrays: Arrays) -> dict[str, FileWriter]:
        found = {}
        for name, (shape, dtype) in arrays.items():
            aside = self._aside(self._file_of(name))
            with aside.open("wb") as stream:
                offset = npz_in_place.write_header(stream, shape, dtype)
                allocate(stream.fileno(), offset + _count(shape) * dtype.itemsize)
            found[name] = FileWriter(str(aside), offset, shape, dtype)
        return found

    def _make_one_file(self, arrays: Arrays) -> dict[str, FileWriter]:
        aside = self._aside(_given(self.path))
        if self._kind == ".npz":
            offsets = npz_in_place.reserve(aside, arrays)
        else:
            offsets = _reserve_hdf5(aside, arrays)
        with aside.open("r+b") as stream:
            allocate(stream.fileno(), max(offsets[n] + _count(s) * d.itemsize for n, (s, d) in arrays.items()))
        return {name: FileWriter(str(aside), offsets[name], shape, dtype) for name, (shape, dtype) in arrays.items()}

    def _make_zarr(self, arrays: Arrays) -> dict[str, Writer]:
        group = import_zarr().open_group(str(self._aside(_given(self.path))), mode="w")
        found: dict[str, Writer] = {}
        for name, (shape, dtype) in arrays.items():
            chunks = (shape[0], min(shape[1], self.granule(shape[0])), *shape[2:])
            found[name] = ZarrWriter(group.create_array(name, shape=shape, dtype=dtype, chunks=chunks))
        return found

    def _file_of(self, name: str) -> Path:
        """The file of an array: shapes have the name that was given; in .npy files others have theirs behind it."""
        path = _given(self.path)
        if self._kind != ".npy" or name == "shapes":
            return path
        return path.with_name(f"{path.stem}-{name.replace('_', '-')}.npy")

    def finish(self) -> dict[str, np.ndarray]:
        """Give the files their names and return the arrays: in memory as they are, of files read-only maps."""
        if self.path is None:
            return self._arrays
        for aside, path in self._files.items():
            if self._kind == ".npz":
                npz_in_place.complete(aside, {n: (w.shape, w.dtype) for n, w in self._made.items()})
            if path.is_dir() and self._kind == ".zarr":
                shutil.rmtree(path)
            os.replace(aside, path)
        self._files = {}
        if self._kind == ".zarr":
            group = import_zarr().open_group(str(self.path), mode="r")
            return {name: np.asarray(group[name][:]) for name in self._names}
        return {
            name: WrittenMap(self._file_of(name), made.dtype, "r", made.offset, made.shape)
            for name, made in self._made.items()
        }

    def __enter__(self) -> Target:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for aside in self._files:
            if aside.is_dir():
                shutil.rmtree(aside, ignore_errors=True)
            else:
                aside.unlink(missing_ok=True)


def allocate(handle: int, length: int) -> None:
    """Give a file its full length, and its disk space where the system can: a full disk shows now, not at the end."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(handle, 0, length)
    else:
        os.ftruncate(handle, length)


def _reserve_hdf5(path: Path, arrays: Arrays) -> dict[str, int]:
    """Datasets in one piece, not yet written; returns where each begins."""
    import h5py

    offsets = {}
    with h5py.File(path, "w") as file:
        for name, (shape, dtype) in arrays.items():
            settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            settings.set_layout(h5py.h5d.CONTIGUOUS)
            settings.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            settings.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
            kind, space = h5py.h5t.py_create(dtype), h5py.h5s.create_simple(shape)
            made = h5py.h5d.create(file.id, name.encode(), kind, space, settings)
            offsets[name] = int(made.get_offset())
    return offsets


def _count(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=np.int64))


def _given(path: Path | None) -> Path:
    """The path of a target that is no memory."""
    assert path is not None  # noqa: S101 - of our own making, not a user's
    return path
