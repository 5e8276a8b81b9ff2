"""Metric upgrade by thresholding: the Gram matrix Q = GGᵀ (3K×3K) by proximal gradient, then its rank-3 part.

    minimise over Q ⪰ 0   ½Σ_f [½(x_f Q x_fᵀ − y_f Q y_fᵀ)² + 2(x_f Q y_fᵀ)²] + (F/2)(mean scale − 1)² + μ tr Q

x_f, y_f: rows of M = U√Σ (2F×3K); mean scale = Σ_f (x_f Q x_fᵀ + y_f Q y_fᵀ)/2F, without which Q = 0 would do. The
trace is the nuclear norm of a positive semidefinite matrix, and its proximal step thresholds the eigenvalues.
Rotations are the polar factors of MG, with G from the three leading eigenvectors.

Source: Ansari, Golyanik and Stricker, "Scalable dense monocular surface reconstruction", 3DV 2017 (arXiv 1710.06130):
cameras by singular-value thresholding and proximal gradient. Only its abstract was at hand: the objective above is
derived from Dai, Li and He's constraints (IJCV 2014), and accelerated with restarts (O'Donoghue and Candès 2015). No
non-linear refinement follows. The cameras see the tracks as they are, not smoothed along time as the shapes' tracks
are: smoothing bends the constraints (by cross-validation; ict at 3% noise: .8 degrees without, 2.1 with; face 4 at 3%:
5.6 and 11.6).

K is an upper bound only, since the trace chooses the rank: the largest that the frames can decide, at most 13. The
scaling of M matters, because the trace is measured in it: with U in place of U√Σ the minimum drowns in the solutions of
the linear constraints (face 3, K = 10: 102 degrees off, against 1.9).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.cameras import intersection, triplets
from nrsfm.cameras.intersection import Upgraded

_WEIGHT = 1e-3  # final μ, as a share of the μ from which on Q = 0 is the minimum
_FALL = 0.95  # of μ per iteration
_ITERATIONS = 2000
_TOLERANCE = 1e-7  # relative change of Q at which to stop, once μ has its final value


def upgrade(basis: np.ndarray, rank: int | None, rng: np.random.Generator) -> Upgraded:
    """Rotations from Π = UΣ (2F, n); ``rank`` K, or None for the largest that the frames can decide."""
    frames = len(basis) // 2
    limit = intersection.rank_limit(frames, basis.shape[1])
    warnings: tuple[str, ...] = ()
    if rank is not None and rank > limit:
        warnings = (f"camera_rank {rank} is more than {frames} frames can decide: {limit} is used",)
    rank = min(rank or triplets.LARGEST_RANK, limit)
    columns = basis[:, : 3 * rank]
    if columns.shape[1] < 3:
        columns = np.hstack([columns, np.zeros((2 * frames, 3 - columns.shape[1]))])
    sizes = np.linalg.norm(columns, axis=0)
    scaled = columns / np.sqrt(np.where(sizes > 0, sizes, 1.0))
    size = float(np.sqrt(np.mean(scaled * scaled)))
    problem = Constraints(scaled[0::2] / size, scaled[1::2] / size) if size > 0 else None
    if problem is None:
        return Upgraded(np.tile(np.eye(3), (frames, 1, 1)), 1, 0.0, ("the tracks hold no shape",))
    values, vectors = np.linalg.eigh(minimise(problem)[0])
    matrix = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0.0))
    blocks = np.stack([problem.x @ matrix, problem.y @ matrix], axis=1)
    residual = intersection.residuals(problem.x, problem.y, matrix)
    return Upgraded(triplets.rotations_of(basis, blocks), rank, float(residual @ residual) / frames, warnings)


@dataclass(frozen=True)
class Constraints:
    """The linear map of this module's head; ``x``, ``y`` (F, n) are the rows of M."""

    x: np.ndarray
    y: np.ndarray

    def residuals(self, gram: np.ndarray) -> np.ndarray:
        """(2F + 1,): (xQxᵀ − yQyᵀ)/√2 and √2 xQyᵀ of every frame, and √F (mean scale − 1)."""
        left, right = self.x @ gram, self.y @ gram
        a, b, c = np.sum(left * self.x, 1), np.sum(right * self.y, 1), np.sum(left * self.y, 1)
        scale = np.sqrt(len(a)) * (0.5 * float(np.mean(a + b)) - 1.0)
        return np.concatenate([(a - b) / np.sqrt(2.0), np.sqrt(2.0) * c, [scale]])

    def adjoint(self, residual: np.ndarray) -> np.ndarray:
        """Gradient (n, n) of ½‖residuals‖² by Q, symmetric."""
        frames = len(self.x)
        first, second, last = residual[:frames, None], residual[frames:-1, None], residual[-1]
        mixed = (self.x * second).T @ self.y
        even, odd = 0.5 * last / np.sqrt(frames), first / np.sqrt(2.0)
        parts = (self.x * (even + odd)).T @ self.x + (self.y * (even - odd)).T @ self.y
        return parts + np.sqrt(0.5) * (mixed + mixed.T)

    def curvature(self) -> float:
        """Upper bound of the largest eigenvalue of the map's square, by the power method."""
        n = self.x.shape[1]
        zero = self.residuals(np.zeros((n, n)))
        gram, size = np.eye(n), 1.0
        for _ in range(50):
            gram = self.adjoint(self.residuals(gram / np.linalg.norm(gram)) - zero)
            size = float(np.linalg.norm(gram))
        return 1.1 * size


def minimise(problem: Constraints) -> tuple[np.ndarray, float]:
    """Q (n, n) of the objective in this module's head, and the final μ."""
    n = problem.x.shape[1]
    curvature = problem.curvature()
    gram = np.zeros((n, n))
    largest = float(np.linalg.eigvalsh(-problem.adjoint(problem.residuals(gram)))[-1])
    weight = largest
    ahead, momentum = gram, 1.0
    for _ in range(_ITERATIONS):
        weight = max(_FALL * weight, _WEIGHT * largest)
        values, vectors = np.linalg.eigh(ahead - problem.adjoint(problem.residuals(ahead)) / curvature)
        fresh = (vectors * np.maximum(values - weight / curvature, 0.0)) @ vectors.T
        change = fresh - gram
        if np.sum((ahead - fresh) * change) > 0:  # the momentum points uphill: start it again
            momentum, ahead = 1.0, fresh
        else:
            following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
            ahead, momentum = fresh + (momentum - 1.0) / following * change, following
        gram = fresh
        if weight <= _WEIGHT * largest and np.linalg.norm(change) < _TOLERANCE * np.linalg.norm(gram):
            break
    return gram, weight
