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
import math
import os
import pickle
import platform
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError, NrsfmError, OptionError
from nrsfm.streaming.plan import Plan
from nrsfm.streaming.readers import ArrayReader, MapReader, StoredReader
from nrsfm.streaming.runners import Runner, Shard, Sums, Tell, Threads, sums_of
from nrsfm.streaming.sending import anywhere
from nrsfm.streaming.targets import ArrayWriter, FileWriter, Writer, ZarrWriter

LARGEST = 512 * 2**20
"""Bytes of tracks in memory that are sent to workers; larger ones must be in a file."""

GROUP = 4
"""Neighbouring shards that are added one after the other, on one worker; also the shards of a worker's thread."""

_FEWEST = 64  # points of a block
_CONNECTING = 5.0  # seconds until an address that does not answer is given up
_WAITING = 30.0  # seconds without any worker until a run is given up
_TICK = 2.0  # seconds between two looks at whether there are workers
_ROUNDS = 3  # times that a pass is begun where what was sent to all workers is lost with the last of them
_TRIES = 3  # times that a worker reads or writes before it reports a failure
_QUIET = {"distributed.admin.large-graph-warning-threshold": "10GB"}  # labels go with the tasks: they must not get lost


class ClusterError(NrsfmError, RuntimeError):
    """A cluster cannot be reached, has no workers, or its workers cannot do what they are asked for."""


class Address(str):
    """Where a cluster is, with the client or executor that the caller gave; a plain word to all who only record it."""

    given: Any

    def __new__(cls, address: str, given: Any = None) -> Address:
        """An address, and the object whose it is."""
        found = super().__new__(cls, address)
        found.given = given
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)


def addressed(value: Any) -> Any:
    """The option ``cluster`` as a word: an address, the address of a client, or the kind of an executor.

    Raises ``OptionError`` for anything else, and for a client that is closed.
    """
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, futures.Executor):
        return Address(f"executor:{type(value).__name__}", value)
    if type(value).__module__.partition(".")[0] == "distributed" and hasattr(value, "scheduler"):
        if getattr(value, "asynchronous", False):
            raise OptionError("option 'cluster': an asynchronous client cannot be used; give its address")
        if value.status != "running" or value.scheduler is None:
            raise OptionError(f"option 'cluster': the client must be running, received one that is {value.status}")
        return Address(value.scheduler.address, value)
    raise OptionError(
        "option 'cluster' must be an address such as tcp://host:8786, a dask.distributed Client or a "
        f"concurrent.futures.Executor, received {type(value).__name__}"
    )


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


@contextlib.contextmanager
def connected(cluster: str) -> Iterator[Any]:
    """A client of a cluster that has workers like this process: the caller's own, or one that is closed at the end."""
    given = getattr(cluster, "given", None)
    if given is not None:
        _require_workers(given)
        yield given
        return
    distributed = import_distributed()
    try:
        _knock(str(cluster))
        client = distributed.Client(str(cluster), timeout=_CONNECTING, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # a timeout is an OSError
        raise ClusterError(
            f"cluster: no scheduler answers at '{cluster}' within {_CONNECTING:g} s (is it a dask scheduler's address, "
            "such as tcp://host:8786?)"
        ) from error
    try:
        _require_workers(client)
        yield client
    finally:
        client.close()


def _knock(address: str) -> None:
    """Raise ``OSError`` or ``ValueError`` where nobody listens, or nobody can, at the address of a scheduler.

    A client that fails to connect leaves threads behind, and is taken down at a bad time when it is collected.
    """
    from distributed.comm.addressing import get_address_host_port

    place: tuple[str, int] = get_address_host_port(address)
    socket.create_connection(place, timeout=_CONNECTING).close()


def import_distributed() -> Any:
    """Return dask's ``distributed``. Raises ``OptionError`` where it is not installed."""
    try:
        import distributed
    except ImportError as error:
        raise OptionError("option 'cluster' needs the package distributed: pip install 'nrsfm[cluster]'") from error
    return distributed


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
                kept[self._submit(where, _attribute, part, own)] = number
                total = self._submit(where, _first if total is None else _next, *_given(total), part, summed)
            level.append((where, total))
        while len(level) > 1:
            pairs = [level[i : i + 2] for i in range(0, len(level), 2)]
            level = [
                pair[0] if len(pair) == 1 else (pair[0][0], self._submit(pair[0][0], _plus, pair[0][1], pair[1][1]))
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
        _require_sendable(work)
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
            self.client.wait_for_workers(1, timeout=_WAITING)
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
                elif time.monotonic() - since > _WAITING:
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
            total = _first(part, tuple(summed)) if total is None else _next(total, part, tuple(summed))
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
        _require_sendable(work)
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
    return ClusterError(f"cluster: no worker is left, and none came within {_WAITING:g} s")


@dataclass(frozen=True)
class Job:
    """What all shards of a pass have in common; sent to every worker once."""

    work: Callable[..., Any]

    @property
    def name(self) -> str:
        """The pass in one word."""
        return str(getattr(getattr(self.work, "func", self.work), "__name__", "shard"))


def run_shard(job: Job, shard: Shard) -> Any:
    """On a worker: one shard of a pass that sums up."""
    return _tried(lambda: job.work(None, shard), shard)


def write_shard(
    job: Job, labels: np.ndarray, writers: Mapping[str, Writer | _Wanted], shard: Shard
) -> dict[str, np.ndarray]:
    """On a worker: one shard of the pass that writes; what goes to memory is returned."""
    made = {
        name: Window(np.empty((writer.frames, shard[1] - shard[0], *writer.rest), writer.dtype), shard[0])
        for name, writer in writers.items()
        if isinstance(writer, _Wanted)
    }
    window = Window(labels[None], shard[0])
    _tried(lambda: job.work(labels=window, writers={**writers, **made}, told=None, shard=shard), shard)
    return {name: block.array for name, block in made.items()}


@dataclass(frozen=True)
class _Wanted:
    """An array that is wanted in the caller's memory: (F, P, ...)."""

    frames: int
    rest: tuple[int, ...]
    dtype: np.dtype


@dataclass(frozen=True)
class Window:
    """Points from ``start`` of an array (F, P, ...), spoken of by their place in it; a writer, and labels by slices."""

    array: np.ndarray
    start: int

    def __getitem__(self, points: slice) -> np.ndarray:
        return self.array[0, points.start - self.start : points.stop - self.start]

    def room(self, start: int, count: int) -> np.ndarray:
        """See :class:`nrsfm.streaming.targets.Writer`."""
        return ArrayWriter(self.array).room(start - self.start, count)

    def write(self, start: int, block: np.ndarray) -> None:
        """See :class:`nrsfm.streaming.targets.Writer`."""
        ArrayWriter(self.array).write(start - self.start, block)


def sendable(writers: Mapping[str, Writer]) -> dict[str, Writer | _Wanted]:
    """Writers as they go to workers: files by their whole path, arrays in memory as what is wanted."""
    found: dict[str, Writer | _Wanted] = {}
    for name, writer in writers.items():
        if isinstance(writer, ArrayWriter):
            found[name] = _Wanted(writer.array.shape[0], writer.array.shape[2:], writer.array.dtype)
        elif isinstance(writer, FileWriter):
            found[name] = replace(writer, path=os.path.abspath(writer.path))
        elif isinstance(writer, ZarrWriter):
            found[name] = replace(writer, array=anywhere(writer.array))
        else:
            found[name] = writer
    return found


def received(writers: Mapping[str, Writer], shard: Shard, blocks: Mapping[str, np.ndarray]) -> None:
    """Put what came back into its place."""
    for name, block in blocks.items():
        writers[name].write(shard[0], block)


def groups(shards: int) -> list[range]:
    """The numbers of the shards, in neighbourhoods."""
    return [range(first, min(first + GROUP, shards)) for first in range(0, shards, GROUP)]


def depth(shards: int) -> int:
    """Additions that follow one another until the sum of all shards is there."""
    return min(GROUP, shards) - 1 + math.ceil(math.log2(max(1, len(groups(shards)))))


def _attribute(part: Any, name: str) -> Any:
    return getattr(part, name)


def _first(part: Any, summed: tuple[str, ...]) -> Sums:
    return sums_of(part, summed)


def _next(total: Sums, part: Any, summed: tuple[str, ...]) -> Sums:
    return _plus(total, sums_of(part, summed))


def _plus(one: Sums, other: Sums) -> Sums:
    """A new sum: what a worker holds may be asked for again."""
    return tuple(a + b for a, b in zip(one, other, strict=True))


def _given(value: Any) -> tuple[Any, ...]:
    return () if value is None else (value,)


def _tell(told: Tell | None, shard: Shard) -> None:
    if told is not None:
        told(shard[1] - shard[0])


def _tried(work: Callable[[], Any], shard: Shard) -> Any:
    """Work with a linear algebra of one thread; what a file system refuses is tried again before it counts."""
    for last in range(_TRIES - 1, -1, -1):
        try:
            with _SINGLE, np.errstate(over="ignore", invalid="ignore"):  # what is not finite the caller finds
                return work()
        except OSError as error:
            if not last:
                where = f"points {shard[0]} to {shard[1]} on {platform.node()}"
                raise FileError(f"cluster: cannot read or write {where}: {error}") from error
            time.sleep(0.1)
    return None


class _SingleThread:
    """The linear algebra of this process on one thread while any thread is inside: the first sets it, the last undoes.

    Each thread with a limit of its own would undo that of another.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limit = contextlib.ExitStack()

    def __enter__(self) -> None:
        from nrsfm.numerics.threads import single_thread

        with self._lock:
            if self._inside == 0:
                self._limit.enter_context(single_thread())
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limit.close()


_SINGLE = _SingleThread()


@contextlib.contextmanager
def _configured() -> Iterator[None]:
    import dask

    with dask.config.set(_QUIET):
        yield


def _require_sendable(work: Callable[..., Any]) -> None:
    """Refuse to send large tracks, and what cannot be opened elsewhere."""
    for argument in getattr(work, "args", ()):
        if isinstance(argument, ArrayReader) and argument.points.nbytes > LARGEST:
            raise InputError(
                f"points: {argument.points.nbytes / 1e9:.2g} GB in memory are too much to be sent to workers: save "
                "them (numpy.save), and give numpy.load(file, mmap_mode='r')"
            )
        if isinstance(argument, MapReader | StoredReader):
            pickle.dumps(argument)  # says at once what lies in no file


def facts() -> dict[str, str]:
    """What must be the same on every worker."""
    import nrsfm

    python = ".".join(platform.python_version_tuple()[:2])
    return {"nrsfm": nrsfm.__version__, "Python": python, "NumPy": np.__version__}


def _require_workers(client: Any) -> None:
    """Raise ``ClusterError`` where there are no workers for a while, or not like this process."""
    try:
        client.wait_for_workers(1, timeout=_WAITING)
    except TimeoutError as error:
        raise ClusterError(
            f"cluster: the scheduler has no workers, and none came within {_WAITING:g} s: start some with 'dask worker "
            f"{client.scheduler.address}'"
        ) from error
    own = facts()
    for address, theirs in _asked(client, facts).items():
        if isinstance(theirs, Exception):
            raise ClusterError(f"cluster: {address} cannot load nrsfm {own['nrsfm']}: {theirs}") from theirs
        for name, version in own.items():
            if theirs[name] != version:
                raise ClusterError(
                    f"cluster: every worker needs {name} {version}, as here; {address} has {theirs[name]}"
                )


def _asked(client: Any, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
    """What each worker answers, or the exception; a worker that is lost meanwhile does not count."""
    found = client.run(function, *arguments, on_error="return")
    return {address: answer for address, answer in found.items() if not isinstance(answer, OSError)}


def require_seen(client: Any, path: str | Path) -> None:
    """Raise ``FileError`` where a worker does not see a file or folder under the same path."""
    whole = os.path.abspath(path)
    for address, seen in _asked(client, os.path.exists, whole).items():
        if not seen:
            raise FileError(f"cluster: the worker {address} does not see '{whole}': every host needs the same path")
