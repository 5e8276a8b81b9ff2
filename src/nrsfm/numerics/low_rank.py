"""Low rank over frames: the singular-value threshold of S♯ through the smaller of its Gram matrices.

With shapes kept as one array (F, 3, N), S♯ (3N×F) is its transpose-reshape, so S♯ᵀS♯ = X Xᵀ with X = (F, 3N):
thresholding S♯ multiplies X by an F×F matrix from the left, or by a 3N×3N one from the right where that is smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.numerics.arrays import beside, namespace_of, on_host, taken


def threshold_over_frames(
    shapes: Any, threshold: float, reweight: float | None = None, rank: int | None = None
) -> tuple[Any, np.ndarray]:
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


def shrink_over_frames(shapes: Any, rule: Callable[[np.ndarray], np.ndarray]) -> tuple[Any, np.ndarray]:
    """Replace the singular values of S♯ by ``rule(values)``; returns shapes (F, 3, N) and the new singular values.

    ``values`` are descending, min(F, 3N) of them; the rule gives as many, none below 0. Shapes may be on a device; the
    singular values are looked at on the host.
    """
    xp = namespace_of(shapes)
    flat = xp.reshape(shapes, (shapes.shape[0], -1))
    by_frames = flat.shape[0] <= flat.shape[1]
    squares, vectors = xp.linalg.eigh(flat @ flat.T if by_frames else flat.T @ flat)
    values = np.sqrt(np.maximum(on_host(squares)[::-1], 0.0))
    kept = np.where(values > 0, rule(values), 0.0)
    live = np.flatnonzero(kept > 0)
    basis, gain = taken(vectors, len(values) - 1 - live, 1), beside(kept[live] / values[live], vectors)
    out = (basis * gain) @ (basis.T @ flat) if by_frames else ((flat @ basis) * gain) @ basis.T
    return xp.reshape(out, shapes.shape), kept
