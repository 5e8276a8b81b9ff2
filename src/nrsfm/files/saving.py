"""Tracks to .npz, .h5 and .csv files, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from nrsfm.errors import FileError, InputError, suggest
from nrsfm.files.atomic import atomic_file
from nrsfm.tracks import Tracks


def save_tracks(tracks: Tracks, path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
    """Write tracks in the format of the extension (.npz, .h5, .hdf5, .csv); ``load_tracks`` gives them back.

    .npz and .h5 hold ``tracks`` (F, P, 2) and, where some are missing, ``visible`` (F, P) bool, and keep the
    dtype. .csv holds one row ``frame,point,x,y,visible`` per entry, counted from 0, with all digits (read
    back as float64).

    Raises
    ------
    FileError
        The extension is another, the file exists and ``overwrite`` is false, or it cannot be written.
    """
    if not isinstance(tracks, Tracks):
        raise InputError(f"tracks: a Tracks object is needed, received {type(tracks).__name__}")
    extension = Path(path).suffix.lower()
    if extension not in _WRITERS:
        raise FileError(
            f"cannot save tracks as '{path}': the name must end in {', '.join(_WRITERS)}{suggest(extension, _WRITERS)}"
        )
    with atomic_file(path, overwrite=overwrite) as stream:
        _WRITERS[extension](tracks, stream)


def _arrays(tracks: Tracks) -> dict[str, np.ndarray]:
    arrays = {"tracks": tracks.points}
    if tracks.visible is not None:
        arrays["visible"] = tracks.visible
    return arrays


def _write_npz(tracks: Tracks, stream: IO[bytes]) -> None:
    arrays: dict[str, Any] = _arrays(tracks)
    np.savez(stream, **arrays)


def _write_hdf5(tracks: Tracks, stream: IO[bytes]) -> None:
    import h5py

    with h5py.File(stream, "w") as file:
        for name, array in _arrays(tracks).items():
            file[name] = array


def _write_csv(tracks: Tracks, stream: IO[bytes]) -> None:
    digits = "%.9g" if tracks.points.dtype == np.float32 else "%.17g"
    stream.write(b"frame,point,x,y,visible\n")
    index = np.arange(tracks.n_points)
    for f, frame in enumerate(tracks.points):
        seen = np.ones(tracks.n_points, dtype=bool) if tracks.visible is None else tracks.visible[f]
        table = np.column_stack([np.full(tracks.n_points, f), index, frame, seen])
        np.savetxt(stream, table, fmt=["%d", "%d", digits, digits, "%d"], delimiter=",")


_WRITERS: dict[str, Callable[[Tracks, IO[bytes]], None]] = {
    ".npz": _write_npz,
    ".h5": _write_hdf5,
    ".hdf5": _write_hdf5,
    ".csv": _write_csv,
}
