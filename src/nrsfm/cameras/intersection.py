"""Metric upgrade of a rank-3K factorisation: find G (3K×3) so that every 2×3 block of ΠG is a scaled rotation.

With WWᵀ = UΣ²Uᵀ and Π = UΣ (2F×3K), a triplet of columns of the true factor is ΠG with rows x, y of frame f
satisfying |xG| = |yG| and xG·yG = 0. On Q = GGᵀ these are linear, and the solutions are where their null space
meets the positive semidefinite matrices of rank 3 ("intersection": Dai, Li and He, "A simple prior-free method
for non-rigid structure-from-motion factorization", IJCV 2014). Here G itself is found by Levenberg-Marquardt on

    r₁ = (a − b)/(a + b),  r₂ = 2c/(a + b),  a = |xG|², b = |yG|², c = xG·yG,

which do not depend on the scale of a frame, from several starts: each costs a few milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Upgrade:
    """One solution of the metric upgrade: G (3K, 3), its mean squared residual per frame, and where it began."""

    matrix: np.ndarray
    cost: float
    start: str
    iterations: int

    @property
    def rank(self) -> int:
        """Number K of basis shapes."""
        return len(self.matrix) // 3


def dominant_basis(factor: np.ndarray, width: int) -> np.ndarray:
    """Π = UΣ (2F, w): the leading columns of the factor's eigenbasis, w = min(width, numerical rank)."""
    from scipy.linalg import eigh

    rows, columns = factor.shape
    # The smaller of the two Gram matrices has the same non-zero spectrum.
    tall = columns < rows
    gram = factor.T @ factor if tall else factor @ factor.T
    size = len(gram)
    width = min(width, size)
    values, vectors = eigh(gram, subset_by_index=(size - width, size - 1), check_finite=False)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    live = values > 1e-13 * max(values[0], np.finfo(float).tiny)
    if tall:
        return np.ascontiguousarray(factor @ vectors[:, live])
    return np.ascontiguousarray(vectors[:, live] * np.sqrt(values[live]))


def residuals(x: np.ndarray, y: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Scale-free residuals (2F,): first (a − b)/(a + b) of every frame, then 2c/(a + b). x, y: (F, n), n = 3K."""
    u, v = x @ matrix, y @ matrix
    a, b, c = np.sum(u * u, 1), np.sum(v * v, 1), np.sum(u * v, 1)
    total = a + b + np.finfo(float).tiny
    return np.concatenate([(a - b) / total, 2.0 * c / total])


def residuals_and_jacobian(x: np.ndarray, y: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The residuals (2F,) and their derivatives (2F, 3n) by the entries of G, row by row."""
    u, v = x @ matrix, y @ matrix
    a, b, c = np.sum(u * u, 1), np.sum(v * v, 1), np.sum(u * v, 1)
    total = a + b + np.finfo(float).tiny
    first, second = (a - b) / total, 2.0 * c / total
    gain = (2.0 / total)[:, None]
    frames, n = x.shape
    jacobian = np.empty((2 * frames, n, 3))
    jacobian[:frames] = x[:, :, None] * (gain * (1.0 - first)[:, None] * u)[:, None]
    jacobian[:frames] -= y[:, :, None] * (gain * (1.0 + first)[:, None] * v)[:, None]
    jacobian[frames:] = x[:, :, None] * (gain * (v - second[:, None] * u))[:, None]
    jacobian[frames:] += y[:, :, None] * (gain * (u - second[:, None] * v))[:, None]
    return np.concatenate([first, second]), jacobian.reshape(2 * frames, 3 * n)


def refine(
    x: np.ndarray, y: np.ndarray, matrix: np.ndarray, *, iterations: int = 100, tolerance: float = 1e-6
) -> tuple[np.ndarray, float, int]:
    """Levenberg-Marquardt on the scale-free residuals; returns G, the sum of squares and the iterations used.

    Stops when the cost falls by less than ``tolerance`` of itself, is zero to rounding, or cannot be lowered.
    """
    size = np.linalg.norm(x @ matrix) + np.linalg.norm(y @ matrix)
    matrix = matrix / size if size > 0 else matrix
    residual, jacobian = residuals_and_jacobian(x, y, matrix)
    cost = float(residual @ residual)
    hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residual
    damping, used = 1e-2, 0
    while used < iterations and cost > 1e-26 * len(residual):
        used += 1
        scaling = np.diag(hessian)
        damped = hessian.copy()
        damped.flat[:: len(damped) + 1] += damping * (scaling + 1e-12 * scaling.max() + np.finfo(float).tiny)
        try:
            step = np.linalg.solve(damped, gradient)
        except np.linalg.LinAlgError:
            damping *= 10.0
            continue
        trial = matrix - step.reshape(matrix.shape)
        fresh = residuals(x, y, trial)
        value = float(fresh @ fresh)
        if value < cost:
            gain, matrix, damping = (cost - value) / cost, trial, max(damping / 5.0, 1e-13)
            residual, jacobian = residuals_and_jacobian(x, y, matrix)
            cost = float(residual @ residual)
            if gain < tolerance:
                break
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        else:
            damping *= 4.0
            if damping > 1e8:
                break
    return matrix, cost, used


def rank_limit(frames: int, columns: int) -> int:
    """Largest K that the data can decide: 2F equations must exceed the 8K − 3 unknowns of G by a margin.

    G has 9K entries; an orthogonal matrix on its right (3) and the choice among the K equally good triplets
    (K) are free. Below the count the cost is zero for arbitrary cameras.
    """
    by_count = int((0.75 * 2 * frames + 3) // 8)
    return max(1, min(by_count, columns // 3))


def upgrades(
    basis: np.ndarray, ranks: int, rng: np.random.Generator, *, starts: int = 8, beam: int = 3
) -> list[Upgrade]:
    """Solve the metric upgrade for K = 1 .. ``ranks``; up to ``beam`` different solutions for each K.

    Starts: for K = 1 the identity; for K = 2 and 3 random matrices, where local minima are many and a solve
    costs a millisecond; for every K ≥ 2 the solutions of K − 1 with a triplet of zeros below.
    """
    x, y = basis[0::2], basis[1::2]
    frames = len(x)
    weights = np.linalg.norm(basis, axis=0)
    kept: list[Upgrade] = []
    found: list[Upgrade] = []
    for rank in range(1, ranks + 1):
        n = 3 * rank
        xs, ys = np.ascontiguousarray(x[:, :n]), np.ascontiguousarray(y[:, :n])
        begins: list[tuple[str, np.ndarray]] = []
        if rank == 1:
            begins.append(("identity", np.eye(n, 3)))
        for parent in kept:
            begins.append(("grown", np.vstack([parent.matrix, np.zeros((3, 3))])))
        if rank in (2, 3):
            for _ in range(starts):
                start = rng.normal(size=(n, 3)) / weights[:n, None]
                begins.append(("random", start * np.repeat(0.7 ** np.arange(rank), 3)[:, None]))
        solved = []
        for name, start in begins:
            matrix, cost, used = refine(xs, ys, start)
            solved.append(Upgrade(matrix, cost / frames, name, used))
        kept = _distinct(solved, beam)
        found.extend(kept)
    return found


def _distinct(solved: list[Upgrade], count: int) -> list[Upgrade]:
    """The ``count`` cheapest solutions whose costs differ by more than 1% (equal costs are equal solutions)."""
    kept: list[Upgrade] = []
    for item in sorted(solved, key=lambda u: u.cost):
        if all(item.cost > 1.01 * other.cost + 1e-20 for other in kept):
            kept.append(item)
        if len(kept) == count:
            break
    return kept


def polar_rotations(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest rotations (F, 3, 3) to 2×3 blocks (F, 2, 3), and the scale (F,) of each block.

    The two rows are the polar factor of the block, the third is their cross product (determinant +1). A block of
    rank below 2 gets an arbitrary but valid rotation and its true, small scale.
    """
    u, values, vt = np.linalg.svd(blocks, full_matrices=False)
    rows = u @ vt
    third = np.cross(rows[:, 0], rows[:, 1])
    return np.concatenate([rows, third[:, None]], axis=1), values.mean(axis=1)
