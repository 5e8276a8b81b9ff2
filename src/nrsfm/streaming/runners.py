"""Who works on the shards of a pass: the threads of this process, or others (:mod:`nrsfm.streaming.cluster`).

Sums are taken in the order of the shards, so that the same number of shards gives the same digits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from nrsfm.numerics.threads import blas_threads, side_by_side
from nrsfm.streaming.plan import Plan
from nrsfm.streaming.targets import Writer

T = TypeVar("T")
Shard = tuple[int, int]
Tell = Callable[[int], None]
"""Told how many points more are done."""

Sums = tuple[np.ndarray, ...]


class Runner(Protocol):
    """Works on the shards of a pass.

    ``work`` is a function of :mod:`nrsfm.streaming.passes` whose first arguments are given. What it is sent with can be
    pickled, but for ``told`` and the writers, which stay with the caller where a runner says so. A shard may be worked
    on twice: it gives, and writes, the same.
    """

    workers: int
    """Shards that are worked on at the same time within one memory."""

    @property
    def here(self) -> Threads:
        """For small work on what this process holds."""
        ...

    def planned(self, walk: Plan, count: int) -> Plan:
        """The plan for ``count`` points with as many shards as the runner wants."""
        ...

    def sums(
        self, work: Callable[..., Any], shards: Sequence[Shard], own: str, summed: Sequence[str], told: Tell | None
    ) -> tuple[list[Any], Sums]:
        """``work(told, shard)`` of every shard: its attribute ``own``, in order, and sums of those in ``summed``."""
        ...

    def write(
        self,
        work: Callable[..., Any],
        shards: Sequence[Shard],
        labels: np.ndarray,
        writers: Mapping[str, Writer],
        told: Tell | None,
    ) -> None:
        """``work(labels=, writers=, told=, shard=)`` of every shard."""
        ...


class Threads:
    """The threads that the linear-algebra library may use, each with a library of one thread of its own."""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = blas_threads() if workers is None else workers

    @property
    def here(self) -> Threads:
        """See :class:`Runner`."""
        return self

    def planned(self, walk: Plan, count: int) -> Plan:
        """See :class:`Runner`; one shard a thread."""
        return walk

    def map(self, function: Callable[..., T], items: Sequence[Any]) -> Iterator[T]:
        """``function(item)`` of every item, in order."""
        return side_by_side(function, items, self.workers)

    def sums(
        self, work: Callable[..., Any], shards: Sequence[Shard], own: str, summed: Sequence[str], told: Tell | None
    ) -> tuple[list[Any], Sums]:
        """See :class:`Runner`."""
        kept, total = [], None
        for part in self.map(lambda shard: work(told, shard), shards):
            kept.append(getattr(part, own))
            total = added(total, sums_of(part, summed))
        return kept, total or ()

    def write(
        self,
        work: Callable[..., Any],
        shards: Sequence[Shard],
        labels: np.ndarray,
        writers: Mapping[str, Writer],
        told: Tell | None,
    ) -> None:
        """See :class:`Runner`."""
        for _ in self.map(lambda shard: work(labels=labels, writers=writers, told=told, shard=shard), shards):
            pass


def sums_of(part: Any, summed: Sequence[str]) -> Sums:
    """The attributes of these names."""
    return tuple(getattr(part, name) for name in summed)


def added(total: Sums | None, other: Sums) -> Sums:
    """Sums of both; those of ``total`` change in place."""
    if total is None:
        return other
    for whole, part in zip(total, other, strict=True):
        whole += part
    return total
