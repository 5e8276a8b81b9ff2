"""Any supported file as a dict of named arrays that are read when asked for; one reader per extension.

A reader lists what the file holds from its headers and hands out :class:`Entry` objects. What the arrays mean
is decided in :mod:`nrsfm.files.loading`.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError

NAMELESS = ""
"""The key of the one array of a file that has no names (.npy, wide .csv)."""

# The module that reads each extension; each has ``read(path) -> dict[str, Entry]``.
_READERS = {
    ".npz": "npz",
    ".npy": "npy",
    ".mat": "mat",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".csv": "text",
    ".tsv": "text",
    ".txt": "text",
    ".json": "json_text",
    ".zarr": "zarr_store",
}

_ZIP, _NPY, _HDF5, _MAT5 = "a zip archive", "a NumPy .npy array", "an HDF5 file", "a MATLAB 5 file"
_STORE = "a zarr store"
_STORE_FILES = ("zarr.json", ".zgroup", ".zarray")
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_EXPECTED: dict[str, set[str | None]] = {
    ".npz": {_ZIP},
    ".npy": {_NPY},
    ".h5": {_HDF5},
    ".hdf5": {_HDF5},
    ".mat": {_MAT5, _HDF5, None},
    ".zarr": {_STORE},
}
_PICKLED = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
_LISTED = 12  # names shown in an error before "..."


class DamagedFileError(FileError):
    """The bytes of a file do not say what its own headers and checksums promise; whatever is in it is in doubt."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One array of a file: what its header says, and how to read it.

    ``dtype`` is a word for people: NumPy's name, or "object", "struct", "cell" for what is not numbers. ``stored``
    gives the array as it is in the file, read when it is sliced, where the library of the format can.
    """

    shape: tuple[int, ...]
    dtype: str
    read: Callable[[], np.ndarray]
    stored: Callable[[], Any] | None = None

    def __str__(self) -> str:
        return f"{self.dtype} {'×'.join(map(str, self.shape)) or 'scalar'}"


def known_extensions() -> tuple[str, ...]:
    """Return the extensions of the files that can be read, each with its dot."""
    return tuple(_READERS)


def open_arrays(path: str | os.PathLike[str]) -> dict[str, Entry]:
    """Return what a file holds, by name, without reading the arrays (text files are parsed at once).

    Raises
    ------
    FileError
        There is no such file, its extension is unknown, or its content is truncated or not what the extension
        says.
    """
    target = Path(path)
    extension = target.suffix.lower()
    content = _sniff(target)
    if extension in _PICKLED:
        raise FileError(
            f"cannot read '{path}': {extension} files are pickles, which can run any program: save the arrays in them "
            "with numpy.savez as .npz, where you trust the file (see docs/tracking.md, Tracks of other trackers)"
        )
    if extension not in _READERS:
        known = ", ".join(_READERS)
        raise FileError(f"cannot read '{path}': extensions {known} are known, received '{target.suffix}'")
    expected = _EXPECTED.get(extension, {None})
    if content not in expected:
        found = content or "something else, or a truncated file"
        raise FileError(f"cannot read '{path}': its name says {extension}, its content is {found}")
    reader = importlib.import_module(f"nrsfm.files.{_READERS[extension]}")
    with reading(target, f"a valid {extension} file"):
        entries: dict[str, Entry] = reader.read(target)
    return {name: _guarded(target, name, entry) for name, entry in entries.items()}


def listing(entries: dict[str, Entry]) -> str:
    """What a file holds, as one phrase for an error."""
    parts = [f"{name or 'one array without a name'} ({entry})" for name, entry in entries.items()]
    return ", ".join(parts[:_LISTED]) + (", ..." if len(parts) > _LISTED else "") or "nothing"


@contextmanager
def reading(path: str | os.PathLike[str], what: str) -> Iterator[None]:
    """Turn whatever a reader raises into a ``FileError`` of one line that names the file.

    Readers therefore raise ``FileError``, or ``DamagedFileError``, with the reason alone.
    """
    try:
        yield
    except FileError as error:
        raise type(error)(f"cannot read '{path}': {error}") from error
    except OSError as error:
        # h5py reports every fault of content as an OSError without an error number.
        if error.errno is not None and error.strerror:
            raise FileError(f"cannot read '{path}': {error.strerror}") from error
        raise _damaged(path, what, error) from error
    except MemoryError as error:
        raise DamagedFileError(
            f"cannot read '{path}': it asks for more memory than there is ({brief(error)})"
        ) from error
    except Exception as error:  # damaged files make the format libraries raise nearly everything
        raise _damaged(path, what, error) from error


def _damaged(path: str | os.PathLike[str], what: str, error: Exception) -> DamagedFileError:
    return DamagedFileError(f"cannot read '{path}': it is not {what}, or it is truncated ({brief(error)})")


def brief(error: BaseException, limit: int = 160) -> str:
    """An exception's text on one line of at most ``limit`` characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= limit else text[: limit - 3] + "..."


def check_size(name: str, shape: tuple[int, ...], itemsize: int, limit: int) -> None:
    """Raise ``DamagedFileError`` where a header asks for more bytes than the file can hold."""
    needed = math.prod(shape) * itemsize
    if needed > limit:
        raise DamagedFileError(
            f"array '{name}' should have {needed} bytes ({shape}), the file can hold {limit}: truncated"
        )


def _sniff(target: Path) -> str | None:
    with reading(target, "a readable file"):
        if target.suffix.lower() == ".zarr" and any((target / name).exists() for name in _STORE_FILES):
            return _STORE
        if target.is_dir():
            raise FileError("it is a folder")
        if target.exists() and not target.is_file():
            raise FileError("it is not a regular file")
        with target.open("rb") as stream:
            head = stream.read(520)
        if not head:
            raise FileError("the file is empty")
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return _ZIP
    if head.startswith(b"\x93NUMPY"):
        return _NPY
    if head.startswith(_HDF5_MAGIC) or head[512:520] == _HDF5_MAGIC:  # MATLAB puts 512 bytes of its own before
        return _HDF5
    if head.startswith(b"MATLAB 5.0 MAT-file"):
        return _MAT5
    return None


def _guarded(path: Path, name: str, entry: Entry) -> Entry:
    def read() -> np.ndarray:
        with reading(path, f"a file with a readable array '{name}'" if name else "a readable array"):
            return entry.read()

    return dataclasses.replace(entry, read=read)
