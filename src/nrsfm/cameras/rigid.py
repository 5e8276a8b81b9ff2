"""Rigid factorisation: one shape for all frames, W ≈ M S with M (2F×3) and S (3×P) from the leading rank-3 part.

The metric upgrade Q = GGᵀ (3×3) solves, in least squares over the frames' rows x, y of M,

    xQxᵀ = yQyᵀ = 1, xQyᵀ = 0   (one scale for all frames; Tomasi and Kanade, IJCV 1992), or
    xQxᵀ − yQyᵀ = 0, xQyᵀ = 0, tr Q = 3   (a scale per frame; Poelman and Kanade, PAMI 1997),

and is polished by Levenberg-Marquardt on the residuals of :mod:`nrsfm.cameras.intersection`.
"""

from __future__ import annotations

import numpy as np

from nrsfm.cameras.intersection import Upgrade, refine


def _products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Rows that give left·Q·right as a linear function of (Q₀₀, Q₁₁, Q₂₂, Q₀₁, Q₀₂, Q₁₂)."""
    diagonal = left * right
    mixed = [left[:, i] * right[:, j] + left[:, j] * right[:, i] for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.column_stack([diagonal, *mixed])


def rigid_upgrade(basis: np.ndarray, *, free_scales: bool) -> Upgrade:
    """Metric upgrade of the leading three columns of Π (2F, ≥ 3)."""
    sizes = np.linalg.norm(basis[:, :3], axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    x, y = basis[0::2, :3] / sizes, basis[1::2, :3] / sizes
    frames = len(x)
    if free_scales:
        trace = np.array([[1.0, 1, 1, 0, 0, 0]])
        rows = np.vstack([_products(x, x) - _products(y, y), _products(x, y), trace])
        right = np.concatenate([np.zeros(2 * frames), [3.0]])
    else:
        rows = np.vstack([_products(x, x), _products(y, y), _products(x, y)])
        right = np.concatenate([np.ones(2 * frames), np.zeros(frames)])
    q = np.linalg.lstsq(rows, right, rcond=None)[0]
    values, vectors = np.linalg.eigh(np.array([[q[0], q[3], q[4]], [q[3], q[1], q[5]], [q[4], q[5], q[2]]]))
    # Noise can leave Q indefinite; a small positive floor keeps the start usable.
    start = vectors * np.sqrt(np.maximum(values, 1e-3 * max(abs(values).max(), 1e-300)))
    matrix, cost, used = refine(x, y, start, weight=0.0 if free_scales else 1.0)
    return Upgrade(1, matrix / sizes[:, None], cost / frames, "rigid", used)
