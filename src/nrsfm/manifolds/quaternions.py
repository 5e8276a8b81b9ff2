"""Turns of cameras as quaternions of any length, for descents without constraints.

q = (w, v) with |q| = 1 stands for Q(q) = (w² − v·v) I + 2 v vᵀ + 2 w [v]ₓ; another length is divided out, and the
gradient is orthogonal to q. Source: Hamilton's quaternions, as in every text on rotations.
"""

from __future__ import annotations

import numpy as np


def turned_rows(rows: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Rows (F, 2, 3) of R_f turned by quaternions (F, 4) of any length: R_f Q(q)."""
    return np.asarray(rows @ _rotation(turns / np.linalg.norm(turns, axis=1, keepdims=True)))


def turn_gradient(rows: np.ndarray, turns: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Gradient over quaternions (F, 4) from that over the turned rows (F, 2, 3)."""
    length = np.linalg.norm(turns, axis=1, keepdims=True)
    unit = turns / length
    back = np.swapaxes(rows, 1, 2) @ slope
    w, v = unit[:, :1], unit[:, 1:]
    # Q = (w² − v·v) I + 2 v vᵀ + 2 w [v]ₓ; for a unit quaternion (w² − v·v) is 2w² − 1.
    trace = np.trace(back, axis1=1, axis2=2)[:, None]
    twist = np.stack([back[:, 2, 1] - back[:, 1, 2], back[:, 0, 2] - back[:, 2, 0], back[:, 1, 0] - back[:, 0, 1]], 1)
    both = (back + np.swapaxes(back, 1, 2)) @ v[:, :, None]
    by_scalar = 2.0 * w * trace + 2.0 * np.sum(v * twist, axis=1, keepdims=True)
    by_vector = -2.0 * v * trace + 2.0 * both[:, :, 0] + 2.0 * w * twist
    gradient = np.concatenate([by_scalar, by_vector], axis=1)
    return np.asarray((gradient - unit * np.sum(gradient * unit, axis=1, keepdims=True)) / length)


def _rotation(unit: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) of unit quaternions (F, 4)."""
    w, v = unit[:, 0], unit[:, 1:]
    cross = np.zeros((len(unit), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = v.T
    cross = cross - np.swapaxes(cross, 1, 2)
    level = (w * w - np.sum(v * v, axis=1))[:, None, None] * np.eye(3)
    return np.asarray(level + 2.0 * v[:, :, None] * v[:, None, :] + 2.0 * w[:, None, None] * cross)
