"""An ``.npz`` file whose arrays are written in place, in any order, and that is completed at the end.

A ``.npz`` is a zip archive of ``.npy`` files. Stored without compression, an array lies in it in one piece: room for it
can be reserved first, and a reader can map it into memory. Format: PKWARE APPNOTE 6.3, with its 64-bit extensions.
"""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Literal

import numpy as np

_LOCAL, _CENTRAL, _END64, _LOCATOR, _END = 0x04034B50, 0x02014B50, 0x06064B50, 0x07064B50, 0x06054B50
_VERSION = 45  # of the format: 64-bit sizes
_DATE = (1 << 5) | 1  # 1 January 1980: files with the same content are the same
_UNKNOWN = 0xFFFFFFFF  # the real number is in the extension
_BLOCK = 1 << 22

Arrays = Mapping[str, tuple[tuple[int, ...], np.dtype]]
"""Shape and type of each array, by name."""


def write_header(stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype) -> int:
    """Write the head of a ``.npy`` file for an array in C order; returns its length."""
    start = stream.tell()
    what = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, what)
    return stream.tell() - start


def _heads(arrays: Arrays) -> dict[str, tuple[int, bytes, int]]:
    """For each array: where its local header begins, the head of its ``.npy`` file, and the length of that file."""
    found, place = {}, 0
    for name, (shape, dtype) in arrays.items():
        stream = io.BytesIO()
        write_header(stream, shape, dtype)
        size = stream.tell() + int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        found[name] = place, stream.getvalue(), size
        place += _local_length(name) + size
    return found


def _member(name: str) -> bytes:
    return f"{name}.npy".encode()


def _local_length(name: str) -> int:
    return 30 + len(_member(name)) + 20


def _local(name: str, size: int, crc: int) -> bytes:
    member = _member(name)
    fixed = struct.pack("<IHHHHHIIIHH", _LOCAL, _VERSION, 0, 0, 0, _DATE, crc, _UNKNOWN, _UNKNOWN, len(member), 20)
    return fixed + member + struct.pack("<HHQQ", 1, 16, size, size)


def reserve(path: Path, arrays: Arrays) -> dict[str, int]:
    """Begin a file with room for arrays of these names, shapes and types; returns where the numbers of each begin."""
    offsets = {}
    with path.open("wb") as stream:
        for name, (place, head, size) in _heads(arrays).items():
            stream.seek(place)
            stream.write(_local(name, size, 0) + head)
            offsets[name] = stream.tell()
    return offsets


def complete(path: Path, arrays: Arrays) -> None:
    """Write the check sums and the directory of a file that :func:`reserve` began and that has been filled."""
    with path.open("r+b") as stream:
        entries, end = b"", 0
        heads = _heads(arrays)
        for name, (place, _, size) in heads.items():
            begin = place + _local_length(name)
            crc = _check_sum(stream, begin, size)
            stream.seek(place)
            stream.write(_local(name, size, crc))
            member = _member(name)
            entries += struct.pack(
                "<IHHHHHHIIIHHHHHII",
                *(_CENTRAL, _VERSION, _VERSION, 0, 0, 0, _DATE, crc, _UNKNOWN, _UNKNOWN),
                *(len(member), 28, 0, 0, 0, 0, _UNKNOWN),
            )
            entries += member + struct.pack("<HHQQQ", 1, 24, size, size, place)
            end = begin + size
        count, directory = len(heads), len(entries)
        entries += struct.pack("<IQHHIIQQQQ", _END64, 44, _VERSION, _VERSION, 0, 0, count, count, directory, end)
        entries += struct.pack("<IIQI", _LOCATOR, 0, end + directory, 1)
        entries += struct.pack("<IHHHHIIH", _END, 0, 0, count, count, _UNKNOWN, _UNKNOWN, 0)
        stream.seek(end)
        stream.write(entries)
        stream.truncate()


def maps(path: str | os.PathLike[str], least: int) -> dict[str, np.ndarray]:
    """Read-only maps of the arrays of any ``.npz`` file that have at least so many bytes and are not compressed."""
    found: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive, open(path, "rb") as stream:
        for info in archive.infolist():
            if info.file_size < least or info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
                continue
            stream.seek(info.header_offset + 26)
            name, extra = struct.unpack("<HH", stream.read(4))
            stream.seek(info.header_offset + 30 + name + extra)
            version = np.lib.format.read_magic(stream)
            if version != (1, 0):
                continue
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            if not dtype.hasobject:
                order: Literal["F", "C"] = "F" if fortran else "C"
                found[info.filename.removesuffix(".npy")] = np.memmap(path, dtype, "r", stream.tell(), shape, order)
    return found


def _check_sum(stream: IO[bytes], begin: int, size: int) -> int:
    crc = 0
    for start in range(begin, begin + size, _BLOCK):
        crc = zlib.crc32(os.pread(stream.fileno(), min(_BLOCK, begin + size - start), start), crc)
    return crc
