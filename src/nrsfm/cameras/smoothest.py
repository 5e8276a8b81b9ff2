"""Of the K triplets' camera paths the smoothest: all K column triplets of the corrective matrix are looked at.

    R = argmin over the triplets k   Σ_f ‖R_f^(k) − R_{f−1}^(k)‖²_F

Source: Kumar, "Non-rigid structure from motion: prior-free factorization method revisited", WACV 2020 (arXiv
1902.10274): Dai, Li and He's rotations from one triplet, replaced by those of the triplet that moves most smoothly.

Departures. Only the paper's abstract was at hand. The triplets are solved by Levenberg-Marquardt and the closed form of
:mod:`nrsfm.cameras.triplets`, not by one conic programme each. All minima that cost at most five times the least give
their K triplets to the choice: dearer ones are wrong however smooth (yoga, K = 6: a path that is 73 degrees off is
smoother than the best one). K, where it is not given, is the one whose path the low-rank shapes judge best
(:mod:`nrsfm.cameras.selection`), unless an upgrade is exact.

What was seen (rotation error in degrees, one corrective matrix of K triplets): the first triplet, in which the mean
shape shows, is the smoothest on all sequences that were tried; the others, whose coefficients change sign, are off by
up to 60 degrees and more where the tracks are not exactly of rank 3K.
"""

from __future__ import annotations

import numpy as np

from nrsfm.cameras import selection, triplets
from nrsfm.cameras.intersection import Upgrade, Upgraded


def upgrade(basis: np.ndarray, rank: int | None, rng: np.random.Generator) -> Upgraded:
    """Rotations from Π = UΣ (2F, n); ``rank`` K, or None for K chosen from the data."""
    solved = triplets.solve_upgrades(basis, rank, rng)
    if solved.exact is not None:
        best = [solved.exact]
    elif rank is not None:
        best = solved.by_rank[max(solved.by_rank)]
    else:
        judge = selection.Judge(basis)
        kinds = list(solved.by_rank.values())
        rows = [
            {"K": items[0].rank, "cost": items[0].cost} | judge.criteria(_smoothest(basis, items)) for items in kinds
        ]
        best = kinds[selection.choose(rows)]
    best = [triplets.polished(basis, item) for item in best]
    return Upgraded(_smoothest(basis, best), best[0].rank, best[0].cost, solved.warnings)


def roughness(rotations: np.ndarray) -> float:
    """Σ_f ‖R_f − R_{f−1}‖²_F of a path (F, 3, 3)."""
    return float(np.sum((rotations[1:] - rotations[:-1]) ** 2))


def _smoothest(basis: np.ndarray, items: list[Upgrade]) -> np.ndarray:
    """The smoothest path (F, 3, 3) of all triplets of the minima near the cheapest."""
    least = min(item.cost for item in items)
    paths = []
    for item in items:
        if item.cost > triplets.NEAR_COST * least + 1e-12:
            continue
        first = triplets.rotations_of(basis, triplets.first_triplet(basis, item))
        paths.append(first)
        if item.rank > 1:
            paths.extend(triplets.all_rotations(basis, first, item.rank))
    return min(paths, key=roughness)
