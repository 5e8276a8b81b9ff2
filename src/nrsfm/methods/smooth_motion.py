"""The smoothest motion that shows the tracks, cameras known.

    minimise over S   Σ_f ‖W_f − R_f S_f‖² + λ Σ_f ‖S_f+1 − S_f‖²

One linear system, the same for every point: block tridiagonal, 3F unknowns. The second term weighs what no frame sees
of itself, its depth, by what its neighbours in time see of it from elsewhere. With λ → 0 the tracks are met exactly.
It holds on the exact compression, because all columns are treated alike.

It is the smoothness over time of Dai, Deng and He, "Dense non-rigid structure-from-motion made easy: a
spatial-temporal smoothness based solution", ICIP 2017, without its other terms.
"""

from __future__ import annotations

import numpy as np


def smooth_motion(tracks: np.ndarray, rotations: np.ndarray, weight: float) -> np.ndarray:
    """Shapes (F, 3, N) of tracks (F, 2, N) under cameras (F, 2, 3), for a weight λ > 0.

    O(F N) time; F ≥ 2. Where the cameras do not turn depth is undetermined, and the least of all solutions is near.
    """
    from scipy.linalg import solveh_banded

    frames = len(tracks)
    bands = np.zeros((6, 3 * frames))  # of a symmetric matrix, main diagonal last
    blocks = np.swapaxes(rotations, 1, 2) @ rotations
    ends = np.ones(frames)
    ends[1:-1] = 2.0
    blocks += weight * ends[:, None, None] * np.eye(3)
    blocks[np.arange(frames)[:, None], np.arange(3), np.arange(3)] += np.finfo(float).eps * 16  # a still camera
    for row in range(3):
        for column in range(row, 3):
            bands[5 - (column - row), column::3] = blocks[:, row, column]
    bands[2, 3:] = -weight
    wanted = (np.swapaxes(rotations, 1, 2) @ tracks).reshape(3 * frames, -1)
    return np.asarray(solveh_banded(bands, wanted)).reshape(frames, 3, -1)
