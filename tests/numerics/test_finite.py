"""One product tells whether all is finite, and where it cannot the numbers do."""

import numpy as np
import pytest

from nrsfm.numerics.finite import all_finite


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16, np.int64])
@pytest.mark.parametrize("layout", [np.ascontiguousarray, np.asfortranarray, lambda a: a[::2, ::-1]])
def test_all_finite(dtype, layout):
    array = layout((np.arange(42).reshape(6, 7) - 20).astype(dtype))
    assert all_finite(array)
    if np.dtype(dtype).kind != "f":
        return
    for bad in (np.nan, np.inf, -np.inf):
        other = array.copy(order="K")
        other[1, 2] = bad
        assert not all_finite(other)
    large = np.full_like(array, np.finfo(dtype).max)
    assert all_finite(large), "squares overflow, the numbers do not"


def test_nothing_and_read_only():
    assert all_finite(np.empty((0, 3)))
    array = np.ones(5, dtype=np.float32)
    array.flags.writeable = False
    assert all_finite(array)
