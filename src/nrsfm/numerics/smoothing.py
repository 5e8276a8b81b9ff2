"""Smooth curves through noisy samples: penalised least squares over time, its weight from the samples.

    minimise over X   ‖W − X‖² + λ ‖D_m X‖²,   so X = (I + λ D_mᵀD_m)⁻¹ W

D_m takes differences of order m of rows that follow one another. m and λ are those of least generalised
cross-validation, ‖W − X‖² / (1 − tr(A)/F)² with X = A W: what predicts samples that were left out best.

Sources: Whittaker, "On a new method of graduation", Proc. Edinburgh Math. Soc. 41, 1923; Craven and Wahba, "Smoothing
noisy data with spline functions", Numerische Mathematik 31, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ORDERS = (1, 2, 3)
WEIGHTS = tuple(10.0 ** np.arange(-4.0, 6.1, 0.5))


@dataclass(frozen=True)
class Smoothed:
    """``values`` (F, n) smoothed with ``weight`` λ and ``order`` m.

    ``left``: standard deviation of white noise in them, as a share of that in the samples. ``removed``: root mean
    square of what the smoothing took away. ``predicted``: root mean square error with which a sample is predicted by
    the others, an upper bound of the white noise.
    """

    values: np.ndarray
    order: int
    weight: float
    left: float
    removed: float
    predicted: float


def penalty_bands(frames: int, order: int) -> np.ndarray:
    """D_mᵀD_m (F, F) of differences of the given order, as its diagonals (m + 1, F), main diagonal last."""
    stencil = np.array([1.0])
    for _ in range(order):
        stencil = np.convolve(stencil, [-1.0, 1.0])
    bands = np.zeros((order + 1, frames))
    for row in range(frames - order):
        for offset in range(order + 1):
            bands[order - offset, row + offset : row + order + 1] += stencil[offset:] * stencil[: order + 1 - offset]
    return bands


def smoothed(values: np.ndarray) -> Smoothed:
    """Smooth values (F, n), F ≥ 2, over their first axis; order and weight by generalised cross-validation.

    Memory for two copies of the values; time O(F n) and O(F²) per candidate.
    """
    from scipy.linalg import eigvals_banded, solveh_banded

    frames = len(values)
    best: Smoothed | None = None
    least = np.inf
    for order in ORDERS:
        if order >= frames:
            break
        bands = penalty_bands(frames, order)
        squares = np.maximum(eigvals_banded(bands), 0.0)
        for weight in WEIGHTS:
            factors = 1.0 / (1.0 + weight * squares)
            system = weight * bands
            system[-1] += 1.0
            curves = solveh_banded(system, values)
            gap = float(np.sum((values - curves) ** 2))
            score = gap / max(1.0 - float(factors.mean()), np.finfo(float).eps) ** 2
            if score < least:
                left, removed, predicted = np.sqrt([np.mean(factors**2), gap / values.size, score / values.size])
                least = score
                best = Smoothed(curves, order, float(weight), float(left), float(removed), float(predicted))
    if best is None:
        return Smoothed(values, 0, 0.0, 1.0, 0.0, np.inf)
    return best
