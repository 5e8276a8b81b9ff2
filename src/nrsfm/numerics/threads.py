"""Control of the linear-algebra library's threads.

Small eigenproblems under a multi-threaded BLAS can run several times slower than on one thread, so the
iterations run on one; passes over all points use every thread that the caller allows.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from typing import Any


@cache
def _controller() -> Any:
    # Looking up the loaded libraries costs milliseconds; once per process is enough. SciPy brings a BLAS of its own,
    # which the controller holds only if it is loaded by now.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextlib.contextmanager
def single_thread() -> Iterator[None]:
    """Run the body with one BLAS thread; the setting before is restored after it."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


def blas_threads() -> int:
    """Threads that the linear-algebra library uses at the moment; at least 1."""
    found = [int(library["num_threads"]) for library in _controller().info() if library["user_api"] == "blas"]
    return max(found, default=1)
