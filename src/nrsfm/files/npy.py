"""NumPy ``.npy`` files: one array without a name, memory-mapped, never unpickled."""

from __future__ import annotations

import math
from pathlib import Path
from typing import IO

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.container import NAMELESS, DamagedFileError, Entry


def header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    """Return shape and dtype from the head of an ``.npy`` stream, which is left at the first byte of data."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        # Version 3 exists for field names in UTF-8 only: a table, never tracks.
        raise FileError(f"NumPy format version {version[0]}.{version[1]} holds no plain array")
    return shape, dtype


def check(name: str, shape: tuple[int, ...], dtype: np.dtype, held: int) -> None:
    """Raise ``FileError`` for pickled objects; ``DamagedFileError`` where the header promises not ``held`` bytes."""
    if dtype.hasobject:
        raise FileError(f"array '{name or 'array'}' holds pickled objects, which are never unpickled: store numbers")
    needed = math.prod(shape) * dtype.itemsize
    if held != needed:
        raise DamagedFileError(
            f"array '{name or 'array'}' should have {needed} bytes, the file holds {held}: truncated or damaged"
        )


def read(path: Path) -> dict[str, Entry]:
    """Return the array of an ``.npy`` file under the nameless key."""
    with path.open("rb") as stream:
        shape, dtype = header(stream)
        held = path.stat().st_size - stream.tell()

    def read_array() -> np.ndarray:
        check("", shape, dtype, held)
        # A map of nothing is refused by the system.
        return np.load(path, mmap_mode="r" if math.prod(shape) else None, allow_pickle=False)

    return {NAMELESS: Entry(shape, "object" if dtype.hasobject else str(dtype), read_array)}
