"""Where things are: the box and the ball around the points, which way is up, how dense they lie, where cameras stand.

Cameras: of an orthographic camera only the direction and the size are known, not the distance; the page draws them at
one distance. Where perspective was undone the distances are known (:mod:`nrsfm.export.cameras`), and drawn.

Source: ours.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.viewer.pictures import Pictures

_CAMERA_DISTANCE = 1.9  # of orthographic cameras, in radii of the object
_SAMPLE = 4_000


def extent(result: Reconstruction, kept: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, float]:
    """The box of all points: its centre and half its longest side; and their middle, from the centre, with a radius.

    Strays stretch the box, which numbers must fit into, but hardly the ball about the middle, which the eye looks at.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for shape in result.shapes:
        shown = shape[kept]
        low, high = np.minimum(low, shown.min(axis=0)), np.maximum(high, shown.max(axis=0))
    centre = 0.5 * (low + high).astype(np.float64)
    half = float(np.max(high - low)) / 2 or 1.0
    if not np.isfinite(half):
        raise InputError("shapes: they are too large to be drawn")
    some = kept[:: max(1, len(kept) // _SAMPLE)]
    steps = range(0, result.n_frames, max(1, result.n_frames // 50))
    sample = np.stack([np.asarray(result.shapes[f], dtype=np.float64)[some] - centre for f in steps]).reshape(-1, 3)
    middle = 0.5 * (np.percentile(sample, 2.0, axis=0) + np.percentile(sample, 98.0, axis=0))
    return centre, half, middle, float(np.percentile(np.linalg.norm(sample - middle, axis=1), 99.0)) or 1.0


def upright(rotations: np.ndarray) -> np.ndarray:
    """(3, 3) from the object to axes x right, y up, z towards the viewer, as the average camera sees it."""
    u, singular, vt = np.linalg.svd(np.sum(rotations, axis=0))
    mean = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    if singular[1] < 1e-6 * len(rotations):  # they cancel out: there is no average
        mean = rotations[len(rotations) // 2]
    return np.asarray(np.diag([1.0, -1.0, -1.0]) @ mean)


def spacing(result: Reconstruction, kept: np.ndarray) -> float:
    """Typical distance between neighbours in the middle frame, in the unit of the shapes: it sets the points' size."""
    from scipy.spatial import cKDTree

    shape = np.asarray(result.shapes[result.n_frames // 2], dtype=np.float64)[kept]
    some = shape[:: max(1, len(shape) // _SAMPLE)]
    distances = cKDTree(shape).query(some, k=[min(3, len(shape))])[0]
    return float(np.median(distances))


def depth_range(result: Reconstruction, kept: np.ndarray, centre: np.ndarray) -> list[float]:
    """Depths about the centre between which nearly all points of all frames are, in the unit of the shapes."""
    some = kept[:: max(1, len(kept) // _SAMPLE)]
    steps = range(0, result.n_frames, max(1, result.n_frames // 50))
    depths = np.concatenate([(result.shapes[f][some] - centre) @ result.rotations[f, 2] for f in steps])
    low, high = (float(value) for value in np.percentile(depths, [1.0, 99.0]))
    return [low, high if high > low else low + 1.0]


def cameras(
    result: Reconstruction,
    kept: np.ndarray,
    centre: np.ndarray,
    half: float,
    middle: np.ndarray,
    radius: float,
    pictures: Pictures | None,
) -> dict[str, Any]:
    """Places (F, 3) of the cameras, about the centre and over ``half``, and what they are."""
    from nrsfm.export.cameras import find_cameras

    size = None if pictures is None else (float(pictures.width), float(pictures.height))
    found = find_cameras(result, np.eye(3), 1.0, size, kept)
    left, right, top, bottom = found.window
    if found.focal is None:
        places = middle - _CAMERA_DISTANCE * radius * result.rotations[:, 2]
    else:
        places = found.positions - centre
    return {
        "kind": found.kind,
        "places": np.round(places / half, 6).ravel().tolist(),
        "aspect": float((right - left) / (bottom - top)) if bottom > top else 1.0,
        "slope": 0.0 if found.focal is None else float((bottom - top) / 2 / found.focal[1]),
    }
