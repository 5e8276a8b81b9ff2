"""Arrays of other libraries, on whatever device they are: PyTorch and CuPy, through the array-API standard.

Everything that knows of such arrays asks here; nothing moves between a device and this process's memory but through
:func:`to_host` and :func:`to_device`. The extra ``gpu`` (array-api-compat) is needed; the library itself is the user's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.errors import InputError

_LIBRARIES = ("torch", "cupy", "array_api_strict")


def is_on_device(value: Any) -> bool:
    """Whether a value is an array of PyTorch or CuPy, on a graphics card or not; loads no library to tell."""
    return type(value).__module__.partition(".")[0] in _LIBRARIES and hasattr(value, "shape")


def namespace(array: Any) -> Any:
    """The array-API functions for an array. Raises ``InputError`` where the extra ``gpu`` is not installed."""
    return _compat().array_namespace(array)


def to_host(array: Any) -> np.ndarray:
    """The numbers in this process's memory, as a NumPy array."""
    if hasattr(array, "detach"):  # PyTorch
        return np.asarray(array.detach().cpu().numpy())
    if hasattr(array, "get"):  # CuPy
        return np.asarray(array.get())
    return np.from_dlpack(array)


def to_device(array: np.ndarray, like: Any) -> Any:
    """A NumPy array as one of the library of ``like``, on its device; a new copy."""
    compat = _compat()
    return compat.array_namespace(like).asarray(np.ascontiguousarray(array), device=compat.device(like), copy=True)


def type_of(array: Any) -> np.dtype:
    """NumPy's type of the numbers. Raises ``InputError`` where they are not float32 or float64."""
    name = str(array.dtype).rpartition(".")[2]
    if name not in ("float32", "float64"):
        raise InputError(f"points: float32 or float64 is needed on a device, received {name}")
    return np.dtype(name)


def _compat() -> Any:
    try:
        import array_api_compat
    except ImportError as error:
        raise InputError(
            "points: arrays of PyTorch and CuPy need the package array-api-compat: pip install 'nrsfm[gpu]'"
        ) from error
    return array_api_compat
