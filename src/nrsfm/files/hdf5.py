"""HDF5 files: datasets by their path. MATLAB 7.3 files are HDF5 too, with every array transposed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.files.container import DamagedFileError, Entry, check_size


def read(path: Path) -> dict[str, Entry]:
    """Return the datasets of an HDF5 file by path ("tracks", "group/tracks").

    A dataset that MATLAB wrote says so in an attribute, and is transposed back.
    """
    return read_datasets(path, matlab=False)


def read_datasets(path: Path, matlab: bool) -> dict[str, Entry]:
    """Return the datasets; ``matlab`` transposes all of them, marked or not, and joins sparse matrices."""
    import h5py

    entries: dict[str, Entry] = {}

    def visit(name: str, item: Any) -> None:
        if name.startswith("#"):  # MATLAB's own bookkeeping: #refs#, #subsystem#
            return
        if isinstance(item, h5py.Group):
            if "MATLAB_sparse" in item.attrs:
                entries[name] = _sparse(path, name, item)
        elif isinstance(item, h5py.Dataset) and "MATLAB_sparse" not in item.parent.attrs:
            entries[name] = _dataset(path, name, item, matlab)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return entries


def _dataset(path: Path, name: str, item: Any, matlab: bool) -> Entry:
    turned = matlab or "MATLAB_class" in item.attrs
    kind = item.attrs.get("MATLAB_class", b"")
    word = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
    if "MATLAB_empty" in item.attrs:  # then the data are the sizes, one of which is 0
        sizes = tuple(int(n) for n in np.ravel(item[()]))
        return Entry(sizes, str(item.dtype), lambda: np.empty(sizes))
    shape = tuple(item.shape or ())

    def read_array() -> np.ndarray:
        import h5py

        with h5py.File(path, "r") as file:
            array = np.asarray(file[name][()])
        return array.T if turned else array

    def stored() -> Any:
        import h5py

        return h5py.File(path, "r")[name]  # the dataset keeps its file open

    dtype = "cell" if word == "cell" else "object" if item.dtype.kind == "O" else str(item.dtype)
    return Entry(shape[::-1] if turned else shape, dtype, read_array, None if turned else stored)


def _sparse(path: Path, name: str, group: Any) -> Entry:
    """A sparse matrix of MATLAB 7.3: values, row numbers and column starts; handed out dense."""
    rows, columns = int(group.attrs["MATLAB_sparse"]), len(group["jc"]) - 1

    def read_array() -> np.ndarray:
        import h5py
        from scipy.sparse import csc_array

        # A benchmark's block-diagonal cameras are the use; anything much larger is not a camera file.
        check_size(name, (rows, columns), 8, 1 << 31)
        with h5py.File(path, "r") as file:
            group = file[name]
            starts = group["jc"][()].astype(np.int64)
            data = group["data"][()] if "data" in group else np.empty(0)
            indices = group["ir"][()].astype(np.int64) if "ir" in group else np.empty(0, dtype=np.int64)
        if indices.size and (indices.min() < 0 or indices.max() >= rows):
            raise DamagedFileError(f"sparse matrix '{name}' has row numbers outside its {rows} rows")
        matrix = csc_array((data, indices, starts), shape=(rows, columns))
        dense: np.ndarray = matrix.toarray()
        return dense

    return Entry((rows, columns), "sparse", read_array)
