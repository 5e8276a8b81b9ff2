"""Projection of 2×3K motion blocks onto the motion manifold, and the Stiefel manifold V₂(ℝ³) that it needs.

minimise over l, R   Σ_k ‖M_k − l_k R‖²_F   subject to   R Rᵀ = I (2×3),

for each frame's blocks M_1 … M_K (2×3 each). With u = vec(R), ‖u‖² = 2, the best weights are l_k = m_kᵀu / 2, and what
is left is to maximise uᵀAu, A = Σ_k m_k m_kᵀ (6×6), over pairs of orthonormal rows.

Source: Paladini, Del Bue, Xavier, Agapito, Stosic and Dodig, "Optimal metric projections for deformable and articulated
structure-from-motion", IJCV 96, 2012. There a small semidefinite programme gives the first frame's global maximum and
Newton's method follows it from iteration to iteration. Here all frames are solved at once, and the global maximum is
the best of 13 starts (:func:`nearest_motion` with ``rows=None``), each climbed by polar steps: since A is positive
semidefinite, R ← polar(mat(Au)) never lowers uᵀAu. Newton on the manifold, kept uphill, finishes.
"""

from __future__ import annotations

import numpy as np

_CLIMB = 12  # polar steps of every start before the best is kept
_NEWTON = 30
_LARGEST_TURN = 0.5  # radians; a longer Newton step leaves the region in which the second order holds
_ALTERNATING = np.zeros((3, 3, 3))
_ALTERNATING[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_ALTERNATING[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0


def polar_rows(blocks: np.ndarray) -> np.ndarray:
    """Nearest pairs of orthonormal rows (..., 2, 3) to blocks (..., 2, 3)."""
    left, _, right = np.linalg.svd(blocks, full_matrices=False)
    rows: np.ndarray = left @ right
    return rows


def tangents(rows: np.ndarray) -> np.ndarray:
    """(F, 3, a, 3): the derivative e_j × x of each of the a rows x of (F, a, 3) by a turn about object axis j."""
    moved: np.ndarray = np.einsum("ijk,fak->fjai", _ALTERNATING, rows)
    return moved


def turned(rows: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """exp([w]×) applied to the rows (F, 2, 3), w = ``turns`` (F, 3) in radians; orthonormal to rounding."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    axis = turns[:, None, :] / np.maximum(angle, np.finfo(float).tiny)
    along = axis * np.sum(axis * rows, axis=2, keepdims=True)
    across = np.einsum("fj,fjai->fai", axis[:, 0], tangents(rows))
    return polar_rows(along + np.cos(angle) * (rows - along) + np.sin(angle) * across)


def _half_turns() -> np.ndarray:
    """(12, 2, 3): the rotations of the cube that differ by more than the sign of both rows."""
    rows = []
    for i, j in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):
        for sign in (1.0, -1.0):
            pair = np.zeros((2, 3))
            pair[0, i], pair[1, j] = 1.0, sign
            rows.append(pair)
    return np.array(rows)


def _value(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """uᵀAu, (...)."""
    flat = rows.reshape(*rows.shape[:-2], 6)
    value: np.ndarray = np.einsum("...i,...ij,...j->...", flat, matrix, flat)
    return value


def _climb(matrix: np.ndarray, rows: np.ndarray, steps: int) -> np.ndarray:
    """Polar steps R ← polar(mat(Au)); a vanishing Au leaves R as it is."""
    for _ in range(steps):
        pull = (matrix @ rows.reshape(*rows.shape[:-2], 6, 1)).reshape(rows.shape)
        still = np.sum(pull * pull, axis=(-2, -1), keepdims=True) <= 0
        rows = np.where(still, rows, polar_rows(np.where(still, rows, pull)))
    return rows


def _global_start(matrix: np.ndarray) -> np.ndarray:
    """The best of 13 starts after a few polar steps: the cube's rotations and A's leading eigenvector."""
    leading = polar_rows(np.linalg.eigh(matrix)[1][:, :, -1].reshape(-1, 2, 3))
    cube = _half_turns()
    starts = np.concatenate([np.broadcast_to(cube, (len(matrix), *cube.shape)), leading[:, None]], axis=1)
    climbed = _climb(matrix[:, None], starts, _CLIMB)
    best = np.argmax(_value(matrix[:, None], climbed), axis=1)
    rows: np.ndarray = climbed[np.arange(len(matrix)), best]
    return rows


def maximise(matrix: np.ndarray, rows: np.ndarray | None = None, tolerance: float = 1e-10) -> np.ndarray:
    """Orthonormal rows (F, 2, 3) that maximise uᵀAu, ``matrix`` A (F, 6, 6) positive semidefinite.

    From ``rows`` (the nearest maximum), or, without, from everywhere (the global one). With x(w) = exp([w]×)x and
    (p, q) = Au, the gradient by w is 2 Σ x × p and the Hessian 2(JᵀAJ + sym Σ p xᵀ − Σ pᵀx I); eigenvalues are made
    negative, so that a step goes uphill, and where it does not gain, a polar step is taken in its place.
    """
    scale = np.maximum(np.einsum("fii->f", matrix), np.finfo(float).tiny)
    unit = matrix / scale[:, None, None]
    rows = _global_start(unit) if rows is None else rows
    value = _value(unit, rows)
    for _ in range(_NEWTON):
        pull = (unit @ rows.reshape(-1, 6, 1)).reshape(rows.shape)
        slopes = tangents(rows).reshape(-1, 3, 6)
        gradient = 2.0 * np.einsum("fji,fi->fj", slopes, pull.reshape(-1, 6))
        if np.abs(gradient).max(initial=0.0) < tolerance:
            break
        outer = np.einsum("fai,faj->fij", pull, rows)
        curvature = slopes @ unit @ slopes.transpose(0, 2, 1) + 0.5 * (outer + outer.transpose(0, 2, 1))
        curvature -= np.einsum("fii->f", outer)[:, None, None] * np.eye(3)
        bends, axes = np.linalg.eigh(2.0 * curvature)
        step = (axes.transpose(0, 2, 1) @ gradient[:, :, None])[:, :, 0] / np.maximum(np.abs(bends), 1e-6)
        step = (axes @ step[:, :, None])[:, :, 0]
        step *= np.minimum(1.0, _LARGEST_TURN / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
        trial = turned(rows, step)
        fresh = _value(unit, trial)
        lost = fresh < value
        if lost.any():
            trial[lost] = _climb(unit[lost], rows[lost], 1)
            fresh[lost] = _value(unit[lost], trial[lost])
        rows, value = trial, fresh
    return rows


def nearest_motion(blocks: np.ndarray, rows: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Nearest points of the motion manifold: weights l (F, K) and rows R (F, 2, 3), l_k R ≈ M_k.

    Parameters
    ----------
    blocks
        (F, K, 2, 3).
    rows
        Orthonormal rows to start from, (F, 2, 3); without them the global minimum is sought.
    """
    flat = blocks.reshape(*blocks.shape[:2], 6)
    rows = maximise(flat.transpose(0, 2, 1) @ flat, rows)
    return (flat @ rows.reshape(-1, 6, 1))[:, :, 0] / 2.0, rows
