"""Thread control: one thread inside, what was before after it, also when the body fails."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from nrsfm.numerics.threads import single_thread


def blas_threads():
    np.eye(2) @ np.eye(2)
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_one_thread_inside_and_the_old_number_after():
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with single_thread():
            assert set(blas_threads()) == {1}
        assert blas_threads() == before


def test_restored_after_an_error():
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with pytest.raises(KeyError), single_thread():
            raise KeyError
        assert blas_threads() == before
