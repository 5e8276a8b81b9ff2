"""Known cameras: checked, completed to 3×3, never silently repaired."""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.cameras.intersection import polar_rotations
from nrsfm.errors import InputError

TOLERANCE = 1e-3


def cameras_from_known(rotations: Any, frames: int) -> np.ndarray:
    """Return given cameras as float64 rotations (F, 3, 3), camera from object.

    Parameters
    ----------
    rotations
        (F, 3, 3) rotations or (F, 2, 3) first two rows of them.
    frames
        The number of frames the tracks have.

    The two first rows must be orthonormal to 10⁻³ (single precision and rounded text files pass); they are then
    replaced by their polar factor, which moves them by no more than that. The third row is their cross product.

    Raises ``InputError`` for another shape or dtype, another number of frames, non-finite values, rows that are
    not orthonormal, or a third row that is not the cross product of the first two (a reflection).
    """
    try:
        array = np.asarray(rotations)
    except ValueError as error:
        raise InputError(f"rotations: an array (frames, 3, 3) or (frames, 2, 3) is needed ({error})") from None
    if array.dtype.kind not in "fiu":
        raise InputError(f"rotations: real numbers are needed, received dtype {array.dtype}")
    if array.ndim != 3 or array.shape[1] not in (2, 3) or array.shape[2] != 3:
        raise InputError(f"rotations: shape (frames, 3, 3) or (frames, 2, 3) is needed, received {array.shape}")
    if len(array) != frames:
        raise InputError(f"rotations: one per frame is needed, {frames} in all, received {len(array)}")
    array = array.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(array).all(axis=(1, 2)))
    if len(bad):
        raise InputError(f"rotations: finite values are needed, received NaN or infinity in frame {bad[0]}")
    rows = array[:, :2]
    gap = np.abs(rows @ np.swapaxes(rows, 1, 2) - np.eye(2)).max(axis=(1, 2))
    worst = int(np.argmax(gap))
    if gap[worst] > TOLERANCE:
        raise InputError(
            f"rotations: the first two rows must be orthonormal to {TOLERANCE:g}, "
            f"received a deviation of {gap[worst]:.3g} in frame {worst}"
        )
    complete = polar_rotations(rows)[0]
    if array.shape[1] == 3:
        gap = np.abs(array[:, 2] - complete[:, 2]).max(axis=1)
        worst = int(np.argmax(gap))
        if gap[worst] > 2 * TOLERANCE:
            raise InputError(
                f"rotations: the third row must be the cross product of the first two (determinant +1), "
                f"received determinant {np.linalg.det(array[worst]):.3g} in frame {worst}"
            )
    return complete
