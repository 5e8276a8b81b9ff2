"""What a picture needs to know, worked out once: alignment with the truth, cameras, frames to show, sizes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, TypedDict

import numpy as np

from nrsfm.errors import InputError, suggest
from nrsfm.metrics import ALIGNMENTS
from nrsfm.viewing.render import surface_triangles

_SAMPLE = 600  # points that are enough to tell frames and sizes apart


@dataclasses.dataclass(frozen=True)
class Scene:
    """Shapes of the chosen frames, centred, in one object frame (the truth's, if there is one), and views.

    Attributes
    ----------
    frames
        (n,) the frames shown.
    shapes, truth
        (n, P, 3) reconstruction and truth, or ``None`` for no truth; NaN where a point is not known. The truth of
        a point that was not reconstructed is there.
    views
        (n, 3, 3) camera from object in each frame shown.
    middle
        (3, 3) the average view.
    triangles, edges
        (M, 3) triangles or (E, 2) lines between points, or ``None``.
    errors
        (n,) relative error e3D of each frame shown, or ``None``.
    size
        RMS distance of the (true) points from their centre: a point error of 1% of it, everywhere, is an e3D
        of 1%.
    alignment
        In plain words.
    """

    frames: np.ndarray
    shapes: np.ndarray
    truth: np.ndarray | None
    views: np.ndarray
    middle: np.ndarray
    triangles: np.ndarray | None
    edges: np.ndarray | None
    errors: np.ndarray | None
    size: float
    alignment: str

    def point_errors(self) -> np.ndarray:
        """Distance (n, P) of every point from the truth; NaN where either is not known."""
        if self.truth is None:
            raise InputError("truth: true shapes are needed to draw errors, received none")
        return np.asarray(np.linalg.norm(self.shapes - self.truth, axis=2))


_WORDS = {
    "none": "not aligned",
    "global": "one alignment for the sequence",
    "per-frame": "aligned in each frame",
    "similarity": "aligned and scaled in each frame",
}


def shape_array(value: Any, name: str) -> np.ndarray:
    """Return shapes (F, P, 3) of an array or an object with ``.shapes``; raises ``InputError`` otherwise."""
    array = np.asarray(getattr(value, "shapes", value))
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0 or array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real shapes (frames, points, 3) are needed, received {array.dtype} {array.shape}")
    return array


def _cameras(value: Any, frames: int, name: str) -> np.ndarray | None:
    if value is None:
        return None
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((frames, 3, 3), (frames, 2, 3)):
        raise InputError(f"{name}: shape ({frames}, 3, 3) is needed, received {array.shape}")
    x, y = array[:, 0], array[:, 1]
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _indices(value: Any, name: str, corners: tuple[int, ...], points: int) -> np.ndarray | None:
    if value is None:
        return None
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] not in corners or array.dtype.kind not in "iu":
        raise InputError(
            f"{name}: integers of shape (n, {corners[0]}) are needed, received {array.dtype} {array.shape}"
        )
    if array.size and (array.min() < 0 or array.max() >= points):
        raise InputError(f"{name}: point numbers from 0 to {points - 1} are needed, received {array.max()}")
    if array.shape[1] == 4:  # quads
        array = np.concatenate([array[:, [0, 1, 2]], array[:, [0, 2, 3]]])
    return array.astype(np.int64) if array.size else None


class SceneOptions(TypedDict, total=False):
    """Keywords that the figures share; each may be left out."""

    faces: Any
    """(M, 3) triangles or (M, 4) quads of points. Without faces and edges a surface is triangulated where the
    points lie on one sheet; else they are drawn as discs or dots."""
    edges: Any
    """(E, 2) lines between points."""
    valid: Any
    """(F, P) bool: which true points are known."""
    rotations: Any
    """(F, 3, 3) cameras, camera from object, where the reconstruction has none of its own."""
    truth_rotations: Any
    """(F, 3, 3) true cameras. With them shapes are drawn as the true camera saw them, else as the estimated
    one."""
    frames: Any
    """Frames to draw; by default those most unlike one another."""
    count: int
    """How many frames to choose; 5."""
    align: str
    """How the reconstruction is aligned with the truth, as in :func:`nrsfm.shape_error`; "per-frame"."""


def choose_frames(shapes: np.ndarray, count: int) -> np.ndarray:
    """Return up to ``count`` frames, in order, whose shapes (F, P, 3) differ most from one another."""
    total = len(shapes)
    if count >= total:
        return np.arange(total)
    step = max(1, shapes.shape[1] // _SAMPLE)
    sample = np.asarray(shapes[:, ::step], dtype=np.float64)
    sample = sample[:, np.isfinite(sample).all(axis=(0, 2))]
    if sample.shape[1] < 2:
        return np.unique(np.linspace(0, total - 1, count).round().astype(int))
    sample = (sample - sample.mean(axis=1, keepdims=True)).reshape(total, -1)
    gram = sample @ sample.T
    square = np.diag(gram)
    gaps = square[:, None] + square[None] - 2.0 * gram
    chosen = [int(np.argmax(gaps.mean(axis=1)))]
    nearest = gaps[chosen[0]].copy()
    while len(chosen) < count:
        nearest[chosen] = -1.0
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, gaps[chosen[-1]])
    return np.sort(chosen)


def _frames(value: Any, shapes: np.ndarray, count: int) -> np.ndarray:
    if value is None:
        return choose_frames(shapes, count)
    array = np.atleast_1d(np.asarray(value))
    if array.ndim != 1 or array.size == 0 or array.dtype.kind not in "iu":
        raise InputError(f"frames: a list of frame numbers is needed, received {value!r}")
    if array.min() < 0 or array.max() >= len(shapes):
        raise InputError(f"frames: numbers from 0 to {len(shapes) - 1} are needed, received {array.tolist()}")
    return array


def _centred(frame: np.ndarray, known: np.ndarray) -> np.ndarray:
    frame = np.asarray(frame, dtype=np.float64)
    return frame - (frame[known].mean(axis=0) if known.any() else 0.0)


def _pairs(shapes: np.ndarray, truth: np.ndarray, valid: np.ndarray | None, frames: Any) -> Iterator[Any]:
    for f in frames:
        known = np.isfinite(shapes[f]).all(axis=1) & np.isfinite(truth[f]).all(axis=1)
        if valid is not None:
            known &= valid[f]
        yield known, _centred(shapes[f], known), _centred(truth[f], known)


def mean_shape(shapes: np.ndarray) -> np.ndarray:
    """Mean (P, 3), or (P, 2), over the frames in which each point is known; NaN where it never is."""
    known = np.isfinite(shapes).all(axis=2)
    total = np.where(known[..., None], shapes, 0.0).sum(axis=0)
    count = known.sum(axis=0)[:, None]
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _mean_of_either(moved: np.ndarray, aligned: np.ndarray | None) -> np.ndarray:
    """Mean (P, 3) of the reconstruction, and of the truth for points that were not reconstructed."""
    mean = mean_shape(moved)
    return mean if aligned is None else np.where(np.isfinite(mean), mean, mean_shape(aligned))


def _turn(cross: np.ndarray) -> np.ndarray:
    """Orthogonal Q that maximises trace(Qᵀ cross): the mirror is allowed, because cameras cannot see it."""
    u, _, vt = np.linalg.svd(cross)
    return np.asarray(u @ vt)


def _average(views: np.ndarray) -> np.ndarray:
    hands = np.sign(np.linalg.det(views))
    hand = 1.0 if hands.sum() >= 0 else -1.0
    views = views[hands == hand]  # mirrored views, if some are, cannot be averaged with the others
    u, singular, vt = np.linalg.svd(views.sum(axis=0))
    if singular[1] < 1e-6 * len(views):  # the views cancel out: no average exists
        return views[len(views) // 2]
    return np.asarray(u @ np.diag([1.0, 1.0, hand * np.sign(np.linalg.det(u @ vt))]) @ vt)


def make_scene(
    reconstruction: Any,
    truth: Any = None,
    *,
    faces: Any = None,
    edges: Any = None,
    valid: Any = None,
    rotations: Any = None,
    truth_rotations: Any = None,
    frames: Any = None,
    count: int = 5,
    align: str = "per-frame",
) -> Scene:
    """Check the arguments that every figure shares and work out a :class:`Scene`.

    ``reconstruction`` is a ``Reconstruction`` or shapes (F, P, 3) with ``rotations`` (F, 3, 3), camera from
    object; without any, the object is seen along its z axis. Raises ``InputError`` for arrays that do not
    fit together.
    """
    shapes = shape_array(reconstruction, "reconstruction")
    total, points = shapes.shape[:2]
    cameras = _cameras(
        getattr(reconstruction, "rotations", None) if rotations is None else rotations, total, "rotations"
    )
    if cameras is None:
        cameras = np.tile(np.eye(3), (total, 1, 1))
    true_cameras = _cameras(truth_rotations, total, "truth_rotations")
    if align not in ALIGNMENTS:
        near = suggest(str(align), ALIGNMENTS)
        raise InputError(f"align must be one of {', '.join(ALIGNMENTS)}, received {align!r}{near}")
    true = None if truth is None else shape_array(truth, "truth")
    if true is not None and true.shape != shapes.shape:
        raise InputError(f"truth: shape {shapes.shape} is needed, as the reconstruction, received {true.shape}")
    mask = None if valid is None else np.asarray(valid)
    if mask is not None and (mask.shape != (total, points) or mask.dtype != np.bool_):
        raise InputError(
            f"valid: a bool array of shape {(total, points)} is needed, received {mask.dtype} {mask.shape}"
        )
    chosen = _frames(frames, shapes if true is None else true, count)

    moved, views = np.empty((len(chosen), points, 3)), cameras[chosen]
    aligned, errors, words = None, None, ""
    if true is None:
        for i, f in enumerate(chosen):
            moved[i] = _centred(shapes[f], np.isfinite(shapes[f]).all(axis=1))
        middle = _average(cameras)
    else:
        turn, words = np.eye(3), _WORDS[align]
        if align == "global":
            cross = sum(a[k].T @ b[k] for k, a, b in _pairs(shapes, true, mask, range(total)))
            turn = _turn(np.asarray(cross))
        aligned, errors, views = np.empty_like(moved), np.full(len(chosen), np.nan), views.copy()
        for i, (f, (known, a, b)) in enumerate(zip(chosen, _pairs(shapes, true, mask, chosen), strict=True)):
            if align in ("per-frame", "similarity"):
                turn = _turn(a[known].T @ b[known])
            a = a @ turn
            if align == "similarity" and np.any(a[known]):
                a *= np.sum(a[known] * b[known]) / np.sum(a[known] ** 2)
            moved[i], aligned[i] = a, b if mask is None else np.where(mask[f][:, None], b, np.nan)
            norm = np.linalg.norm(b[known])
            errors[i] = np.linalg.norm(a[known] - b[known]) / norm if norm > 0 else np.nan
            views[i] = views[i] @ turn if true_cameras is None else true_cameras[chosen[i]]
        middle = _average(views if true_cameras is None else true_cameras)

    joined, lines = _indices(faces, "faces", (3, 4), points), _indices(edges, "edges", (2,), points)
    if joined is None and lines is None:
        joined = surface_triangles(_mean_of_either(moved, aligned) @ middle.T)
    reference = moved if aligned is None else np.where(np.isfinite(moved), aligned, np.nan)
    square = np.nansum(reference**2, axis=2)
    seen = np.isfinite(reference).all(axis=2).sum()
    size = float(np.sqrt(square.sum() / seen)) if seen else 0.0
    return Scene(chosen, moved, aligned, views, middle, joined, lines, errors, size, words)


def turned(view: np.ndarray, degrees: float) -> np.ndarray:
    """The view (3, 3) after turning the object about the vertical axis of the picture."""
    a = np.radians(degrees)
    yaw = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])
    return yaw @ view
