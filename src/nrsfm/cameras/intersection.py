"""Metric upgrade of a rank-3K factorisation: find G (3K×3) so that every 2×3 block of ΠG is a scaled rotation.

With WWᵀ = UΣ²Uᵀ and Π = UΣ (2F×3K), a triplet of columns of the true factor is ΠG with rows x, y of frame f
satisfying |xG| = |yG| and xG·yG = 0. On Q = GGᵀ these are linear, and the solutions are where their null space
meets the positive semidefinite matrices of rank 3 ("intersection": Dai, Li and He, "A simple prior-free method
for non-rigid structure-from-motion factorization", IJCV 2014). Here G itself is found by Levenberg-Marquardt on

    r₁ = (a − b)/(a + b),  r₂ = 2c/(a + b),  a = |xG|², b = |yG|², c = xG·yG,

which do not depend on the scale of a frame, from several starts: each costs a few milliseconds. Random starts at
K = 2 and 3, grown from there one triplet at a time, find minima that a rigid start alone misses.

With few frames the 2F equations are weak. For K = 1 a third residual r₃ = ω log((a + b)/2), weighted by ω ≤ 1,
says that all frames have one scale (orthographic cameras and a constant mean shape).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

EXACT_COST = 1e-12


@dataclass(frozen=True)
class Upgrade:
    """One solution of the metric upgrade: K, G (3K, 3), its squared residual per frame, and where it began."""

    rank: int
    matrix: np.ndarray
    cost: float
    start: str
    iterations: int


@dataclass(frozen=True)
class Upgraded:
    """What a published estimator gives: rotations (F, 3, 3), signs settled, its K and its residual per frame."""

    rotations: np.ndarray
    rank: int
    cost: float
    warnings: tuple[str, ...] = ()


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


def residuals(x: np.ndarray, y: np.ndarray, matrix: np.ndarray, weight: float = 0.0) -> np.ndarray:
    """First (a − b)/(a + b) of every frame, then 2c/(a + b), then, if ``weight`` ω > 0, ω log((a + b)/2).

    x, y: (F, n) rows of Π. Returns (2F,) or (3F,).
    """
    u, v = x @ matrix, y @ matrix
    a, b, c = np.sum(u * u, 1), np.sum(v * v, 1), np.sum(u * v, 1)
    total = a + b + np.finfo(float).tiny
    parts = [(a - b) / total, 2.0 * c / total]
    if weight > 0:
        parts.append(weight * np.log(total / 2.0))
    return np.concatenate(parts)


def jacobian(x: np.ndarray, y: np.ndarray, matrix: np.ndarray, weight: float = 0.0) -> np.ndarray:
    """Derivatives (2F or 3F, 3n) of the residuals by the entries of G, row by row of G."""
    u, v = x @ matrix, y @ matrix
    a, b, c = np.sum(u * u, 1), np.sum(v * v, 1), np.sum(u * v, 1)
    total = a + b + np.finfo(float).tiny
    first, second = ((a - b) / total)[:, None], (2.0 * c / total)[:, None]
    gain = (2.0 / total)[:, None]
    # d r = x-row ⊗ (left) + y-row ⊗ (right) for each of the residuals.
    pairs = [
        (gain * (1.0 - first) * u, -gain * (1.0 + first) * v),
        (gain * (v - second * u), gain * (u - second * v)),
    ]
    if weight > 0:
        pairs.append((weight * gain * u, weight * gain * v))
    frames, n = x.shape
    out = np.empty((len(pairs), frames, n, 3))
    for block, (left, right) in zip(out, pairs, strict=True):
        np.multiply(x[:, :, None], left[:, None], out=block)
        block += y[:, :, None] * right[:, None]
    return out.reshape(len(pairs) * frames, 3 * n)


def refine(
    x: np.ndarray,
    y: np.ndarray,
    matrix: np.ndarray,
    *,
    weight: float = 0.0,
    iterations: int = 100,
    tolerance: float = 1e-6,
) -> tuple[np.ndarray, float, int]:
    """Levenberg-Marquardt on the residuals; returns G, the sum of squares and the iterations used.

    Stops when the cost falls by less than ``tolerance`` of itself, is zero to rounding, or cannot be lowered.
    """
    size = np.sqrt((np.sum((x @ matrix) ** 2) + np.sum((y @ matrix) ** 2)) / (2 * len(x)))
    if not np.isfinite(size) or size <= 0:
        return matrix, float("inf"), 0
    matrix = matrix / size
    residual, slope = residuals(x, y, matrix, weight), jacobian(x, y, matrix, weight)
    cost = float(residual @ residual)
    hessian, gradient = slope.T @ slope, slope.T @ residual
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
        fresh = residuals(x, y, trial, weight)
        value = float(fresh @ fresh)
        if value < cost:
            gain, matrix, damping = (cost - value) / cost, trial, max(damping / 5.0, 1e-13)
            residual, cost = fresh, value
            if gain < tolerance:
                break
            slope = jacobian(x, y, matrix, weight)
            hessian, gradient = slope.T @ slope, slope.T @ residual
        else:
            damping *= 4.0
            if damping > 1e8:
                break
    return matrix, cost, used


def rank_limit(frames: int, columns: int) -> int:
    """Largest K that the data can decide: 2F equations must exceed the 8K − 3 unknowns of G by a margin.

    G has 9K entries; an orthogonal matrix on its right (3) and the choice among the K equally good triplets
    (K) are free. Near and below the count the cost is zero for arbitrary cameras. The factor's rank need not be
    a multiple of 3: planar or purely scaled deformations add fewer columns.
    """
    by_count = int((0.75 * 2 * frames + 3) // 8)
    return max(1, min(by_count, -(-columns // 3)))


def upgrades(
    basis: np.ndarray,
    ranks: int,
    rng: np.random.Generator,
    *,
    weight: float = 0.0,
    starts: int = 10,
    beam: int = 3,
    progress: Callable[[float], None] | None = None,
) -> list[Upgrade]:
    """Solve the metric upgrade for K = 1 .. ``ranks``; up to ``beam`` different solutions for each K.

    Starts: for K = 1 the identity; for K = 2 and 3 random matrices, where local minima are many and a solve
    costs a millisecond; for every K ≥ 2 the solutions of K − 1 with a triplet of zeros below. ``weight`` is the
    ω of the one-scale residual and acts at K = 1 only.
    """
    x, y = basis[0::2], basis[1::2]
    frames, columns = x.shape
    sizes = np.linalg.norm(basis, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    kept: list[Upgrade] = []
    found: list[Upgrade] = []
    for rank in range(1, ranks + 1):
        n = min(3 * rank, columns)
        xs, ys = np.ascontiguousarray(x[:, :n]), np.ascontiguousarray(y[:, :n])
        begins = [("grown", np.vstack([p.matrix, np.zeros((n - len(p.matrix), 3))])) for p in kept]
        if rank == 1:
            begins.append(("identity", np.eye(n, 3)))
        elif rank <= 3:
            for _ in range(starts):
                start = rng.normal(size=(n, 3)) / sizes[:n, None]
                begins.append(("random", start * np.repeat(0.7 ** np.arange(rank), 3)[:n, None]))
        solved = []
        for name, start in begins:
            matrix, cost, used = refine(xs, ys, start, weight=weight if rank == 1 else 0.0)
            if np.isfinite(cost):
                solved.append(Upgrade(rank, matrix, cost / frames, name, used))
        kept = _distinct(solved, beam if rank <= 5 else 2)
        found.extend(kept)
        if progress is not None:
            progress(rank / ranks)
    return found


def first_exact(solved: list[Upgrade], frames: int) -> int | None:
    """Index of the first solution that is exact: no residual, though the equations outnumber the unknowns twice.

    Only noise-free tracks of exactly low rank have one; no criterion on the shapes is then needed.
    """
    for i, item in enumerate(solved):
        if item.rank > 1 and item.cost < EXACT_COST and 2 * frames >= 2 * (8 * item.rank - 3):
            return i
    return None


def _distinct(solved: list[Upgrade], count: int) -> list[Upgrade]:
    """The ``count`` cheapest solutions whose costs differ by more than 1% (equal costs are equal solutions).

    Solutions 30 times as costly as the best do not recover when they are grown; they are left out.
    """
    kept: list[Upgrade] = []
    for item in sorted(solved, key=lambda u: u.cost):
        if kept and item.cost > 30.0 * kept[0].cost + 1e-12:
            break
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
