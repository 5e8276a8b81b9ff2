"""MATLAB ``.mat`` files: version 5 (and 4) through SciPy, version 7.3, which is HDF5, through h5py."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nrsfm.files.container import Entry, check_size
from nrsfm.files.hdf5 import read_datasets

# What deflate can blow up at most; a header that asks for more than this belongs to a damaged file.
_DEFLATE = 1040
_NOT_NUMBERS = ("cell", "struct", "object", "char", "function", "opaque", "unknown")


def read(path: Path) -> dict[str, Entry]:
    """Return the variables of a ``.mat`` file by name, as MATLAB sees them: 2-D at least, not transposed."""
    import h5py

    if h5py.is_hdf5(path):
        return read_datasets(path, matlab=True)
    return _read_v5(path)


def _read_v5(path: Path) -> dict[str, Entry]:
    from scipy.io import loadmat, whosmat

    limit = path.stat().st_size * _DEFLATE
    entries = {}
    for name, shape, kind in whosmat(str(path)):
        size = tuple(int(n) for n in shape)

        def read_array(name: str = name, size: tuple[int, ...] = size, kind: str = kind) -> np.ndarray:
            if kind != "sparse":
                check_size(name, size, 1, limit)
            value = loadmat(str(path), variable_names=[name])[name]
            return np.asarray(value.toarray() if kind == "sparse" else value)

        entries[name] = Entry(size, kind, read_array)
    return entries
