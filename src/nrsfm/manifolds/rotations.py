"""Rotations from what is known of them."""

from __future__ import annotations

import numpy as np


def whole_rotations(rows: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) from their upper rows (F, 2, 3), orthonormal."""
    return np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
