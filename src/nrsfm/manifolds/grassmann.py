"""Points on the Grassmann manifold G(p, d): where they come from, and how they are compared.

A point is an orthonormal basis Φ (d × p); its embedding among symmetric matrices is Π(Φ) = ΦΦᵀ, on which distance
and self-expression are defined. All functions take a stack (K, d, p).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.numerics.arrays import namespace_of

_TINY = float(np.finfo(float).tiny)


def grassmann_points(blocks: Any, dimension: int, complete: bool = True) -> Any:
    """Orthonormal bases (K, d, p) of the ``dimension`` leading left singular vectors of each (d, n) block.

    ``blocks`` is (K, d, n), on a device or not; columns may be padded with zeros. Where a block has lower rank than
    ``dimension`` the basis is completed by fixed directions orthogonal to it, so that it is always a point of G(p, d).
    With ``complete`` false its last columns are zero instead: a subspace of lower dimension, the same in any
    orthonormal coordinates of the ambient space.
    Source: f_g of the paper, [Φ, Σ, V] = svds(X, p), here by the smaller of the two Gram matrices.
    """
    xp = namespace_of(blocks)
    count, ambient, columns = blocks.shape
    dimension = min(dimension, ambient)  # the whole space is the largest subspace there is
    if ambient <= columns:
        values, leading = xp.linalg.eigh(blocks @ xp.matrix_transpose(blocks))
        leading = leading * xp.sqrt(xp.clip(values, 0.0, None))[:, None, :]
    else:
        values, right = xp.linalg.eigh(xp.matrix_transpose(blocks) @ blocks)
        leading = blocks @ right
    take = min(dimension, values.shape[1])
    values = xp.flip(values, axis=1)
    bases = xp.zeros((count, ambient, dimension), dtype=leading.dtype, device=leading.device)
    bases[:, :, :take] = xp.flip(leading, axis=2)[:, :, :take]
    live = xp.zeros((count, dimension), dtype=xp.bool, device=leading.device)
    live[:, :take] = values[:, :take] > 1e-10 * xp.clip(values[:, :1], _TINY, None)
    filler = xp.eye(ambient, dimension, dtype=leading.dtype, device=leading.device)
    bases = xp.where(live[:, None, :], bases, filler * xp.sqrt(xp.clip(values[:, :1, None], 1.0, None)))
    # QR restores orthonormality to rounding and keeps the span of the leading columns.
    bases = xp.linalg.qr(bases)[0]
    return bases if complete else bases * xp.astype(live, bases.dtype)[:, None, :]


def projection_kernel(points: np.ndarray) -> np.ndarray:
    """Γ (K, K) with Γ_ij = ‖Φ_iᵀΦ_j‖²_F = tr((Φ_jᵀΦ_i)(Φ_iᵀΦ_j)), by one product of the stacked bases."""
    count, ambient, dimension = points.shape
    stacked = points.transpose(1, 0, 2).reshape(ambient, count * dimension)
    products = (stacked.T @ stacked) ** 2
    return products.reshape(count, dimension, count, dimension).sum(axis=(1, 3))


def projection_distance(points: np.ndarray) -> np.ndarray:
    """Squared projection distance d_g² (K, K) = ½‖Φ_iΦ_iᵀ − Φ_jΦ_jᵀ‖²_F = p − Γ_ij."""
    squared = points.shape[2] - projection_kernel(points)
    np.fill_diagonal(squared, 0.0)
    return np.maximum(squared, 0.0)


def similarity_graph(points: np.ndarray) -> np.ndarray:
    """Weights w_ij = exp(−d_g²(Φ_i, Φ_j)) (K, K) of Algorithm 2."""
    return np.exp(-projection_distance(points))
