"""One sequence: its tracks and what is known about the truth."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.tracks import Tracks

# Above this many track coordinates a loader gives float32, unless asked otherwise: 80 MB of float64.
LARGE = 10**7


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Sequence:
    """Tracks with their truth, as far as it is known.

    Attributes
    ----------
    name
        The name under which it was loaded.
    tracks
        The 2D tracks.
    shapes
        (F, P, 3) true points of each frame, or ``None``. Orthographic sequences have the unit of the tracks.
    rotations
        (F, 3, 3) true cameras, camera from object, or ``None`` where none is known or the camera is
        perspective.
    valid
        (F, P) bool: which true points are known, or ``None`` where all are. The others may be NaN.
    faces
        (T, 3) triangles or (T, 4) quads of the surface as numbers of points, or ``None``.
    edges
        (E, 2) lines to draw between points, or ``None``.
    note
        Plain values: ``origin``, ``licence``, ``units``, ``camera``, ``frame``
        (of the shapes: "object" or "camera"), and what else is worth knowing.

    Raises
    ------
    InputError
        The sizes do not agree.
    """

    name: str
    tracks: Tracks
    shapes: np.ndarray | None = None
    rotations: np.ndarray | None = None
    valid: np.ndarray | None = None
    faces: np.ndarray | None = None
    edges: np.ndarray | None = None
    note: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        frames, points = self.tracks.n_frames, self.tracks.n_points
        for name, needed in (
            ("shapes", (frames, points, 3)),
            ("rotations", (frames, 3, 3)),
            ("valid", (frames, points)),
        ):
            array = getattr(self, name)
            if array is not None and array.shape != needed:
                raise InputError(f"{self.name}: {name} of shape {needed} are needed, received {array.shape}")

    def __repr__(self) -> str:
        known = [n for n in ("shapes", "rotations", "valid", "faces", "edges") if getattr(self, n) is not None]
        truth = ", ".join(known) or "no truth"
        return f"Sequence({self.name!r}, {self.tracks.n_frames} frames, {self.tracks.n_points} points, {truth})"

    def with_noise(self, ratio: float, seed: int = 0) -> Sequence:
        """Return the same sequence with :func:`add_noise` on its tracks."""
        return dataclasses.replace(
            self,
            tracks=add_noise(self.tracks, ratio, seed),
            note={**self.note, "noise": float(ratio), "noise_seed": int(seed)},
        )


def add_noise(tracks: Tracks, ratio: float, seed: int = 0) -> Tracks:
    """Return tracks with independent Gaussian noise of standard deviation ``ratio`` · max|W| in x and in y.

    ``W`` is the measurement matrix with each row centred over the visible points: the paper's noise model.
    The numbers are drawn frame by frame from ``numpy.random.default_rng(seed)``, P pairs (x, y) each.

    Raises
    ------
    InputError
        The ratio is negative or not finite, or the seed is not a whole number of at least 0.
    """
    if (
        isinstance(ratio, bool)
        or not isinstance(ratio, (int, float, np.number))
        or not math.isfinite(ratio)
        or ratio < 0
    ):
        raise InputError(f"noise must be a finite ratio of at least 0, received {ratio!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number of at least 0, received {seed!r}")
    if ratio == 0:
        return tracks
    sigma = float(ratio) * largest_deviation(tracks)
    generator = np.random.default_rng(int(seed))
    noisy = np.empty(tracks.points.shape, dtype=tracks.points.dtype)
    for f, frame in enumerate(tracks.points):
        noisy[f] = frame + sigma * generator.standard_normal(frame.shape)
    return Tracks(noisy, tracks.visible)


def largest_deviation(tracks: Tracks) -> float:
    """Return max|W|, each row of W centred over the visible points."""
    largest = 0.0
    for f, frame in enumerate(tracks.points):
        seen = frame if tracks.visible is None else frame[tracks.visible[f]]
        if len(seen):
            seen = seen.astype(np.float64)
            largest = max(largest, float(np.abs(seen - seen.mean(axis=0)).max()))
    return largest


def project(shapes: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Return the orthographic image (F, P, 2) of shapes (F, P, 3), in their dtype."""
    image = np.empty((*shapes.shape[:2], 2), dtype=shapes.dtype)
    for f, shape in enumerate(shapes):
        image[f] = shape @ rotations[f, :2].T
    return image


def choose_dtype(dtype: Any, coordinates: int) -> np.dtype:
    """The float type of a sequence with so many track coordinates; ``dtype`` overrides.

    Raises ``InputError`` for a type other than float32 and float64.
    """
    if dtype is None:
        return np.dtype(np.float64 if coordinates <= LARGE else np.float32)
    try:
        chosen = np.dtype(dtype)
    except TypeError:
        chosen = np.dtype(object)
    if chosen not in (np.float32, np.float64):
        raise InputError(f"dtype must be float32 or float64, received {dtype!r}")
    return chosen
