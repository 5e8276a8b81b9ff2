"""What an iteration needs beside the array-API standard, to be written once for NumPy and for arrays on a device.

For arrays of NumPy all of it is NumPy's own indexing: nothing is loaded, nothing is copied that need not be. What
moves between a device and this process's memory moves by :func:`nrsfm.devices.to_host` and ``to_device``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nrsfm.devices import namespace, to_device, to_host


def namespace_of(array: Any) -> Any:
    """The array-API functions for an array: NumPy, or those of the library of an array on a device."""
    return np if isinstance(array, np.ndarray) else namespace(array)


def on_host(array: Any) -> np.ndarray:
    """The numbers in this process's memory; an array of NumPy itself."""
    return array if isinstance(array, np.ndarray) else to_host(array)


def beside(array: np.ndarray, like: Any) -> Any:
    """The numbers where ``like`` is, in its library; an array of NumPy itself where ``like`` is one."""
    return array if isinstance(like, np.ndarray) else to_device(array, like)


def taken(array: Any, which: np.ndarray, axis: int) -> Any:
    """Entries ``which`` (n,) of a matrix along axis 0 or 1."""
    if isinstance(array, np.ndarray):  # its layout for products to come is another than that of take()
        return array[which] if axis == 0 else array[:, which]
    return namespace(array).take(array, to_device(which, array), axis=axis)


def with_columns(matrix: Any, changed: Sequence[tuple[np.ndarray, Any]]) -> Any:
    """A copy of a matrix (d, N) in which columns are others: pairs of indices (n,), no index twice, and (d, n)."""
    if isinstance(matrix, np.ndarray):
        out = matrix.copy()
        for own, block in changed:
            out[:, own] = block
        return out
    if not changed:
        return matrix
    # The standard writes to slices only: what changes and what does not side by side, then put in order.
    rest = np.ones(matrix.shape[1], dtype=bool)
    for own, _ in changed:
        rest[own] = False
    other = np.flatnonzero(rest)
    order = np.concatenate([*(own for own, _ in changed), other])
    joined = namespace(matrix).concat([*(block for _, block in changed), taken(matrix, other, 1)], axis=1)
    return taken(joined, np.argsort(order), 1)
