"""Low rank over frames: the singular-value threshold of S♯ through its F×F Gram matrix, and the plain solver on it.

With shapes kept as one array (F, 3, N), S♯ (3N×F) is its transpose-reshape, so S♯ᵀS♯ = X Xᵀ with X = (F, 3N):
thresholding S♯ multiplies X from the left by an F×F matrix, and its cost beyond one Gram product does not depend
on N.
"""

from __future__ import annotations

import numpy as np


def singular_values_over_frames(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Singular values of S♯ (descending) and its right vectors (F, F), from shapes (F, 3, N)."""
    flat = shapes.reshape(len(shapes), -1)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    return np.sqrt(np.maximum(values[::-1], 0.0)), vectors[:, ::-1]


def threshold_over_frames(
    shapes: np.ndarray, threshold: float, reweight: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Soft-threshold the singular values of S♯; returns shapes (F, 3, N) and the new singular values.

    ``reweight`` ε replaces the threshold τ of σ_i by τ·εσ₁/(σ_i + εσ₁) (reweighted nuclear norm), which leaves
    large singular values almost as they are. Equation: S♯ ← U S_τ(Σ) Vᵀ.
    """
    values, vectors = singular_values_over_frames(shapes)
    cut = np.full_like(values, threshold)
    if reweight is not None and values[0] > 0:
        cut *= reweight * values[0] / (values + reweight * values[0])
    kept = np.maximum(values - cut, 0.0)
    live = kept > 0
    basis = vectors[:, live]
    gain = kept[live] / values[live]
    flat = shapes.reshape(len(shapes), -1)
    return ((basis * gain) @ (basis.T @ flat)).reshape(shapes.shape), kept
