"""Known cameras in the layouts in which people store them, as rotations (F, 3, 3)."""

from __future__ import annotations

import numpy as np

from nrsfm.errors import InputError

# Stored rotations have passed through float32 or a few decimals at most.
_ORTHONORMAL = 1e-3


def rotations_from_array(array: np.ndarray, name: str = "rotations") -> np.ndarray:
    """Return rotations (F, 3, 3) float64, camera from object, of an array as in ``load_rotations``.

    A third row that is not given is the cross product of the two others. Values are kept as stored.

    Raises
    ------
    InputError
        The array has another layout, or its rows are not orthonormal to 1e-3, or a determinant is −1.
    """
    array = np.asarray(array)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real numbers are needed, received dtype {array.dtype}")
    rows = _rows(array.astype(np.float64), name)
    if not np.all(np.isfinite(rows)):
        raise InputError(f"{name}: every number must be finite, received NaN or infinity")
    gaps = np.abs(rows @ rows.transpose(0, 2, 1) - np.eye(rows.shape[1])).max(axis=(1, 2))
    worst = int(np.argmax(gaps))
    if gaps[worst] > _ORTHONORMAL:
        raise InputError(
            f"{name}: the rows of every camera must be orthonormal, received frame {worst} that is off by "
            f"{gaps[worst]:.2g}"
        )
    if rows.shape[1] == 2:
        third = np.cross(rows[:, 0], rows[:, 1])
        return np.concatenate([rows, third[:, np.newaxis]], axis=1)
    determinants = np.linalg.det(rows)
    if np.any(determinants < 0):
        raise InputError(
            f"{name}: every determinant must be 1, received -1 in frame {int(np.argmin(determinants))} (two "
            "rows of each camera are enough: the third follows)"
        )
    return rows


def _rows(array: np.ndarray, name: str) -> np.ndarray:
    """The camera rows (F, 2 or 3, 3)."""
    shape = array.shape
    if array.size and array.ndim == 3:
        if shape[1] in (2, 3) and shape[2] == 3:
            return array
        if shape[0] in (2, 3) and shape[1] == 3:  # MATLAB's habit: frames last
            return array.transpose(2, 0, 1)
    if array.size and array.ndim == 2:
        blocks = _diagonal_blocks(array)
        if blocks is not None:
            return blocks
        if shape[1] == 3 and shape[0] % 2 == 0:
            return array.reshape(-1, 2, 3)
        if shape[1] in (6, 9):
            return array.reshape(shape[0], -1, 3)
    raise InputError(
        f"{name}: cameras of shape (F, 3, 3), (F, 2, 3), (3, 3, F), 2F×3, F×9, F×6 or block-diagonal 3F×3F "
        f"are needed, received {shape}"
    )


def _diagonal_blocks(matrix: np.ndarray) -> np.ndarray | None:
    """The blocks of a 3F×3F or 2F×3F block-diagonal matrix, or ``None`` where it is not one."""
    frames, rest = divmod(matrix.shape[1], 3)
    if rest or frames < 2 or matrix.shape[0] not in (2 * frames, 3 * frames):
        return None
    height = matrix.shape[0] // frames
    grid = matrix.reshape(frames, height, frames, 3)
    index = np.arange(frames)
    blocks: np.ndarray = grid[index, :, index]
    if np.count_nonzero(matrix) != np.count_nonzero(blocks):
        return None
    return blocks
