"""Shapes from cameras in closed form: the coefficients of K basis shapes are the null space of a linear system.

Tracks of K basis shapes are W = M B with M (2F×3K), frame f of M being [c_f1 R_f … c_fK R_f]. The leading 3K left
singular vectors U of W span the columns of M, so for every basis shape k there is a G_k (3K×3) with

    U_f G_k = c_fk R_f     for all frames f.

Cameras known, this asks of one G that U_f G be a multiple of R_f: five equations per frame, linear in the 9K entries of
G. If G_1 … G_K solve it, so do their combinations, which is no more than a change of basis of the coefficients; the
solutions thus form a space of dimension K, the right singular vectors of its K least singular values. Then
c_fk = <U_f G_k, R_f>/2, and the basis shapes follow from W = M B by least squares.

There is nothing to iterate and no local minimum. With the metric upgrade one looks for a single G, quadratic, without
cameras; here all K are found, linear, with them. Where the tracks are of rank 3K exactly and equations outnumber
unknowns, it is exact. Where they are not, K is a truncation, and U with equal weights (not UΣ) keeps weak basis shapes
from passing for solutions because they are small.

Ours. Related: Xiao, Chai and Kanade, "A closed-form solution to non-rigid shape and motion recovery", ECCV 2004; Dai,
Li and He, IJCV 107, 2014 (the null space of the metric equations); Akhter et al., CVPR 2009.

On the compression it is exact: it knows W by its left singular vectors, and S is linear in W.
"""

from __future__ import annotations

import numpy as np

_RANK = 1e-9  # singular values below this share of the largest are rounding


def largest_basis(frames: int, rank: int) -> int:
    """Most basis shapes that tracks of that rank hold and that 5F equations determine."""
    return max(0, min((rank + 2) // 3, (5 * frames) // 9))


def linear_coefficients(tracks: np.ndarray, rotations: np.ndarray, basis: int) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (F, K) of ``basis`` = K shapes, orthonormal up to scale, and all singular values, ascending.

    ``tracks`` (F, 2, N) and ``rotations`` (F, 2, 3), orthonormal rows.
    """
    frames = len(tracks)
    left, values, _ = np.linalg.svd(tracks.reshape(2 * frames, -1), full_matrices=False)
    count = max(1, min(3 * basis, int(np.count_nonzero(values > _RANK * values[0]))))
    motion = left[:, :count].reshape(frames, 2, count)
    whole = np.zeros((frames, 2, 3, count, 3))
    for axis in range(3):
        whole[:, :, axis, :, axis] = motion
    system = whole.reshape(frames, 6, 3 * count)
    unit = rotations.reshape(frames, 6) / np.sqrt(2.0)
    system -= unit[:, :, None] * np.einsum("fi,fij->fj", unit, system)[:, None, :]
    # Through the Gram matrix of the unknowns: it is small, and singular values of 1e-8 are as good as zero here.
    flat = system.reshape(6 * frames, 3 * count)
    squares, vectors = np.linalg.eigh(flat.T @ flat)
    upgrade = vectors[:, :basis].T.reshape(-1, count, 3)
    coefficients = np.einsum("fia,fij,kja->fk", rotations, motion, upgrade, optimize=True) / 2.0
    return coefficients, np.sqrt(np.maximum(squares, 0.0))


def shapes_of_coefficients(coefficients: np.ndarray, tracks: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Shapes (F, 3, N) = Σ_k c_fk B_k with B from W = M B by least squares."""
    frames, basis = coefficients.shape
    motion = (coefficients[:, None, :, None] * rotations[:, :, None, :]).reshape(2 * frames, 3 * basis)
    shapes = np.linalg.lstsq(motion, tracks.reshape(2 * frames, -1), rcond=1e-10)[0].reshape(basis, 3, -1)
    return np.asarray(np.einsum("fk,kan->fan", coefficients, shapes, optimize=True))
