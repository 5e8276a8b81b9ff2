"""Shapes averaged over the ranks of the low-rank model: no rank is chosen, and what each gets wrong mostly cancels.

The model of :mod:`nrsfm.perspective.model` is fitted once per rank, always from the same start, so all fits share one
mirror image and see their shapes in the frames of the same cameras. Their shapes in the camera's frame are averaged;
x and y hardly differ, depth does. Cameras and weights come from a sample of the points; every other point then costs
one small system per rank: O(F P K²), in chunks of points.

Ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.numerics.threads import single_thread
from nrsfm.perspective import model as low_rank
from nrsfm.perspective.evidence import sample
from nrsfm.perspective.geometry import centred_points, checked_intrinsics

POINTS = 150
RANKS = (2, 3, 4, 5, 6, 7)
FRAMES_PER_RANK = 7
_AFFINE, _STEPS = 10, 30
_CHUNK_NUMBERS = 2**20


@dataclass(frozen=True)
class CameraShapes:
    """Shapes in the frames of their cameras.

    Attributes
    ----------
    shapes
        (F, P, 3) float32, centred, scaled to the image's unit.
    rotations
        (F, 3, 3) camera from object, such that the object's frame holds least motion.
    scales
        (F,) of mean 1.
    translations
        (F, 2): where the centroid is seen, image unit.
    ranks
        Those that were averaged.
    """

    shapes: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    translations: np.ndarray
    ranks: tuple[int, ...]


def averaged_shapes(
    points: np.ndarray, result: Any, intrinsics: np.ndarray, flip: bool = False, visible: np.ndarray | None = None
) -> CameraShapes | None:
    """Shapes seen by perspective cameras, averaged over ranks; ``None`` where no rank could be fitted.

    Parameters as in :func:`~nrsfm.perspective.find_perspective`; ``flip`` starts from the mirror image of ``result``.
    """
    matrix = checked_intrinsics(intrinsics)
    frames, count = points.shape[:2]
    part = sample(points, result, matrix, visible, (frames, POINTS))
    strength = part.unit / float(matrix[0, 0])
    sign = np.array([1.0, 1.0, -1.0 if flip else 1.0])
    rotations, shapes = part.rotations * np.outer(sign, sign), part.shapes * sign[:, None]
    largest = max(2, frames // FRAMES_PER_RANK)
    models = []
    with single_thread(), np.errstate(all="ignore"):
        for rank in (rank for rank in RANKS if rank <= largest):
            model = low_rank.start(part.tracks, rotations, part.scales, shapes, rank)
            model = low_rank.fit(model, part.tracks, 0.0, _AFFINE)
            model = low_rank.fit(model, part.tracks, strength, _STEPS)
            if np.isfinite(model.likelihood):
                models.append(model)
        if not models:
            return None
        out = np.empty((frames, count, 3), dtype=np.float32)
        step = max(1, _CHUNK_NUMBERS // (9 * frames))
        for first in range(0, count, step):
            chunk = slice(first, min(first + step, count))
            tracks = centred_points(points[:, chunk], matrix).transpose(0, 2, 1) / part.unit
            seen = np.zeros((frames, 3, tracks.shape[2]))
            for model in models:
                found = low_rank.point_systems(model, tracks, strength)
                local = found[0] + (model.weights @ found[1:].reshape(len(found) - 1, -1)).reshape(seen.shape)
                seen += model.scales[:, None, None] * (model.rotations @ local)
            out[:, chunk] = (seen * (part.unit / len(models))).transpose(0, 2, 1)
    middle = out.mean(axis=1, dtype=np.float64)
    out -= middle[:, None].astype(np.float32)
    scales = np.mean([model.scales for model in models], axis=0)
    shifts = np.mean([model.shifts for model in models], axis=0) * part.unit + middle[:, :2] + matrix[:2, 2]
    columns = np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(np.int64))
    turned = out[:, columns].astype(np.float64).transpose(0, 2, 1) / scales[:, None, None]
    first_guess = models[len(models) // 2].rotations
    cameras, _ = low_rank.without_motion(first_guess, np.swapaxes(first_guess, 1, 2) @ turned)
    return CameraShapes(out, cameras, scales, shifts, tuple(len(model.basis) for model in models))
