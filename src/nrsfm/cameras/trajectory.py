"""Metric upgrade of the constant trajectory's triplet (Akhter et al. 2008), as published with trajectory bases.

With S = (Θ ⊗ I₃) A and Θ the first K vectors of the discrete cosine transform, W = ΛA with Λ = R(Θ ⊗ I₃) (2F×3K). The
triplet of Λ that belongs to the constant vector is R itself, stacked, up to one scale. W fixes Λ up to a 3K×3K
matrix, Λ = ΠQ with Π = UΣ, of which three columns G are enough: with x_f, y_f the rows of frame f of ΠG,

    minimise over G (3K×3)   Σ_f (|x_f|² − 1)² + (|y_f|² − 1)² + (x_f·y_f)².

Unlike the residuals of :mod:`nrsfm.cameras.intersection` these know that all frames have one scale.

Source: Akhter, Sheikh, Khan and Kanade, "Nonrigid structure from motion in trajectory space", NIPS 2008; "Trajectory
space: a dual representation for nonrigid structure from motion", PAMI 33(7), 2011. The start is theirs: ones at rows 1,
K + 1 and 2K + 1, the places of the constant in Λ (all x coefficients, then y, then z). In Π, whose columns are
ordered by size, that is one leading and two lesser directions, and what makes it work is that the solver moves along
the large directions first. Departures: (1) Levenberg's damping (a multiple of the identity) with the analytic
Jacobian, on Π = UΣ in place of U√Σ. On the eight motion-capture sequences and K = 1..13 it reached the least cost
known in 103 of 103 cases; on U√Σ in 64, and Marquardt's scaled damping failed on most. (2) The start is scaled to rows
of length 1. (3) K, where it is not given, is chosen as in :mod:`nrsfm.cameras.selection`. (4) Rows become rotations by
the polar factor, and each frame's sign is made consistent with the others.
"""

from __future__ import annotations

import numpy as np

from nrsfm.cameras import selection
from nrsfm.cameras.intersection import Upgraded, polar_rotations
from nrsfm.cameras.signs import apply_signs, consistent_signs

JUDGED_RANKS = (1, 2, 3, 4, 5, 7, 8, 10, 12, 13)
ITERATIONS = 200
POLISH = 1000  # iterations for the winner alone: where the rank is exact the valley is long and flat
TOLERANCE = 1e-7  # least relative gain of an iteration
EXACT = 1e-24  # a mean squared residual that is zero to rounding


def residuals(x: np.ndarray, y: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(3F,): first |x|² − 1 of every frame, then |y|² − 1, then x·y; x, y (F, n) are rows of Π, ``matrix`` (n, 3)."""
    u, v = x @ matrix, y @ matrix
    return np.concatenate([np.sum(u * u, 1) - 1.0, np.sum(v * v, 1) - 1.0, np.sum(u * v, 1)])


def jacobian(x: np.ndarray, y: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Derivatives (3F, 3n) of the residuals by the entries of G, row by row of G."""
    u, v = x @ matrix, y @ matrix
    frames, n = x.shape
    out = np.empty((3, frames, n, 3))
    np.multiply(2.0 * x[:, :, None], u[:, None], out=out[0])
    np.multiply(2.0 * y[:, :, None], v[:, None], out=out[1])
    np.multiply(x[:, :, None], v[:, None], out=out[2])
    out[2] += y[:, :, None] * u[:, None]
    return out.reshape(3 * frames, 3 * n)


def refine(x: np.ndarray, y: np.ndarray, matrix: np.ndarray, iterations: int = ITERATIONS) -> tuple[np.ndarray, float]:
    """Levenberg-Marquardt with damping λI from λ = the mean curvature; returns G and the residual per frame."""
    frames = len(x)
    size = np.sqrt((np.sum((x @ matrix) ** 2) + np.sum((y @ matrix) ** 2)) / (2 * frames))
    if not np.isfinite(size) or size <= 0:
        return matrix, float("inf")
    matrix = matrix / size
    residual, slope = residuals(x, y, matrix), jacobian(x, y, matrix)
    cost = float(residual @ residual)
    hessian, gradient = slope.T @ slope, slope.T @ residual
    damping = largest = float(np.trace(hessian)) / len(hessian)
    for _ in range(iterations):
        if cost <= EXACT * frames:
            break
        damped = hessian.copy()
        damped.flat[:: len(damped) + 1] += damping
        trial = matrix - np.linalg.solve(damped, gradient).reshape(matrix.shape)
        fresh = residuals(x, y, trial)
        value = float(fresh @ fresh)
        if value < cost:
            gain, matrix, damping = (cost - value) / cost, trial, max(damping / 5.0, 1e-13 * largest)
            residual, cost = fresh, value
            if gain < TOLERANCE:
                break
            slope = jacobian(x, y, matrix)
            hessian, gradient = slope.T @ slope, slope.T @ residual
        else:
            damping *= 4.0
            if damping > 1e8 * largest:
                break
    return matrix, cost / frames


def published_start(rank: int, columns: int) -> np.ndarray:
    """G (columns, 3) with ones at rows 1, K + 1 and 2K + 1, as far down as there are columns."""
    start = np.zeros((columns, 3))
    for axis in range(3):
        start[min(axis * rank, columns - 3 + axis), axis] = 1.0
    return start


def rows_of(basis: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows x and y (F, n) of the leading n = min(3K, columns) columns of Π, in units that do not depend on P."""
    n = min(3 * rank, basis.shape[1])
    size = float(np.linalg.norm(basis[:, 0]))
    scale = np.sqrt(len(basis) / 2) / (size if size > 0 else 1.0)
    return np.ascontiguousarray(basis[0::2, :n] * scale), np.ascontiguousarray(basis[1::2, :n] * scale)


def rank_bounds(basis: np.ndarray, *, margin: float = 1.0) -> int:
    """Largest K that the 3F equations can decide: 9K − 3 unknowns, at most ``margin`` of the equations.

    G has 9K entries, of which an orthogonal matrix on its right (3) is free.
    """
    frames, columns = len(basis) // 2, basis.shape[1]
    return max(1, min(int((margin * 3 * frames + 3) // 9), -(-columns // 3)))


def rotations_of(basis: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) of the triplet ΠG, signs made consistent."""
    blocks = (basis[:, : len(matrix)] @ matrix).reshape(-1, 2, 3)
    rotations, _ = polar_rotations(blocks)
    return apply_signs(rotations, consistent_signs(rotations, basis))


def too_large(basis: np.ndarray, rank: int) -> tuple[int, tuple[str, ...]]:
    """The K that can be used, and a warning where it is less than the one asked for."""
    limit = rank_bounds(basis)
    if rank <= limit:
        return rank, ()
    text = f"K = {rank} is more than {len(basis) // 2} frames of rank {basis.shape[1]} can decide: {limit} is used"
    return limit, (f"cameras: {text}",)


def judged(basis: np.ndarray, found: list[tuple[int, np.ndarray, float]]) -> Upgraded:
    """Of upgrades (K, G, cost) the one whose cameras imply the sharpest shapes."""
    judge = selection.Judge(basis)
    paths = [rotations_of(basis, matrix) for _, matrix, _ in found]
    rows = [{"K": k, "cost": c} | judge.criteria(p) for (k, _, c), p in zip(found, paths, strict=True)]
    rank, matrix, _ = found[selection.choose(rows)]
    return finished(basis, rank, matrix)


def finished(basis: np.ndarray, rank: int, matrix: np.ndarray, warnings: tuple[str, ...] = ()) -> Upgraded:
    """The cameras of one upgrade after walking its valley to the end."""
    matrix, cost = refine(*rows_of(basis, rank), matrix, POLISH)
    return Upgraded(rotations_of(basis, matrix), rank, cost, warnings)


def upgrade(basis: np.ndarray, rank: int | None, rng: np.random.Generator) -> Upgraded:
    """Cameras from Π = UΣ (2F, n), n ≥ 3, with K = ``rank``, or chosen. ``rng`` is not used: there is one start."""
    if rank is not None:
        rank, warnings = too_large(basis, rank)
        x, y = rows_of(basis, rank)
        matrix, _ = refine(x, y, published_start(rank, x.shape[1]))
        return finished(basis, rank, matrix, warnings)
    limit = rank_bounds(basis, margin=0.75)
    found = []
    for k in sorted({k for k in JUDGED_RANKS if k < limit} | {min(limit, JUDGED_RANKS[-1])}):
        x, y = rows_of(basis, k)
        found.append((k, *refine(x, y, published_start(k, x.shape[1]))))
    return judged(basis, found)
