"""Low rank over frames: the singular-value threshold of S♯ through the smaller of its Gram matrices.

With shapes kept as one array (F, 3, N), S♯ (3N×F) is its transpose-reshape, so S♯ᵀS♯ = X Xᵀ with X = (F, 3N):
thresholding S♯ multiplies X by an F×F matrix from the left, or by a 3N×3N one from the right where that is smaller.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def threshold_over_frames(
    shapes: np.ndarray, threshold: float, reweight: float | None = None, rank: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Soft-threshold the singular values of S♯; returns shapes (F, 3, N) and the new singular values.

    ``reweight`` ε replaces the threshold τ of σ_i by τ·εσ₁/(σ_i + εσ₁) (reweighted nuclear norm), which leaves
    large singular values almost as they are. ``rank`` keeps at most so many. Equation: S♯ ← U S_τ(Σ) Vᵀ.
    """

    def shrunk(values: np.ndarray) -> np.ndarray:
        cut = np.full_like(values, threshold)
        if reweight is not None and values[0] > 0:
            cut *= reweight * values[0] / (values + reweight * values[0])
        kept = np.maximum(values - cut, 0.0)
        if rank is not None:
            kept[rank:] = 0.0
        return kept

    return shrink_over_frames(shapes, shrunk)


def shrink_over_frames(shapes: np.ndarray, rule: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Replace the singular values of S♯ by ``rule(values)``; returns shapes (F, 3, N) and the new singular values.

    ``values`` are descending, min(F, 3N) of them; the rule gives as many, none below 0.
    """
    flat = shapes.reshape(len(shapes), -1)
    by_frames = len(flat) <= flat.shape[1]
    gram = flat @ flat.T if by_frames else flat.T @ flat
    squares, vectors = np.linalg.eigh(gram)
    values, vectors = np.sqrt(np.maximum(squares[::-1], 0.0)), vectors[:, ::-1]
    kept = np.where(values > 0, rule(values), 0.0)
    live = kept > 0
    basis, gain = vectors[:, live], kept[live] / values[live]
    out = (basis * gain) @ (basis.T @ flat) if by_frames else ((flat @ basis) * gain) @ basis.T
    return out.reshape(shapes.shape), kept
