"""NumPy ``.npz`` files: named arrays in a zip archive, never unpickled."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from nrsfm.files import npy
from nrsfm.files.container import Entry


def read(path: Path) -> dict[str, Entry]:
    """Return the arrays of an ``.npz`` file by name; members that are not arrays are left out."""
    entries = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.filename.endswith(".npy"):
                name = member.filename.removesuffix(".npy")
                entries[name] = _entry(path, archive, member, name)
    return entries


def _entry(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> Entry:
    with archive.open(member) as stream:
        shape, dtype = npy.header(stream)
        held = member.file_size - stream.tell()

    def read_array() -> np.ndarray:
        npy.check(name, shape, dtype, held)
        with zipfile.ZipFile(path) as again, again.open(member.filename) as stream:
            array: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
            return array

    return Entry(shape, "object" if dtype.hasobject else str(dtype), read_array)
