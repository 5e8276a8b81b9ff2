"""Who works on the shards of a pass: the threads of this process, or the workers of a cluster.

Sums are taken in the order of the shards, so that the same number of shards gives the same digits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

from nrsfm.numerics.threads import blas_threads, single_thread

T = TypeVar("T")


class Runner(Protocol):
    """Maps a function over shards."""

    workers: int
    shared: bool
    """Whether the workers see this process's memory."""

    def map(self, function: Callable[..., T], items: Sequence[Any]) -> Iterator[T]:
        """``function(item)`` of every item, in order."""
        ...


class Threads:
    """The threads that the linear-algebra library may use, each with a library of one thread of its own."""

    shared = True

    def __init__(self, workers: int | None = None) -> None:
        self.workers = blas_threads() if workers is None else workers

    def map(self, function: Callable[..., T], items: Sequence[Any]) -> Iterator[T]:
        """See :class:`Runner`."""
        with single_thread():
            if self.workers == 1 or len(items) == 1:
                yield from map(function, items)
                return
            with ThreadPoolExecutor(self.workers) as pool:
                yield from pool.map(function, items)
