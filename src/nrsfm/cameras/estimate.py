"""From the compressed measurement matrix to camera rotations: the steps in order, and their report."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nrsfm.cameras import intersection, selection, signs
from nrsfm.cameras.options import CameraOptions

logger = logging.getLogger(__name__)

VIRTUAL_POINTS = 36


@dataclass(frozen=True)
class CameraEstimate:
    """Estimated cameras and how they were found.

    ``rotations`` (F, 3, 3) camera from object, ``scales`` (F,) with mean 1, ``rank`` the K that was used,
    ``candidates`` one dict per camera estimate that was compared, ``warnings`` sentences for the user, ``turn``
    the largest angle in degrees between the viewing directions of two frames.
    """

    rotations: np.ndarray
    scales: np.ndarray
    rank: int
    candidates: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    turn: float = 0.0


def estimate_cameras(
    factor: np.ndarray,
    options: CameraOptions,
    *,
    noise: float = 0.0,
    points: int | None = None,
    seed: int = 0,
    progress: Callable[[str, float | None], None] | None = None,
) -> CameraEstimate:
    """Estimate one rotation per frame from ``factor`` (2F, r), W = factor @ Qᵀ with orthonormal rows in Qᵀ."""
    factor = np.asarray(factor, dtype=np.float64)
    frames = len(factor) // 2
    rng = np.random.default_rng(seed)
    limit = options.camera_rank or 12
    basis = intersection.dominant_basis(factor, max(3 * limit, VIRTUAL_POINTS))
    warnings: list[str] = []
    if basis.shape[1] < 3:
        basis = np.hstack([basis, np.zeros((2 * frames, 3 - basis.shape[1]))])
    ranks = min(limit, intersection.rank_limit(frames, basis.shape[1]))
    small = basis[:, :VIRTUAL_POINTS]
    if options.cameras == "rigid":
        ranks = 1
    solved = intersection.upgrades(basis, ranks, rng)
    if options.camera_rank is not None:
        solved = [u for u in solved if u.rank == ranks]
    rows: list[dict[str, Any]] = []
    estimates = []
    for i, item in enumerate(solved):
        rotations, _ = intersection.polar_rotations((basis[:, : 3 * item.rank] @ item.matrix).reshape(frames, 2, 3))
        rotations = signs.apply_signs(rotations, signs.consistent_signs(rotations, small))
        row: dict[str, Any] = {"K": item.rank, "start": item.start, "cost": item.cost, "chosen": False}
        if len(solved) > 1:
            row |= selection.spectrum_criteria(selection.low_rank_shapes(rotations, small), small)
        rows.append(row)
        estimates.append(rotations)
        if progress is not None:
            progress("cameras", (i + 1) / len(solved))
    best = 0
    if len(rows) > 1:
        least = min(r["norm"] for r in rows)
        best = min((i for i, r in enumerate(rows) if r["norm"] <= 1.03 * least), key=lambda i: rows[i]["log"])
    rows[best]["chosen"] = True
    rotations = estimates[best]
    if options.mirror:
        rotations = signs.mirrored(rotations)
    axes = rotations[:, 2]
    turn = float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))
    if turn < 5.0:
        warnings.append(f"the camera turns by {turn:.1f} degrees in all: depth is poorly determined")
    return CameraEstimate(rotations, np.ones(frames), rows[best]["K"], rows, warnings, turn)
