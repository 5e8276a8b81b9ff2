"""The dense benchmark as its owners publish it: ``.mat`` files with W, S and R_GT.

Faces 1 to 4 (Garg et al. 2013) hold all three; Actor (Beeler et al. 2011) has shapes, and cameras made for
it; Kinect paper and T-shirt (Varol et al. 2012) have tracks inside a window of the first image.
"""

from __future__ import annotations

import dataclasses
import logging
import os
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.datasets.sequence import Sequence, choose_dtype, largest_deviation, project
from nrsfm.errors import FileError, InputError, suggest
from nrsfm.files import Truth, load_rotations, load_shapes, load_tracks
from nrsfm.files.container import listing, open_arrays
from nrsfm.tracks import Tracks

logger = logging.getLogger(__name__)

# How well W = R S holds in a file whose three arrays belong together; stored singles give 1e-7.
_CONSISTENT = 1e-3
_SHAPES, _CAMERAS = ("S", "S_GT", "S_gt", "shapes"), ("R_GT", "R_gt", "R", "Rs", "rotations")


@dataclasses.dataclass(frozen=True)
class Window:
    """A rectangle of the first image, in pixels, ends included, and the number of frames it belongs to."""

    x: tuple[float, float]
    y: tuple[float, float]
    frames: int | None = None


KINECT_WINDOWS = {
    "kinect-paper": Window((253, 508), (132, 363), 193),
    "kinect-tshirt": Window((203, 468), (112, 403), 313),
}
"""The windows in which the paper tracked the Kinect sequences (its section on paper and T-shirt)."""


def load_benchmark_mat(
    path: str | os.PathLike[str], *, window: str | Window | None = None, dtype: Any = None
) -> Sequence:
    """Read a benchmark file: ``W`` (2F×P), and ``S`` (3F×P) and ``R_GT`` (3F×3F, block-diagonal) if there.

    Parameters
    ----------
    path
        A ``.mat`` file (5 or 7.3), or any other format of :func:`~nrsfm.files.load_tracks` with these names.
        A file with S and cameras but no W (Actor) gets tracks by orthographic projection.
    window
        Keep the points inside a window of the first frame: a name of ``KINECT_WINDOWS``, or a
        :class:`Window`.
    dtype
        float32 or float64; by default the file's.

    Raises
    ------
    FileError
        The file has none of these, or is damaged, or its arrays are of different sequences.
    InputError
        An argument is out of range.
    """
    entries = open_arrays(path)
    has_shapes, has_cameras = (any(n in entries for n in known) for known in (_SHAPES, _CAMERAS))
    truth = load_shapes(path) if has_shapes else None
    rotations = load_rotations(path) if has_cameras else None
    name = Path(path).stem
    note: dict[str, Any] = {"origin": str(path), "units": "the file's", "camera": "orthographic"}
    if "W" in entries:
        tracks = load_tracks(path, name="W")
    elif truth is not None and rotations is not None:
        _check_frames(path, len(truth.shapes), len(rotations), "S", "the cameras")
        tracks = Tracks(project(truth.shapes, rotations), truth.valid)
        note["camera"] = "orthographic; the tracks were made from S and the cameras, the file has no W"
    else:
        raise FileError(f"cannot use '{path}': W, or S and R_GT, are needed; found {listing(entries)}")
    if dtype is not None:
        kind = choose_dtype(dtype, tracks.points.size)
        tracks = Tracks(tracks.points.astype(kind, copy=False), tracks.visible)
        truth = None if truth is None else Truth(truth.shapes.astype(kind, copy=False), truth.valid)
    if truth is not None and truth.shapes.shape[:2] != tracks.points.shape[:2]:
        raise FileError(
            f"cannot use '{path}': W has {tracks.n_frames} frames of {tracks.n_points} points, S has "
            f"{truth.shapes.shape[0]} of {truth.shapes.shape[1]}"
        )
    if rotations is not None:
        _check_frames(path, tracks.n_frames, len(rotations), "W", "the cameras")
    if truth is not None and rotations is not None and truth.valid is None:
        note["mismatch"] = _mismatch(tracks, truth.shapes, rotations)
        if note["mismatch"] > _CONSISTENT:
            logger.warning("%s: W differs from R S by %.2g of its largest entry", path, note["mismatch"])
    shapes, valid = (None, None) if truth is None else (truth.shapes, truth.valid)
    sequence = Sequence(name, tracks, shapes, rotations, valid, note=note)
    return sequence if window is None else crop_to_window(sequence, window)


def crop_to_window(sequence: Sequence, window: str | Window) -> Sequence:
    """Return the sequence with only those points that the first frame shows inside ``window``.

    A number of frames other than the window's is logged as a warning; nothing is cut in time.

    Raises
    ------
    InputError
        The window's name is unknown, or no point is inside.
    """
    if isinstance(window, str):
        if window not in KINECT_WINDOWS:
            raise InputError(
                f"'{window}' is not a window; known: {', '.join(KINECT_WINDOWS)}{suggest(window, KINECT_WINDOWS)}"
            )
        window = KINECT_WINDOWS[window]
    first = sequence.tracks.points[0]
    (left, right), (top, bottom) = window.x, window.y
    inside = (first[:, 0] >= left) & (first[:, 0] <= right) & (first[:, 1] >= top) & (first[:, 1] <= bottom)
    visible = sequence.tracks.visible
    if visible is not None:
        inside &= visible[0]
    if not inside.any():
        raise InputError(
            f"{sequence.name}: the window x {left:g} to {right:g}, y {top:g} to {bottom:g} holds no point; "
            f"the first frame spans x {first[:, 0].min():g} to {first[:, 0].max():g}, y "
            f"{first[:, 1].min():g} to {first[:, 1].max():g}"
        )
    if window.frames is not None and window.frames != sequence.tracks.n_frames:
        logger.warning("%s: %d frames belong to the window, %d found", sequence.name, window.frames,
                       sequence.tracks.n_frames)  # fmt: skip
    return dataclasses.replace(
        sequence,
        tracks=Tracks(sequence.tracks.points[:, inside], None if visible is None else visible[:, inside]),
        faces=None,
        edges=None,
        note={**sequence.note, "window": {"x": [left, right], "y": [top, bottom]}},
        shapes=None if sequence.shapes is None else sequence.shapes[:, inside],
        valid=None if sequence.valid is None else sequence.valid[:, inside],
    )


def _check_frames(path: str | os.PathLike[str], one: int, other: int, first: str, second: str) -> None:
    if one != other:
        raise FileError(f"cannot use '{path}': {first} has {one} frames, {second} have {other}")


def _mismatch(tracks: Tracks, shapes: np.ndarray, rotations: np.ndarray) -> float:
    """max|W − R S| / max|W|, each row centred: 0 where the three belong together under orthography."""
    largest = 0.0
    for f, frame in enumerate(tracks.points):
        gap = frame - shapes[f].astype(np.float64) @ rotations[f, :2].T
        if tracks.visible is not None:
            gap = gap[tracks.visible[f]]
        if gap.size:
            largest = max(largest, float(np.abs(gap - gap.mean(axis=0)).max()))
    scale = largest_deviation(tracks)
    return largest / scale if scale > 0 else largest
