"""Arrays as few bytes: differences between neighbours, split into planes of bytes, deflated.

Neighbouring numbers are alike, so that their differences (modulo 2^bits: nothing is lost) are small, their high bytes
are nearly all 0 or 255, and planes of such bytes deflate well. The script undoes it: planes joined, differences summed,
with the same overflow.

Source: ours; the parts are old (PNG's filters, HDF5's shuffle); deflate is RFC 1950 and 1951.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

LEVEL = 7
_TYPES = {"u1": "u8", "i1": "i8", "u2": "u16", "i2": "i16", "u4": "u32", "f4": "f32"}


class Writer:
    """Collects named arrays; :meth:`finish` gives the bytes, and ``parts`` says where each array is."""

    def __init__(self) -> None:
        self.parts: list[dict[str, Any]] = []
        self._data: list[bytes] = []
        self._at = 0

    def add(self, name: str, array: np.ndarray, along: str = "") -> None:
        """Add an array (rows, columns); ``along`` is ``"columns"``, ``"rows"`` or nothing: where neighbours are alike.

        Types: uint8, int8, uint16, int16, uint32, and float32, which is only split.
        """
        array = np.atleast_2d(array)
        small = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        kind = _TYPES[small.dtype.str[1:]]
        if along:
            axis = 1 if along == "columns" else 0
            small = np.diff(small, axis=axis, prepend=np.zeros_like(np.take(small, [0], axis=axis)))
        planes = small.reshape(-1, 1).view(np.uint8).T.tobytes()
        rows, columns = array.shape
        part = {"name": name, "type": kind, "rows": rows, "columns": columns, "along": along, "at": self._at}
        self.parts.append(part)
        self._data.append(planes)
        self._at += len(planes)

    def finish(self) -> bytes:
        """Return all arrays, deflated (zlib)."""
        return zlib.compress(b"".join(self._data), LEVEL)


def read(parts: list[dict[str, Any]], data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays again: what the script does, for tests and for measuring what packing costs."""
    names = {value: key for key, value in _TYPES.items()}
    raw = np.frombuffer(zlib.decompress(data), dtype=np.uint8)
    found = {}
    for part in parts:
        dtype = np.dtype("<" + names[part["type"]])
        rows, columns = part["rows"], part["columns"]
        size = rows * columns * dtype.itemsize
        planes = raw[part["at"] : part["at"] + size].reshape(dtype.itemsize, -1)
        array = np.ascontiguousarray(planes.T).view(dtype).reshape(rows, columns)
        if part["along"]:
            array = np.cumsum(array, axis=1 if part["along"] == "columns" else 0, dtype=dtype)
        found[part["name"]] = array
    return found
