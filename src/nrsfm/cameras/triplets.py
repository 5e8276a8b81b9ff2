"""The K column triplets of a corrective matrix, and which K: what the estimators published after 2014 start from.

With Π = UΣ (2F×3K), the corrective matrix G = [G₁ … G_K] (3K×3K) turns Π into the block matrix of c_fk R_f. Every
triplet shows the same rotations, Π_f G_k = c_fk R_f, so one is enough in theory (Dai, Li and He 2014); in practice they
differ. Given the rotations of one triplet, the others follow in closed form: the coefficient vectors c with

    minimal ‖(I − UUᵀ) M(c)‖²,  M(c) = stack of c_f R_f,  |c| = 1

are the leading left singular vectors of V (F×9K), row f = vec(U_fᵀR_f), since ‖UᵀM(c)‖ = ‖cᵀV‖; and ΠG_k = UUᵀM(c_k).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nrsfm.cameras import intersection, signs
from nrsfm.cameras.intersection import Upgrade

LARGEST_RANK = 13
ONE_SCALE_FRAMES = 20.0  # weight of the one-scale residual at K = 1: min(1, this / F), as of the intersection method
NEAR_COST = 5.0  # minima of the metric upgrade that cost more than so many times the least are not considered


@dataclass(frozen=True)
class Solved:
    """Minima of the metric upgrade for K = 1 … ``limit``, cheapest first for each K, and what to tell the user.

    ``exact``: the upgrade that leaves no residual though its equations outnumber its unknowns twice, or None.
    """

    by_rank: dict[int, list[Upgrade]]
    limit: int
    exact: Upgrade | None
    warnings: tuple[str, ...]


def solve_upgrades(basis: np.ndarray, rank: int | None, rng: np.random.Generator) -> Solved:
    """Solve the metric upgrade of Π (2F, n) for every K up to ``rank``, or up to what frames and columns can decide."""
    frames, columns = len(basis) // 2, basis.shape[1]
    limit, warnings = intersection.rank_limit(frames, columns), []
    if rank is not None and rank > limit:
        warnings.append(
            f"camera_rank {rank} is more than {frames} frames of rank {columns} can decide: {limit} is used"
        )
    limit = min(rank or LARGEST_RANK, limit)
    found = intersection.upgrades(basis, limit, rng, weight=min(1.0, ONE_SCALE_FRAMES / frames))
    if not found:
        warnings.append("the metric upgrade has no solution: the tracks hold no shape")
        found = [Upgrade(1, np.eye(min(3, columns), 3), 0.0, "identity", 0)]
        limit = 1
    by_rank: dict[int, list[Upgrade]] = {}
    for item in found:
        by_rank.setdefault(item.rank, []).append(item)
    index = intersection.first_exact(found, frames)
    exact = None if index is None else polished(basis, found[index])
    return Solved(by_rank, limit, exact, tuple(warnings))


def polished(basis: np.ndarray, item: Upgrade) -> Upgrade:
    """The same minimum, walked to the end of its valley (long and flat where the rank is exact)."""
    if item.rank == 1:
        return item
    n = len(item.matrix)
    x, y = np.ascontiguousarray(basis[0::2, :n]), np.ascontiguousarray(basis[1::2, :n])
    matrix, cost, used = intersection.refine(x, y, item.matrix, iterations=400, tolerance=1e-9)
    return replace(item, matrix=matrix, cost=2.0 * cost / len(basis), iterations=item.iterations + used)


def rotations_of(basis: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) nearest to 2×3 blocks (F, 2, 3), their signs made to agree on one mean shape of Π."""
    rotations, _ = intersection.polar_rotations(blocks)
    return signs.apply_signs(rotations, signs.consistent_signs(rotations, basis))


def first_triplet(basis: np.ndarray, item: Upgrade) -> np.ndarray:
    """Blocks ΠG₁ (F, 2, 3) of one minimum of the metric upgrade."""
    return (basis[:, : len(item.matrix)] @ item.matrix).reshape(-1, 2, 3)


def all_triplets(basis: np.ndarray, rotations: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Blocks ΠG_k (K, F, 2, 3) of all triplets that agree with ``rotations`` (F, 3, 3), and their coefficients (F, K).

    The formula is in this module's head. Fewer than K triplets come back where the basis has fewer columns or frames.
    """
    frames = len(rotations)
    left, values, _ = np.linalg.svd(basis[:, : 3 * rank], full_matrices=False)
    left = left[:, values > 1e-12 * values[0]] if values[0] > 0 else left[:, :1]
    seen = np.einsum("fan,faj->fnj", left.reshape(frames, 2, -1), rotations[:, :2]).reshape(frames, -1)
    coefficients = np.linalg.svd(seen, full_matrices=False)[0][:, :rank]
    coefficients = coefficients[:, : max(1, left.shape[1] // 3)]
    stacks = np.einsum("fk,faj->kfaj", coefficients, rotations[:, :2]).reshape(-1, 2 * frames, 3)
    return (left @ (left.T @ stacks)).reshape(-1, frames, 2, 3), coefficients


def all_rotations(basis: np.ndarray, rotations: np.ndarray, rank: int) -> list[np.ndarray]:
    """Rotations (F, 3, 3) of each of the triplets that agree with ``rotations``; c_fk tells the sign of every block."""
    blocks, coefficients = all_triplets(basis, rotations, rank)
    signed = blocks * np.where(coefficients.T < 0, -1.0, 1.0)[:, :, None, None]
    return [intersection.polar_rotations(block)[0] for block in signed]
