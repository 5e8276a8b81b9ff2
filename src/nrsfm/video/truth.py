"""The truth about pixels that somebody else chose to track: interpolated between points whose tracks are known.

A rendered video knows the tracks and shapes of a grid of points of one frame; a tracker starts from pixels of a frame
of its own choice. In that frame the true points that are visible are triangulated (Delaunay); a tracked pixel gets the
weights of the triangle that it lies in (barycentric coordinates), and its true track and shape are the weighted means
of the three corners'. Pixels that are true points get those exactly. Triangles that reach across a gap, in the image or
in space, say nothing (ours).
"""

from __future__ import annotations

import dataclasses
import os

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.tracks import Tracks

_SAME = 0.01  # pixels within which a tracked pixel is a true point
_GAP = 2.5  # times the median edge in the image beyond which a triangle reaches across a gap
_DEEP = 5.0  # the same in space: a slanted surface has long edges


@dataclasses.dataclass(frozen=True, eq=False)
class VideoTruth:
    """What a file of truth holds.

    Attributes
    ----------
    tracks
        True tracks of N points, pixels of the video as it is in the file, or ``None``.
    shapes, valid
        (F, N, 3) and (F, N) or ``None``.
    rotations
        (F, 3, 3) or ``None``.
    image_size
        (width, height) that the tracks belong to, or ``None``.
    """

    tracks: Tracks | None
    shapes: np.ndarray | None
    valid: np.ndarray | None
    rotations: np.ndarray | None
    image_size: tuple[float, float] | None


@dataclasses.dataclass(frozen=True, eq=False)
class MatchedTruth:
    """The truth of P tracked pixels.

    Attributes
    ----------
    known
        (P,) bool: which of them have a truth; the other arrays hold zeros and false for the rest.
    tracks, visible
        (F, P, 2) pixels and (F, P) bool, or ``None``.
    shapes, valid
        (F, P, 3) and (F, P) bool, or ``None``.
    rotations
        (F, 3, 3) or ``None``.
    """

    known: np.ndarray
    tracks: np.ndarray | None
    visible: np.ndarray | None
    shapes: np.ndarray | None
    valid: np.ndarray | None
    rotations: np.ndarray | None


def load_video_truth(path: str | os.PathLike[str]) -> VideoTruth:
    """Read tracks, shapes and cameras, as far as a file has them, and ``image_size``.

    Raises
    ------
    FileError
        It has neither tracks nor shapes, or cannot be read.
    """
    from nrsfm.files import load_rotations, load_shapes, load_tracks
    from nrsfm.files.container import listing, open_arrays

    entries = open_arrays(path)
    names = set(entries)
    tracks = load_tracks(path) if names & {"tracks", "pred_tracks", "W", "points"} else None
    truth = load_shapes(path) if names & {"shapes", "S", "S_GT", "S_gt"} else None
    if tracks is None and truth is None:
        raise FileError(f"cannot use '{path}' as truth: tracks or shapes are needed; found {listing(entries)}")
    if tracks is not None and truth is not None and truth.shapes.shape[:2] != (tracks.n_frames, tracks.n_points):
        raise FileError(
            f"cannot use '{path}' as truth: shapes of {tracks.n_frames} frames and {tracks.n_points} points, as of the "
            f"tracks, are needed, received {truth.shapes.shape}"
        )
    try:
        rotations = load_rotations(path)
    except FileError:  # a truth without cameras is usual
        rotations = None
    size = None
    if "image_size" in entries:
        pair = np.asarray(entries["image_size"].read(), dtype=np.float64).ravel()
        if pair.shape != (2,) or not np.all(pair > 0):
            raise FileError(f"cannot use '{path}' as truth: image_size must be a width and a height, received {pair}")
        size = (float(pair[0]), float(pair[1]))
    return VideoTruth(
        tracks, None if truth is None else truth.shapes, None if truth is None else truth.valid, rotations, size
    )


def match_truth(
    truth: VideoTruth, pixels: np.ndarray, reference: int, numbers: np.ndarray, image_size: tuple[float, float]
) -> MatchedTruth:
    """Return the truth of the pixels (P, 2) of one frame.

    Parameters
    ----------
    truth
        From :func:`load_video_truth`. Without tracks its points must be the pixels, in their order.
    pixels
        x, y in the frames as they were tracked.
    reference
        Number of that frame among the tracked ones.
    numbers
        (F,) number of each tracked frame in the video; the truth may know all frames of the video, or just these.
    image_size
        (width, height) of the frames as they were tracked.

    Raises
    ------
    InputError
        The truth has another number of frames, or of points without saying where they are; or no pixel has a truth.
    """
    frames = truth.tracks.n_frames if truth.tracks is not None else len(_some(truth.shapes))
    if int(numbers[-1]) < frames:
        rows = np.asarray(numbers)
    elif frames == len(numbers):
        rows = np.arange(frames)
    else:
        raise InputError(
            f"truth: {len(numbers)} frames are needed, or at least {int(numbers[-1]) + 1}, as in the video, "
            f"received {frames}"
        )
    rotations = truth.rotations[rows] if truth.rotations is not None and len(truth.rotations) == frames else None
    if truth.tracks is None:
        shapes = _some(truth.shapes)
        if shapes.shape[1] != len(pixels):
            raise InputError(
                f"truth: tracks beside the shapes are needed, to know which of its {shapes.shape[1]} points each of "
                f"the {len(pixels)} tracked pixels is"
            )
        valid = np.ones((len(rows), len(pixels)), dtype=bool) if truth.valid is None else truth.valid[rows]
        return MatchedTruth(np.asarray(valid.any(axis=0)), None, None, shapes[rows], valid, rotations)
    points = truth.tracks.points[rows]
    if truth.image_size is not None and tuple(image_size) != truth.image_size:
        # Areas scale about the outer corner of the first pixel.
        points = (points + 0.5) * (np.asarray(image_size) / truth.image_size).astype(points.dtype) - 0.5
    visible = truth.tracks.visible
    visible = np.ones(points.shape[:2], dtype=bool) if visible is None else visible[rows]
    space = None if truth.shapes is None else truth.shapes[rows[reference]]
    corners, weights, known = _corners(points[reference], visible[reference], pixels, space)
    if not known.any():
        raise InputError("truth: at least one of the tracked pixels must be at a true point, none is")
    main = np.take_along_axis(corners, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    tracks = _mixed(points, corners, weights, known)
    seen = visible[:, main] & known
    if truth.shapes is None:
        return MatchedTruth(known, tracks, seen, None, None, rotations)
    shapes = _mixed(truth.shapes[rows], corners, weights, known)
    valid = np.broadcast_to(known, tracks.shape[:2]).copy()
    if truth.valid is not None:
        used = np.where(weights > 0, corners, main[:, None])
        valid &= truth.valid[rows][:, used].all(axis=2)
        shapes[~valid] = 0
    return MatchedTruth(known, tracks, seen, shapes, valid, rotations)


def _some(array: np.ndarray | None) -> np.ndarray:
    if array is None:
        raise InputError("truth: tracks or shapes are needed, received neither")
    return array


def _corners(
    points: np.ndarray, visible: np.ndarray, pixels: np.ndarray, space: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three true points (P, 3), their weights (P, 3), and which pixels have any (P,)."""
    from scipy.spatial import Delaunay, QhullError, cKDTree

    shown = np.flatnonzero(visible & np.isfinite(points).all(axis=1))
    corners = np.zeros((len(pixels), 3), dtype=np.int64)
    weights = np.zeros((len(pixels), 3))
    weights[:, 0] = 1
    known = np.zeros(len(pixels), dtype=bool)
    if not len(shown):
        return corners, weights, known
    places = points[shown].astype(np.float64)
    distance, nearest = cKDTree(places).query(pixels)
    known = distance <= _SAME
    corners[known] = shown[nearest[known], None]
    rest = np.flatnonzero(~known)
    if not len(rest) or len(shown) < 3:
        return corners, weights, known
    try:
        mesh = Delaunay(places)
    except QhullError:  # all on one line
        return corners, weights, known
    good = _within(places, mesh.simplices, _GAP)
    if space is not None:
        good &= _within(space[shown], mesh.simplices, _DEEP)
    found = mesh.find_simplex(pixels[rest].astype(np.float64))
    kept = (found >= 0) & good[found]
    rest, found = rest[kept], found[kept]
    transform = mesh.transform[found]
    inner = np.einsum("pij,pj->pi", transform[:, :2], pixels[rest] - transform[:, 2])
    three = np.clip(np.concatenate([inner, 1 - inner.sum(axis=1, keepdims=True)], axis=1), 0, 1)
    corners[rest], weights[rest], known[rest] = shown[mesh.simplices[found]], three / three.sum(axis=1)[:, None], True
    return corners, weights, known


def _within(places: np.ndarray, triangles: np.ndarray, factor: float) -> np.ndarray:
    sides = np.linalg.norm(places[triangles] - places[np.roll(triangles, 1, axis=1)], axis=2)
    longest: np.ndarray = sides.max(axis=1)
    return longest <= factor * float(np.median(sides))


def _mixed(values: np.ndarray, corners: np.ndarray, weights: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Weighted means (F, P, d) of the corners' values (F, N, d), frame by frame."""
    mixed = np.zeros((len(values), len(corners), values.shape[2]), dtype=values.dtype)
    at, by = corners[known], weights[known].astype(values.dtype)
    alone = by.max(axis=1) == 1
    for f, frame in enumerate(values):
        # A corner of weight 0 may be unknown, and 0 · NaN is NaN.
        mean = np.einsum("pk,pkd->pd", by, np.where(by[..., None] > 0, frame[at], 0))
        mean[alone] = frame[np.take_along_axis(at, by.argmax(axis=1)[:, None], axis=1)[:, 0]][alone]
        mixed[f, known] = mean
    return mixed
