"""The passes over the points on a cluster of ``dask.distributed``, or on any executor of ``concurrent.futures``.

Workers read the tracks' file by its path, and write shapes in place into the new file; only descriptions go to them,
and only what does not grow with the points comes back, but for labels, and for shapes that are wanted in memory.

Sums of Gram matrices are large (K (2F)² numbers of a shard). They are added on the workers: four neighbouring shards
one after the other, on one worker; then neighbours in pairs, level by level. So a worker sends its sum to one other at
most, and the caller receives one.

Which worker does what changes nothing: the order of every sum follows from the number of shards, and a shard that is
worked on again gives, and writes, the same bytes.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.streaming import connecting
from nrsfm.streaming.connecting import ClusterError, connected, import_distributed
from nrsfm.streaming.jobs import (
    GROUP,
    Job,
    attribute,
    first,
    following,
    groups,
    plus,
    received,
    require_sendable,
    run_shard,
    sendable,
    write_shard,
)
from nrsfm.streaming.plan import Plan
from nrsfm.streaming.runners import Runner, Shard, Sums, Tell, Threads
from nrsfm.streaming.targets import Writer

_FEWEST = 64  # points of a block
_TICK = 2.0  # seconds between two looks at whether there are workers
_ROUNDS = 3  # times that a pass is begun where what was sent to all workers is lost with the last of them
_QUIET = {"distributed.admin.large-graph-warning-threshold": "10GB"}  # labels go with the tasks: they must not get lost


@contextlib.contextmanager
def runner_of(cluster: str | None) -> Iterator[Runner]:
    """Who works for the option ``cluster``; a client that was made for an address is closed at the end.

    Raises ``ClusterError`` where the cluster does not answer, has no workers, or these differ from this process.
    """
    if cluster is None:
        yield Threads()
        return
    given = getattr(cluster, "given", None)
    if isinstance(given, futures.Executor):
        yield Pool(given)
        return
    with connected(cluster) as client:
        yield Cluster(client)


class _OverProcesses:
    """What runners whose workers do not see this process's memory have in common."""

    workers: int

    def __init__(self) -> None:
        self._threads = Threads()

    @property
    def here(self) -> Threads:
        """See :class:`Runner`."""
        return self._threads

    def planned(self, walk: Plan, count: int) -> Plan:
        """See :class:`Runner`; ``GROUP`` shards for each thread of a worker, so that little is done twice."""
        if walk.threads < self.workers:
            raise InputError(
                f"memory: a worker with {self.workers} threads needs more for the Gram matrices of as many shards: "
                f"start workers with {walk.threads} threads or raise memory"
            )
        shards = GROUP * self._slots()
        block = max(min(walk.block, -(-count // shards)), min(_FEWEST, count))
        return Plan(block, min(walk.part, block), shards)

    def _slots(self) -> int:
        """Shards that all workers can work on at the same time."""
        raise NotImplementedError


class Cluster(_OverProcesses):
    """The workers of a cluster, as a client sees them."""

    def __init__(self, client: Any) -> None:
        super().__init__()
        self.client = client
        self.threads: dict[str, int] = dict(sorted(client.nthreads().items()))
        self.workers = max(self.threads.values())

    def _slots(self) -> int:
        return sum(self.threads.values())

    def sums(
        self, work: Callable[..., Any], shards: Sequence[Shard], own: str, summed: Sequence[str], told: Tell | None
    ) -> tuple[list[Any], Sums]:
        """See :class:`Runner`."""
        name = Job(work).name

        def once(job: Any, tell: Tell | None) -> tuple[list[Any], Sums]:
            kept, root = self._tree(job, name, shards, own, tuple(summed))
            found: list[Any] = [None] * len(shards)
            for future in self.finished(kept):
                found[kept[future]] = future.result()
                _tell(tell, shards[kept[future]])
            for _ in self.finished([root]):
                pass
            return found, root.result()

        return self._again(work, once, told)

    def _tree(
        self, job: Any, name: str, shards: Sequence[Shard], own: str, summed: tuple[str, ...]
    ) -> tuple[dict[Any, int], Any]:
        """What each shard keeps, by its number, and the sum of all."""
        kept: dict[Any, int] = {}
        level = []
        for group, where in zip(groups(len(shards)), self._places(len(shards)), strict=True):
            total = None
            for number in group:
                part = self._submit(where, run_shard, job, shards[number], name=f"{name}-{number}")
                kept[self._submit(where, attribute, part, own)] = number
                total = self._submit(where, first if total is None else following, *_given(total), part, summed)
            level.append((where, total))
        while len(level) > 1:
            pairs = [level[i : i + 2] for i in range(0, len(level), 2)]
            level = [
                pair[0] if len(pair) == 1 else (pair[0][0], self._submit(pair[0][0], plus, pair[0][1], pair[1][1]))
                for pair in pairs
            ]
        return kept, level[0][1]

    def write(
        self,
        work: Callable[..., Any],
        shards: Sequence[Shard],
        labels: np.ndarray,
        writers: Mapping[str, Writer],
        told: Tell | None,
    ) -> None:
        """See :class:`Runner`; what is wanted in memory comes back in blocks."""
        there, name = sendable(writers), Job(work).name

        def once(job: Any, tell: Tell | None) -> None:
            made: dict[Any, Shard] = {}
            for group, where in zip(groups(len(shards)), self._places(len(shards)), strict=True):
                for number in group:
                    own = labels[slice(*shards[number])], there, shards[number]
                    made[self._submit(where, write_shard, job, *own, name=f"{name}-{number}")] = shards[number]
            for future in self.finished(made):
                received(writers, made[future], future.result())
                _tell(tell, made[future])
                future.release()

        self._again(work, once, told)

    def _places(self, count: int) -> list[str]:
        """The worker that each group of shards should go to, neighbours to the same: what is added there stays there.

        Only a wish: where a worker is lost or late, others take over.
        """
        slots = [address for address, threads in self.threads.items() for _ in range(threads)]
        number = len(groups(count))
        return [slots[i * len(slots) // number] for i in range(number)]

    def _submit(self, where: str, function: Callable[..., Any], *arguments: Any, name: str | None = None) -> Any:
        key = None if name is None else f"{name}-{os.urandom(4).hex()}"
        return self.client.submit(function, *arguments, key=key, workers=[where], allow_other_workers=True, pure=False)

    def _again(self, work: Callable[..., Any], once: Callable[[Any, Tell | None], Any], told: Tell | None) -> Any:
        """A pass with its work sent to all workers; begun anew where that is lost with all who held it."""
        distributed = import_distributed()
        require_sendable(work)
        for last in range(_ROUNDS - 1, -1, -1):
            try:
                with _configured():
                    return once(self.client.scatter(Job(work), broadcast=True, hash=False), told)
            except distributed.scheduler.KilledWorker as error:
                raise ClusterError(
                    "cluster: every worker that worked on a shard died; give workers fewer threads or more memory"
                ) from error
            except (futures.CancelledError, distributed.client.CancelledError) as error:
                if not last:
                    raise ClusterError("cluster: all workers were lost, again and again") from error
                told = None  # what was told stays told
                self._wait_for_any()
            except OSError as error:
                raise ClusterError(f"cluster: the scheduler was lost: {error}") from error
        return None

    def _wait_for_any(self) -> None:
        try:
            self.client.wait_for_workers(1, timeout=connecting.WAITING)
        except TimeoutError as error:
            raise _nobody() from error

    def finished(self, made: Iterable[Any]) -> Iterator[Any]:
        """Futures as they are done. Raises ``ClusterError`` where no worker is left for a while."""
        waiting, since = set(made), time.monotonic()
        while waiting:
            try:
                done = self._wait(waiting)
            except TimeoutError:
                if self.client.nthreads():
                    since = time.monotonic()
                elif time.monotonic() - since > connecting.WAITING:
                    raise _nobody() from None
                continue
            since = time.monotonic()
            waiting -= done
            yield from done

    def _wait(self, waiting: set[Any]) -> set[Any]:
        """Those of the futures that are done, at least one. Raises ``TimeoutError`` where none is for a while."""
        wait: Any = import_distributed().wait
        with self.client.as_current():  # else the process's default client is asked, if it has one
            return set(wait(waiting, timeout=_TICK, return_when="FIRST_COMPLETED").done)


class Pool(_OverProcesses):
    """The workers of an executor: processes, or hosts of an MPI or batch system, that see the same files.

    An executor cannot be asked about its workers; each shard finds out whether it can read the file. Sums are added
    here, in the order of the shards: no worker sees another's. A lost process is an error: executors do not begin anew.
    """

    def __init__(self, executor: futures.Executor) -> None:
        super().__init__()
        self._executor = executor
        self._processes = int(getattr(executor, "_max_workers", 0) or os.cpu_count() or 1)
        self.workers = self._processes if isinstance(executor, futures.ThreadPoolExecutor) else 1

    def _slots(self) -> int:
        return self._processes

    def sums(
        self, work: Callable[..., Any], shards: Sequence[Shard], own: str, summed: Sequence[str], told: Tell | None
    ) -> tuple[list[Any], Sums]:
        """See :class:`Runner`."""
        kept, total = [], None
        for shard, part in zip(shards, self._each(work, run_shard, [(shard,) for shard in shards]), strict=True):
            kept.append(getattr(part, own))
            total = first(part, tuple(summed)) if total is None else following(total, part, tuple(summed))
            _tell(told, shard)
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
        there = sendable(writers)
        jobs = [(labels[slice(*shard)], there, shard) for shard in shards]
        for shard, blocks in zip(shards, self._each(work, write_shard, jobs), strict=True):
            received(writers, shard, blocks)
            _tell(told, shard)

    def _each(
        self, work: Callable[..., Any], function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]
    ) -> Iterator[Any]:
        """In order; as many are under way as there are workers and as many again, so that few results wait here."""
        require_sendable(work)
        job = Job(work)
        waiting: list[futures.Future[Any]] = []
        try:
            for arguments in jobs:
                waiting.append(self._executor.submit(function, job, *arguments))
                if len(waiting) >= 2 * self._processes:
                    yield waiting.pop(0).result()
            while waiting:
                yield waiting.pop(0).result()
        except futures.BrokenExecutor as error:
            raise ClusterError(f"cluster: the executor lost a worker: {error}") from error
        finally:
            for future in waiting:
                future.cancel()


def _nobody() -> ClusterError:
    return ClusterError(f"cluster: no worker is left, and none came within {connecting.WAITING:g} s")


def _given(value: Any) -> tuple[Any, ...]:
    return () if value is None else (value,)


def _tell(told: Tell | None, shard: Shard) -> None:
    if told is not None:
        told(shard[1] - shard[0])


@contextlib.contextmanager
def _configured() -> Iterator[None]:
    import dask

    with dask.config.set(_QUIET):
        yield
