"""What workers are given, and what they do with it: one shard of a pass, and sums of what several shards gave."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import platform
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.numerics.threads import single_thread
from nrsfm.streaming.readers import ArrayReader, MapReader, StoredReader
from nrsfm.streaming.runners import Shard, Sums, sums_of
from nrsfm.streaming.sending import anywhere
from nrsfm.streaming.targets import ArrayWriter, FileWriter, Writer, ZarrWriter

LARGEST = 512 * 2**20
"""Bytes of tracks in memory that are sent to workers; larger ones must be in a file."""

GROUP = 4
"""Neighbouring shards that are added one after the other, on one worker; also the shards of a worker's thread."""

_TRIES = 3  # times that a worker reads or writes before it reports a failure


@dataclass(frozen=True)
class Job:
    """What all shards of a pass have in common; sent to every worker once."""

    work: Callable[..., Any]

    @property
    def name(self) -> str:
        """The pass in one word."""
        return str(getattr(getattr(self.work, "func", self.work), "__name__", "shard"))


def require_sendable(work: Callable[..., Any]) -> None:
    """Refuse to send large tracks, and what cannot be opened elsewhere."""
    for argument in getattr(work, "args", ()):
        if isinstance(argument, ArrayReader) and argument.points.nbytes > LARGEST:
            raise InputError(
                f"points: {argument.points.nbytes / 1e9:.2g} GB in memory are too much to be sent to workers: save "
                "them (numpy.save), and give numpy.load(file, mmap_mode='r')"
            )
        if isinstance(argument, MapReader | StoredReader):
            pickle.dumps(argument)  # says at once what lies in no file


def run_shard(job: Job, shard: Shard) -> Any:
    """On a worker: one shard of a pass that sums up."""
    return _tried(lambda: job.work(None, shard), shard)


def write_shard(
    job: Job, labels: np.ndarray, writers: Mapping[str, Writer | Wanted], shard: Shard
) -> dict[str, np.ndarray]:
    """On a worker: one shard of the pass that writes; what goes to memory is returned."""
    made = {
        name: Window(np.empty((writer.frames, shard[1] - shard[0], *writer.rest), writer.dtype), shard[0])
        for name, writer in writers.items()
        if isinstance(writer, Wanted)
    }
    window = Window(labels[None], shard[0])
    _tried(lambda: job.work(labels=window, writers={**writers, **made}, told=None, shard=shard), shard)
    return {name: block.array for name, block in made.items()}


@dataclass(frozen=True)
class Wanted:
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


def sendable(writers: Mapping[str, Writer]) -> dict[str, Writer | Wanted]:
    """Writers as they go to workers: files by their whole path, arrays in memory as what is wanted."""
    found: dict[str, Writer | Wanted] = {}
    for name, writer in writers.items():
        if isinstance(writer, ArrayWriter):
            found[name] = Wanted(writer.array.shape[0], writer.array.shape[2:], writer.array.dtype)
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


def attribute(part: Any, name: str) -> Any:
    """What a shard gave under that name."""
    return getattr(part, name)


def first(part: Any, summed: tuple[str, ...]) -> Sums:
    """The beginning of a sum: what one shard gave."""
    return sums_of(part, summed)


def following(total: Sums, part: Any, summed: tuple[str, ...]) -> Sums:
    """The sum with what another shard gave."""
    return plus(total, sums_of(part, summed))


def plus(one: Sums, other: Sums) -> Sums:
    """A new sum: what a worker holds may be asked for again."""
    return tuple(a + b for a, b in zip(one, other, strict=True))


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
