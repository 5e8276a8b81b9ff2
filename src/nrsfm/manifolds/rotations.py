"""Rotations from what is known of them: their rows, or rotation vectors (axis times angle)."""

from __future__ import annotations

import numpy as np


def whole_rotations(rows: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) from their upper rows (F, 2, 3), orthonormal."""
    return np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)


def from_vectors(vectors: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) from rotation vectors (..., 3) in radians: exp of the cross product's matrix."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def to_vectors(rotations: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3), at most π long, of rotations (..., 3, 3): the inverse of :func:`from_vectors`."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations).as_rotvec())
