"""Shapes and motion together: descent of the reprojection error along the motion manifold.

minimise over l, R, S   ‖W − M S‖² + μ Σ_f ‖S_f − S̄‖²,   M = [l_f1 R_f … l_fK R_f],  R_f R_fᵀ = I,  S_f = Σ_k l_fk B_k,

S̄ the mean of the S_f, S = (B_1 … B_K) stacked (3K×N). The second term is a ridge on the deformation; with rows
√μ (l_f − l̄)ᵀ ⊗ I₃ under those of M it is part of one least-squares problem. S is linear and eliminated (variable
projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973, with Kaufman's Jacobian); the K + 3 unknowns of each
frame, weights and a turn, take Levenberg-Marquardt steps. The normal equations are solved by conjugate gradients,
preconditioned with their K + 3 square blocks, so nothing larger than 5F × 3K is ever formed: S enters the Jacobian only
through the factor C (3K×3K) of S Sᵀ = C Cᵀ. K² + 3 directions change nothing (a linear mixing of the B_k and a turn of
the object frame); damping keeps them still, and the weights are made orthonormal after every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nrsfm.manifolds.stiefel import tangents, turned

_ROUNDING = 1e-10  # singular values of M below this share of the largest carry no shape
_CONJUGATE_STEPS, _CONJUGATE_TOLERANCE = 60, 1e-2
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e-10, 1e8
_SOLVED = 1e-24  # an energy of this share of ‖W‖² is zero


@dataclass(frozen=True)
class Motion:
    """Weights l (F, K), rows R (F, 2, 3), basis B (K, 3, N), and the energies relative to ‖W‖².

    ``energy`` with the ridge, ``reprojection`` without; ``energies`` before and after each step.
    """

    weights: np.ndarray
    rows: np.ndarray
    basis: np.ndarray
    energy: float
    reprojection: float
    energies: tuple[float, ...]
    stop_reason: str = ""

    @property
    def shapes(self) -> np.ndarray:
        """S_f = Σ_k l_fk B_k, (F, 3, N)."""
        return np.tensordot(self.weights, self.basis, axes=1)


def motion_matrix(weights: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """M (2F, 3K) with blocks l_fk R_f."""
    return (weights[:, None, :, None] * rows[:, :, None, :]).reshape(2 * len(rows), -1)


def _orthonormal(weights: np.ndarray) -> np.ndarray:
    """The same span with WᵀW = F·I: a mixing of the basis, which changes no shape."""
    mixed: np.ndarray = np.linalg.qr(weights)[0] * np.sqrt(len(weights))
    return mixed


class _Linear:
    """The least-squares problem at given weights and rows: S eliminated, and what the next step needs of it."""

    def __init__(self, target: np.ndarray, weights: np.ndarray, rows: np.ndarray, ridge: float) -> None:
        self.weights, self.rows, self.ridge = weights, rows, float(np.sqrt(ridge))
        rank = weights.shape[1]
        stacked = weights[:, None, :, None] * rows[:, :, None, :]
        if ridge > 0:
            deforming = self.ridge * (weights - weights.mean(axis=0))
            stacked = np.concatenate([stacked, deforming[:, None, :, None] * np.eye(3)[None, :, None, :]], axis=1)
        left, values, right = np.linalg.svd(stacked.reshape(-1, 3 * rank), full_matrices=False)
        live = values > _ROUNDING * max(float(values[0]), np.finfo(float).tiny)
        self.left = left[:, live]
        self.basis = right[live].T @ ((self.left.T @ target) / values[live, None])
        self.residual = target - self.left @ (self.left.T @ target)
        self.energy = float(np.sum(self.residual * self.residual))

    def jacobian(self, fixed: bool) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of each frame's rows of M by its weights and turn, times C, and the gradient (F, K [+ 3]).

        S = C V with orthonormal rows in V, so that the residual counts only through r Vᵀ.
        """
        frames, rank = self.weights.shape
        height, count = (5 if self.ridge > 0 else 2), rank if fixed else rank + 3
        blocks = np.zeros((frames, count, height, rank, 3))
        for k in range(rank):
            blocks[:, k, :2, k] = self.rows
            blocks[:, k, 2:, k] = self.ridge * np.eye(3)[: height - 2]
        if not fixed:
            blocks[:, rank:, :2] = self.weights[:, None, None, :, None] * tangents(self.rows)[:, :, :, None, :]
        across, upper = np.linalg.qr(self.basis.T)
        jacobian = (blocks.reshape(frames, count, height, 3 * rank) @ upper.T).reshape(frames, count, -1)
        seen = self.project((self.residual @ across).reshape(frames, -1))
        return jacobian, (jacobian @ seen[:, :, None])[:, :, 0]

    def project(self, rows: np.ndarray) -> np.ndarray:
        """Remove from stacked rows (F, height · c) what the mean of the weights and S can take up."""
        if self.ridge > 0:
            tall = rows.reshape(len(rows), 5, -1)
            tall[:, 2:] -= tall[:, 2:].mean(axis=0)
        flat = rows.reshape(len(self.left), -1)
        return (flat - self.left @ (self.left.T @ flat)).reshape(rows.shape)


def _step(problem: _Linear, jacobian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """Conjugate gradients on (Jᵀ P J + λ D) x = g, D the frames' blocks of JᵀJ, which also precondition."""
    blocks = jacobian @ jacobian.transpose(0, 2, 1)
    count = blocks.shape[1]
    size = np.einsum("fii->f", blocks) / count
    # A frame without points keeps a finite inverse; a common floor, since frames differ little in size.
    floor = 1e-9 * size + 1e-12 * max(float(size.max(initial=0.0)), np.finfo(float).tiny)
    inverse = np.linalg.inv(blocks + floor[:, None, None] * np.eye(count)) / (1.0 + damping)
    step, left = np.zeros_like(gradient), gradient.copy()
    scaled = (inverse @ left[:, :, None])[:, :, 0]
    direction, size_left = scaled.copy(), float(np.sum(left * scaled))
    target = _CONJUGATE_TOLERANCE**2 * size_left
    for _ in range(_CONJUGATE_STEPS):
        image = problem.project((direction[:, None] @ jacobian)[:, 0])
        image = (jacobian @ image[:, :, None])[:, :, 0] + damping * (blocks @ direction[:, :, None])[:, :, 0]
        curvature = float(np.sum(direction * image))
        if curvature <= 0:
            break
        length = size_left / curvature
        step += length * direction
        left -= length * image
        scaled = (inverse @ left[:, :, None])[:, :, 0]
        fresh = float(np.sum(left * scaled))
        if fresh <= target:
            break
        direction = scaled + fresh / size_left * direction
        size_left = fresh
    return step


def descend(
    tracks: np.ndarray,
    weights: np.ndarray,
    rows: np.ndarray,
    *,
    ridge: float,
    iterations: int,
    tolerance: float,
    fixed: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Motion:
    """Levenberg-Marquardt from given weights (F, K) and rows (F, 2, 3) on ``tracks`` (F, 2, N).

    ``ridge`` is μ; ``fixed`` keeps the rows. Stops when a step lowers the energy by less than ``tolerance`` of itself.
    """
    frames, rank = weights.shape
    height = 5 if ridge > 0 else 2
    padded = np.zeros((frames, height, tracks.shape[2]))
    padded[:, :2] = tracks
    target = padded.reshape(height * frames, -1)
    size = max(float(np.sum(tracks * tracks)), np.finfo(float).tiny)
    state = _Linear(target, _orthonormal(weights), rows, ridge)
    energies, damping, reason = [state.energy / size], _FIRST_DAMPING, "iteration limit"
    for iteration in range(iterations):
        if state.energy <= _SOLVED * size:
            reason = "exact"
            break
        jacobian, gradient = state.jacobian(fixed)
        reason = "no descent"
        while damping < _LARGEST_DAMPING:
            step = _step(state, jacobian, gradient, damping)
            moved = state.rows if fixed else turned(state.rows, step[:, rank:])
            trial = _Linear(target, _orthonormal(state.weights + step[:, :rank]), moved, ridge)
            if trial.energy < state.energy:
                reason = "iteration limit"
                break
            damping *= 4.0
        if reason == "no descent":
            break
        gain = (state.energy - trial.energy) / state.energy
        state, damping = trial, max(damping / 4.0, _LEAST_DAMPING)
        energies.append(state.energy / size)
        progress((iteration + 1) / iterations)
        if gain < tolerance:
            reason = "tolerance"
            break
    error = float(np.sum(state.residual.reshape(frames, height, -1)[:, :2] ** 2)) / size
    basis = state.basis.reshape(rank, 3, -1)
    return Motion(state.weights, state.rows, basis, state.energy / size, error, tuple(energies), reason)
