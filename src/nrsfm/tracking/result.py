"""What tracking gives: tracks, confidence, where the points lie in the reference frame, and how it went."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, suggest
from nrsfm.files.atomic import atomic_file
from nrsfm.tracking.options import TrackingOptions
from nrsfm.tracks import Tracks


@dataclasses.dataclass(frozen=True, eq=False)
class Layout:
    """Where the points come from: pixels of the reference frame on a grid.

    Attributes
    ----------
    pixels
        (P, 2) int32 x, y in the reference frame, row by row.
    step
        Pixels between neighbouring points.
    colours
        (P, 3) uint8 RGB (grey images: three equal values).
    image_size
        (width, height) of the frames.
    """

    pixels: np.ndarray
    step: int
    colours: np.ndarray
    image_size: tuple[int, int]

    def faces(self) -> np.ndarray:
        """Return triangles (M, 3) of neighbouring points, two for every square whose corners are all there."""
        cells = self.pixels // self.step
        low = cells.min(axis=0)
        columns, rows = cells.max(axis=0) - low + 1
        number = np.full((rows, columns), -1, dtype=np.int64)
        number[cells[:, 1] - low[1], cells[:, 0] - low[0]] = np.arange(len(cells))
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
        a, b, c, d = a[whole], b[whole], c[whole], d[whole]
        return np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])


@dataclasses.dataclass(frozen=True, eq=False)
class TrackingDiagnostics:
    """How it went.

    Attributes
    ----------
    method, reference
        What was used.
    likeness
        (F,) mean local correlation of each frame with the reference over the visible points.
    photometric_error
        (F,) mean absolute difference to the reference over the visible points, grey levels of evened-out images
        (one local deviation is 40); NaN where none is visible.
    visible
        (F,) share of the points that are visible.
    rank
        Number of basis trajectories, 0 where there is no subspace.
    residual
        Root mean square distance of trusted flow from the subspace, pixels, or after the photometric fit what windows
        of the images would still move it by; NaN where there is no subspace.
    scale
        How many times the images were enlarged for matching.
    seconds
        Wall time of each stage, by name.
    options
        The options used.
    """

    method: str
    reference: int
    likeness: np.ndarray
    photometric_error: np.ndarray
    visible: np.ndarray
    rank: int
    residual: float
    scale: float
    seconds: dict[str, float]
    options: TrackingOptions


@dataclasses.dataclass(frozen=True, eq=False)
class TrackingResult:
    """Tracks of the reference pixels, with (F, P) float32 ``confidence`` and ``deviation`` beside them.

    ``confidence`` in [0, 1] tells whether the point is seen, ``deviation`` how far off it then may be: the standard
    deviation of each coordinate in pixels (:mod:`nrsfm.tracking.deviation`). Where a point is not visible its
    coordinates are the model's prediction; no claim is made about them, and the deviation is infinite.
    """

    tracks: Tracks
    confidence: np.ndarray
    deviation: np.ndarray
    layout: Layout
    diagnostics: TrackingDiagnostics


def save_tracking(result: TrackingResult, path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
    """Write tracks with confidence, deviation, pixels, colours and reference to .h5, .hdf5 or .npz.

    The arrays ``tracks`` and ``visible`` are those that :func:`nrsfm.load_tracks` reads; ``confidence`` (F, P),
    ``deviation`` (F, P), ``pixels`` (P, 2), ``colours`` (P, 3), ``faces`` (M, 3), ``image_size`` and ``reference`` lie
    beside them.

    Raises
    ------
    FileError
        Another extension, the file exists and ``overwrite`` is false, or it cannot be written.
    """
    extension = Path(path).suffix.lower()
    known = (".h5", ".hdf5", ".npz")
    if extension not in known:
        raise FileError(
            f"cannot save dense tracks as '{path}': the name must end in {', '.join(known)}{suggest(extension, known)}"
        )
    arrays: dict[str, Any] = {
        "tracks": result.tracks.points,
        "visible": result.tracks.visible,
        "confidence": result.confidence,
        "deviation": result.deviation,
        "pixels": result.layout.pixels,
        "colours": result.layout.colours,
        "faces": result.layout.faces().astype(np.int32),
        "image_size": np.array(result.layout.image_size),
        "reference": np.array(result.diagnostics.reference),
    }
    with atomic_file(path, overwrite=overwrite) as stream:
        if extension == ".npz":
            np.savez(stream, **arrays)
        else:
            import h5py

            with h5py.File(stream, "w") as file:
                for name, array in arrays.items():
                    file[name] = array
