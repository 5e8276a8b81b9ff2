"""The upgrade of :mod:`nrsfm.cameras.trajectory` with G grown three rows at a time (Gotardo and Martinez 2011).

K begins at 1, G is solved for, three rows of zeros are put below it, and so on until another triplet gains nothing.
Each stage starts where the last one ended, so that a G of 3K rows is found without a start of its own.

Source: Gotardo and Martinez, "Computing smooth time-trajectories for camera and deformable shape in structure from
motion with occlusion", PAMI 33(10), 2011, who take the cameras of the trajectory-basis method.
Departures: (1) every stage is also solved from the published start of that method and the cheaper of the two goes on:
grown alone it ends in a wrong minimum on yoga from K = 2 on. (2) The residual always falls as G grows, so "no gain" is
judged on the shapes that the cameras imply (:mod:`nrsfm.cameras.selection`): of K = 1..13 the largest whose shapes are
as sharp as the sharpest.
"""

from __future__ import annotations

import numpy as np

from nrsfm.cameras.intersection import Upgraded
from nrsfm.cameras.trajectory import (
    JUDGED_RANKS,
    finished,
    judged,
    published_start,
    rank_bounds,
    refine,
    rows_of,
    too_large,
)


def grow(basis: np.ndarray, rank: int) -> list[tuple[int, np.ndarray, float]]:
    """(K, G (n, 3), cost per frame) for K = 1 .. ``rank``."""
    found: list[tuple[int, np.ndarray, float]] = []
    for k in range(1, rank + 1):
        x, y = rows_of(basis, k)
        starts = [published_start(k, x.shape[1])]
        if found:
            last = found[-1][1]
            starts.append(np.vstack([last, np.zeros((x.shape[1] - len(last), 3))]))
        matrix, cost = min((refine(x, y, start) for start in starts), key=lambda solved: solved[1])
        found.append((k, matrix, cost))
    return found


def upgrade(basis: np.ndarray, rank: int | None, rng: np.random.Generator) -> Upgraded:
    """Cameras from Π = UΣ (2F, n), n ≥ 3, grown to K = ``rank``, or as far as it gains. ``rng`` is not used."""
    if rank is not None:
        rank, warnings = too_large(basis, rank)
        return finished(basis, rank, grow(basis, rank)[-1][1], warnings)
    limit = min(rank_bounds(basis, margin=0.75), JUDGED_RANKS[-1])
    return judged(basis, grow(basis, limit))
