"""Generalised Procrustes alignment of 3D shapes, and the tangent space of shapes at a mean.

A shape is X (3, N) without translation. It is aligned with a mean M, ‖M‖ = 1, by the rotation A and the scale 1/c:
Y = A X / c with <M, Y> = 1 and M Yᵀ symmetric. Y − M is then orthogonal to what a rigid motion or a change of size
can do to M, to first order: the Procrustes directions M, e₁×M, e₂×M, e₃×M. Their complement is the tangent space.

Source: Gower, "Generalized Procrustes analysis", Psychometrika 40, 1975; Lee, Cho, Choi and Oh, "Procrustean normal
distribution for non-rigid structure from motion", CVPR 2013.
"""

from __future__ import annotations

import numpy as np

_SMALLEST = 1e-9  # size of an aligned shape relative to the mean, below which it is a point


def procrustes_directions(mean: np.ndarray) -> np.ndarray:
    """M, e₁×M, e₂×M and e₃×M as columns (3N, 4), for a mean (3, N)."""
    x, y, z = mean
    zero = np.zeros_like(x)
    columns = [(x, y, z), (zero, -z, y), (z, zero, -x), (-y, x, zero)]
    return np.stack([np.concatenate(column) for column in columns], axis=1)


def onto_tangent_space(mean: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Columns (3N, m) without their parts along the Procrustes directions of the mean (3, N)."""
    left, values, _ = np.linalg.svd(procrustes_directions(mean), full_matrices=False)
    rigid = left[:, values > 1e-10 * max(float(values[0]), np.finfo(float).tiny)]  # a line has only three
    return np.asarray(vectors - rigid @ (rigid.T @ vectors))


def align(shapes: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations A (F, 3, 3) and sizes c (F,) that align shapes (F, 3, N) with the mean: Y = A X / c.

    A maximises <M, A X> over rotations (determinant +1), c is that maximum, so that <M, Y> = 1.
    """
    left, values, right = np.linalg.svd(np.einsum("an,fbn->fab", mean, shapes, optimize=True))
    sign = np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)
    left[:, :, 2] *= sign[:, None]
    values[:, 2] *= sign
    return left @ right, np.maximum(values.sum(axis=1), _SMALLEST)


def procrustes_mean(
    shapes: np.ndarray, mean: np.ndarray, *, iterations: int, tolerance: float = 1e-10
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mean of the aligned shapes, ‖M‖ = 1, and the alignment of the shapes (F, 3, N) with it.

    Starts from ``mean`` and alternates alignment and averaging. Returns M (3, N), A (F, 3, 3) and c (F,).
    """
    mean = mean / max(float(np.linalg.norm(mean)), np.finfo(float).tiny)
    for _ in range(iterations):
        rotations, sizes = align(shapes, mean)
        average = np.einsum("fab,fbn->an", rotations / sizes[:, None, None], shapes, optimize=True)
        length = float(np.linalg.norm(average))
        if length == 0:
            break
        change = float(np.linalg.norm(average / length - mean))
        mean = average / length
        if change < tolerance:
            break
    return mean, *align(shapes, mean)
