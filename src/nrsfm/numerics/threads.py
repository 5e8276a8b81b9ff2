"""Control of the linear-algebra library's threads.

Small eigenproblems under a multi-threaded BLAS can run several times slower than on one thread, so the
iterations run on one; passes over all points use every thread that the caller allows, several parts of the points side
by side, each on one thread.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")


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


def side_by_side(function: Callable[..., T], items: Sequence[Any], workers: int | None = None) -> Iterator[T]:
    """``function(item)`` of every item, in order, so many at a time, each with a library of one thread.

    Default: as many as the library may use where this is called, one inside :func:`single_thread`.
    """
    if workers is None:
        workers = blas_threads()
    with single_thread():
        if workers == 1 or len(items) <= 1:
            yield from map(function, items)
            return
        with ThreadPoolExecutor(min(workers, len(items))) as pool:
            yield from pool.map(function, items)
