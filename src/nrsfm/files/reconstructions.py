"""The file of a reconstruction: one ``.npz`` without pickled objects. What its arrays mean: nrsfm.reconstruction."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.files import npz_in_place
from nrsfm.files.atomic import atomic_file

if TYPE_CHECKING:
    from nrsfm.reconstruction import Reconstruction

FORMAT = "nrsfm-reconstruction-1"
ARRAYS = ("shapes", "rotations", "translations", "scales")
OPTIONAL = ("groups", "confidence", "depth_deviation")
"""Arrays that a file may lack: those of an older version, and those of a method that has none."""
ABOUT = "about"
"""The JSON text with the rest."""

LARGE = 256 * 2**20
"""Bytes from which on an array stays in its file and is mapped."""


def write_reconstruction(result: Reconstruction, path: str | os.PathLike[str], *, overwrite: bool) -> None:
    """Write the file, whole or not at all; errors as :meth:`~nrsfm.reconstruction.Reconstruction.save`."""
    if Path(path).suffix.lower() != ".npz":
        raise FileError(f"cannot save a reconstruction as '{path}': the name must end in .npz")
    about = {
        "format": FORMAT,
        "method": result.method,
        "options": result.options,
        "diagnostics": result.diagnostics,
    }
    try:
        text = json.dumps(about, default=_plain)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot save '{path}': options or diagnostics do not fit JSON: {error}") from error
    arrays = {name: getattr(result, name) for name in (*ARRAYS, *OPTIONAL)}
    given: dict[str, Any] = {name: array for name, array in arrays.items() if array is not None}
    if _lies_in(result.shapes, path):  # they were written there block by block: the rest joins them
        del given["shapes"]
        if _lies_in(given.get("depth_deviation"), path):
            del given["depth_deviation"]
        _append(path, {"about": np.array(text), **given})
        return
    with atomic_file(path, overwrite=overwrite) as stream:
        # Not compressed: the mantissas of coordinates are noise, and the gain would be a few percent.
        np.savez(stream, about=np.array(text), **given)


def _lies_in(array: np.ndarray | None, path: str | os.PathLike[str]) -> bool:
    """Whether an array is a map of this very file."""
    name = getattr(array, "filename", None)
    return name is not None and Path(path).exists() and os.path.samefile(name, path)


def _append(path: str | os.PathLike[str], arrays: dict[str, np.ndarray]) -> None:
    """Add arrays to a ``.npz`` file."""
    with zipfile.ZipFile(path, "a", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)


def read_reconstruction(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the attributes of a saved reconstruction, not yet checked; errors as ``load_reconstruction``."""
    found = _read_arrays(path)
    about = _read_about(path, found.pop(ABOUT))
    return {**found, "diagnostics": about["diagnostics"], "method": about["method"], "options": about["options"]}


def _read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    try:
        with open(path, "rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise FileError(f"'{path}' is not a reconstruction: it is not a .npz file, or it is truncated")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                missing = [name for name in (*ARRAYS, ABOUT) if name not in archive.files]
                if missing:
                    listed = ", ".join(sorted(archive.files)) or "nothing"
                    raise FileError(f"'{path}' is not a reconstruction: {', '.join(missing)} missing, found {listed}")
                maps = npz_in_place.maps(path, LARGE)
                wanted = [name for name in (*ARRAYS, ABOUT, *OPTIONAL) if name in archive.files]
                return {name: maps[name] if name in maps else archive[name] for name in wanted}
    except FileError:  # a ValueError too: keep it from the clause below
        raise
    except OSError as error:
        raise FileError(f"cannot read '{path}': {error.strerror or error}") from error
    except (
        zipfile.BadZipFile,
        zlib.error,
        ValueError,
        EOFError,
        KeyError,
        RuntimeError,
        MemoryError,
    ) as error:
        # ValueError covers pickled members and malformed headers, RuntimeError encrypted ones.
        raise FileError(f"'{path}' is not a reconstruction: {_first_line(error)}") from error


def _read_about(path: str | os.PathLike[str], array: np.ndarray) -> dict[str, Any]:
    try:
        about = json.loads(str(array[()])) if array.dtype.kind == "U" and array.ndim == 0 else None
    except ValueError:
        about = None
    if not isinstance(about, dict) or not {"format", "method", "options", "diagnostics"} <= about.keys():
        raise FileError(f"'{path}' is not a valid reconstruction: 'about' is not the JSON text that save() writes")
    if about["format"] != FORMAT:
        raise FileError(f"'{path}' has format {about['format']!r}, and this version of nrsfm reads '{FORMAT}'")
    return about


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__


def _plain(value: Any) -> Any:
    """JSON's word for a NumPy scalar or array."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r}")
