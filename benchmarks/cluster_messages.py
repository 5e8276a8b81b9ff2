"""A cluster that counts: the real passes on workers that are only names, every message serialised and measured.

Stands in for a dask client below :class:`nrsfm.streaming.cluster.Cluster`, which does with it all that it does with a
real one. A value has a place; where a task takes one from elsewhere, that is a message.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from nrsfm.streaming.cluster import Cluster
from nrsfm.streaming.jobs import Job
from nrsfm.streaming.stream import Stream
from nrsfm.streaming.targets import Target

HERE = "caller"
DIRECTIONS = 10  # leading directions in which cells are found
PASSES = {"gram_of_shard": "first", "cells_of_shard": "second", "expand_shard": "third"}


@dataclass(frozen=True)
class Problem:
    """Frames, points, cells and workers of one thread each."""

    frames: int
    points: int
    cells: int
    workers: int


@dataclass
class Count:
    """Messages of one pass: bytes of each, by what they carry; ``depth``: moves one after the other, up to the sum."""

    messages: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    depth: int = 0

    def bytes_of(self, kind: str) -> int:
        """All messages of a kind."""
        return sum(self.messages[kind])


class Value:
    """What a task gave, and where it is; a future that is always done."""

    def __init__(self, client: Counting, where: str, content: Any, depth: int = 0) -> None:
        self.where, self.content, self.depth = where, content, depth
        self._client = client

    def result(self) -> Any:
        """Bring it to the caller."""
        self._client.moved(self, HERE)
        return self.content

    def release(self) -> None:
        """Forget it."""


class Counting:
    """The part of a dask client that a runner uses, over workers that are only names."""

    def __init__(self, workers: int) -> None:
        self._workers = [f"worker-{i:05d}" for i in range(workers)]
        self.counts: dict[str, Count] = {name: Count() for name in PASSES.values()}
        self._count = Count()

    def nthreads(self) -> dict[str, int]:
        """Threads of each worker."""
        return dict.fromkeys(self._workers, 1)

    def scatter(self, job: Job, **_: Any) -> Value:
        """To every worker: a pass begins."""
        self._count = self.counts[PASSES[job.name]]
        self._count.messages["job"] += [bytes_of(job)] * len(self._workers)
        return Value(self, "everywhere", job)

    def submit(self, function: Callable[..., Any], *arguments: Any, workers: list[str], **_: Any) -> Value:
        """Work at once; what is needed from elsewhere moves there first."""
        (where,) = workers
        depth = max((self.moved(a, where) for a in arguments if isinstance(a, Value)), default=0)
        plain = [a for a in arguments if not isinstance(a, Value)]
        if function.__name__ == "write_shard":
            self._count.messages["labels"].append(bytes_of(plain))
        made = function(*(a.content if isinstance(a, Value) else a for a in arguments))
        return Value(self, where, made, depth)

    def moved(self, value: Value, where: str) -> int:
        """Count the message, if there is one; returns how many moves lie behind the value then."""
        if value.where in (where, "everywhere"):
            return value.depth
        sums = isinstance(value.content, tuple)
        kind = "own" if not sums else "sum" if where != HERE else "whole"
        if (
            not isinstance(value.content, dict) or value.content
        ):  # the third pass has nothing to say where shapes go to a file
            self._count.messages[kind].append(bytes_of(value.content))
        depth = value.depth + 1
        if sums and where != HERE:
            self._count.depth = max(self._count.depth, depth)
        return depth


class Simulated(Cluster):
    """A cluster whose futures are always done."""

    def _wait(self, waiting: set[Any]) -> set[Any]:
        return set(waiting)


def bytes_of(value: Any) -> int:
    """Bytes of a message as ``distributed`` sends it."""
    from distributed.protocol import serialize_bytelist, to_serialize

    return sum(memoryview(frame).nbytes for frame in serialize_bytelist(to_serialize(value)))


def simulate(problem: Problem) -> tuple[dict[str, Count], int]:
    """All passes over random tracks of a deforming cloud, from a file and into one; the counts, and virtual points."""
    rng = np.random.default_rng(0)
    frames = problem.frames
    basis = rng.standard_normal((3, problem.points, 3))
    weights = rng.standard_normal((frames, 3)) * [1.0, 0.2, 0.1]
    views = rng.standard_normal((frames, 3, 2))
    tracks = np.einsum("fk,kpc,fcd->fpd", weights, basis, views, optimize=True).astype(np.float32)
    client = Counting(problem.workers)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tracks.npy"
        np.save(path, tracks)
        points = np.load(path, mmap_mode="r")
        target = Target(Path(folder) / "shapes.npy")
        stream = Stream(points, target, runner=Simulated(client), cells=problem.cells)
        measured = stream.measure(0)
        compressed = stream.compress(measured, noise=0.0, tolerance=1e-4)
        virtual = int(compressed.offsets[-1])
        stream.expand(compressed, rng.standard_normal((frames, 3, virtual)), np.dtype(np.float32), None)
    return client.counts, virtual


def formula(problem: Problem, virtual: int, sample: int) -> dict[str, dict[str, tuple[int, float]]]:
    """For each pass what its messages carry: how many there are, and the bytes of each on average."""
    f, p, k, n = problem.frames, problem.points, problem.cells, problem.workers
    shards = 4 * n
    gram = 8 * (2 * f + (2 * f) ** 2)
    cells = 8 * k * (1 + 2 * f + (2 * f) ** 2)
    return {
        "first": {
            "job": (n, 8 * sample + 16 * f),
            "own": (shards, 8 * f * sample / shards),
            "sum": (n - 1, gram),
            "whole": (1, gram),
        },
        "second": {
            "job": (n, 8 * DIRECTIONS * (2 * f + k) + 16 * f),
            "own": (shards, p / shards),
            "sum": (n - 1, cells),
            "whole": (1, cells),
        },
        "third": {"job": (n, 8 * virtual * (3 * f + 2 * f) + 16 * f), "labels": (shards, p / shards)},
    }
