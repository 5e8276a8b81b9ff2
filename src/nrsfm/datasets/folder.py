"""Where the data sets lie on this machine, and reading arrays from there."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.container import listing, open_arrays

VARIABLE = "NRSFM_DATA"


def data_folder(root: str | os.PathLike[str] | None = None) -> Path:
    """Return the folder of the data sets: ``root``, or what the environment variable ``NRSFM_DATA`` says.

    Raises
    ------
    FileError
        Neither is given, or it is not a folder.
    """
    if root is not None:
        folder, source = Path(root), "root"
    else:
        value = os.environ.get(VARIABLE, "")
        if not value:
            raise FileError(
                f"the folder of the data sets is not known: give root=, or set the environment variable {VARIABLE}"
            )
        folder, source = Path(value), f"the environment variable {VARIABLE}"
    if not folder.is_dir():
        raise FileError(f"the folder of the data sets must exist, received '{folder}' (from {source})")
    return folder


class DataFile:
    """The arrays of one file of the folder, each read when asked for."""

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / name
        if not self.path.is_file():
            raise FileError(f"the data set needs the file '{name}' in folder '{folder}', which is not there")
        self._entries = open_arrays(self.path)

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._entries:
            raise FileError(f"cannot use '{self.path}': array '{name}' is missing; found {listing(self._entries)}")
        return self._entries[name].read()
