"""Compute cells in parallel processes: kept as soon as they are finished, killed where they pass a limit.

Each process (:mod:`nrsfm.experiments.worker`) has its share of the cores, takes one cell after another, and changes
its data when there are no more cells of them. The cameras of the intersection method are estimated once for the data
that need them.
"""

from __future__ import annotations

import collections
import dataclasses
import selectors
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.experiments import sequences
from nrsfm.experiments.base import Cell, Data, Record
from nrsfm.experiments.kept import Store
from nrsfm.experiments.process import Process, cores

_TICK = 0.2  # seconds between two looks at the limits
_LOADING = 300.0  # seconds that a process may take to start and to load its data


@dataclasses.dataclass(frozen=True)
class Limits:
    """What one cell may take: seconds, and bytes that its process holds."""

    seconds: float = 600.0
    memory: float = 12e9


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is; ``left`` are seconds, ``None`` while nothing is known. ``finished`` is the latest cell."""

    done: int
    total: int
    failed: int
    left: float | None
    running: tuple[str, ...]
    finished: Cell | None = None
    record: Record | None = None


Tell = Callable[[Progress], None]


def run_cells(
    cells: Iterable[Cell],
    store: Store,
    root: Path | None,
    *,
    jobs: int | None = None,
    threads: int | None = None,
    limits: Limits | None = None,
    tell: Tell = lambda progress: None,
    cluster: str | None = None,
) -> dict[str, Record]:
    """Return the record of every cell by its key; what is kept is not computed again.

    ``jobs``: processes (default: one a core), each with an equal share of the cores as threads; cells that have to
    run alone run one by one, after the others, with all cores. ``threads`` of each, if not that share. ``cluster``: the
    address of a dask scheduler whose workers take the place of the processes; what has to run alone still runs here.
    Interrupted in any way, what is finished stays kept.

    Raises ``ClusterError`` where a cluster cannot be reached or has no workers.
    """
    wanted = list({cell.key: cell for cell in cells}.values())
    found: dict[str, Record] = {}
    missing: list[Cell] = []
    for cell in wanted:
        record = store.read(cell)
        if record is None:
            missing.append(cell)
        else:
            found[cell.key] = record
    together = [cell for cell in missing if not cell.alone]
    alone = [cell for cell in missing if cell.alone]
    clock = Clock(len(wanted), found, missing, root, tell)
    limits = limits or Limits()
    if cluster is not None and together:
        from nrsfm.experiments.remote import Sweep
        from nrsfm.streaming.connecting import connected

        with connected(cluster) as client:
            Sweep(together, store, root, client, limits, clock).run()
        together = []
    for some, processes in ((together, jobs or cores()), (alone, 1)):
        if some:
            _Pool(some, store, root, processes, threads or max(1, cores() // processes), limits, clock).run()
    return {cell.key: clock.records[cell.key] for cell in wanted}


class Clock:
    """Counts what is finished and says how long the rest may take."""

    def __init__(
        self, total: int, found: dict[str, Record], missing: list[Cell], root: Path | None, tell: Tell
    ) -> None:
        self.records = dict(found)
        self._total, self._tell = total, tell
        self._weights = {cell.key: weight(cell, root) for cell in missing}
        self._left = sum(self._weights.values())
        self._done = 0.0
        self._start = time.perf_counter()
        self.running: tuple[str, ...] = ()
        self.tell()

    def finish(self, cell: Cell, record: Record) -> None:
        """A cell has its record."""
        self.records[cell.key] = record
        self._done += self._weights[cell.key]
        self._left -= self._weights[cell.key]
        self.tell(cell, record)

    def tell(self, cell: Cell | None = None, record: Record | None = None) -> None:
        """Say how far the run is."""
        passed = time.perf_counter() - self._start
        left = passed / self._done * self._left if self._done else None
        failed = sum("error" in kept for kept in self.records.values())
        self._tell(Progress(len(self.records), self._total, failed, left, self.running, cell, record))


def weight(cell: Cell, root: Path | None) -> float:
    """About how long a cell takes beside others."""
    frames, points = sequences.size(cell.data, root)
    return 1.0 + frames * points**0.5 / 1000.0


class _Pool:
    """The processes of one run and what is left for them to do."""

    def __init__(
        self,
        cells: list[Cell],
        store: Store,
        root: Path | None,
        processes: int,
        threads: int,
        limits: Limits,
        clock: Clock,
    ) -> None:
        self._store, self._root, self._limits, self._clock = store, root, limits, clock
        self._processes, self._threads = processes, threads
        self._waiting: dict[Data, collections.deque[Cell]] = {}
        # The longest first, so that all processes end at about the same time.
        for cell in sorted(cells, key=lambda cell: -weight(cell, root)):
            self._waiting.setdefault(cell.data, collections.deque()).append(cell)
        self._cameras = {d: readable(store.cameras_path(d)) for d in self._waiting if self._needs_cameras(d)}
        self._workers: list[Process] = []
        self._selector = selectors.DefaultSelector()

    def _needs_cameras(self, data: Data) -> bool:
        return any(cell.cameras == "intersection" for cell in self._waiting[data])

    def run(self) -> None:
        """Until every cell has its record."""
        try:
            while True:
                self._occupy()
                if not self._workers:
                    return
                for key, _ in self._selector.select(_TICK):
                    self._hear(key.data)
                for worker in list(self._workers):
                    self._check(worker)
                self._clock.running = tuple(worker.doing for worker in self._workers if worker.busy)
                self._clock.tell()
        finally:
            for worker in self._workers:
                worker.end()
            self._selector.close()

    def _occupy(self) -> None:
        """Give every process something to do, start those that are missing, end those that nothing is left for."""
        for worker in list(self._workers):
            if not worker.busy and not self._employ(worker):
                self._dismiss(worker)
        while len(self._workers) < self._processes and self._choose(None) is not None:
            worker = Process(self._store.folder, self._root, self._threads)
            self._workers.append(worker)
            self._selector.register(worker.answers, selectors.EVENT_READ, worker)
            self._employ(worker)

    def _employ(self, worker: Process) -> bool:
        """Send the next job; false where there is none."""
        data = worker.data if worker.data is not None and self._open(worker.data) else self._choose(worker)
        if data is None:
            return False
        if data != worker.data:
            worker.load(data)
            return True
        path = self._store.cameras_path(data)
        if self._cameras.get(data) is False and not self._estimating(data):
            worker.send({"cameras": str(path)}, f"cameras of {data.sequence}")
            return True
        cell = next(c for c in self._waiting[data] if self._may_run(c))
        self._waiting[data].remove(cell)
        cameras = str(path) if cell.cameras == "intersection" else None
        job = {"cell": dataclasses.asdict(cell), "stem": self._store.stem(cell), "cameras": cameras}
        worker.send(job, f"{cell.method} on {data.sequence}", cell)
        return True

    def _may_run(self, cell: Cell) -> bool:
        return cell.cameras != "intersection" or self._cameras[cell.data]

    def _estimating(self, data: Data) -> bool:
        return any(w.data == data and w.busy and w.cell is None and not w.loading for w in self._workers)

    def _open(self, data: Data) -> bool:
        """Whether there is something that a process may do for the data now."""
        waiting = self._waiting.get(data)
        if not waiting:
            return False
        if self._cameras.get(data) is False and not self._estimating(data):
            return True
        return any(self._may_run(cell) for cell in waiting)

    def _choose(self, worker: Process | None) -> Data | None:
        """The data for a process that has none: those that nobody works on, then those with the most left to do."""
        served = [w.data for w in self._workers if w is not worker]
        open_ones = [d for d in self._waiting if self._open(d) and (d not in served or len(self._waiting[d]) > 1)]
        return min(open_ones, key=lambda d: (d in served, served.count(d)), default=None)

    def _hear(self, worker: Process) -> None:
        for answer in worker.listen():
            if answer is None:
                self._lost(worker, f"the process was lost: {worker.last_words()}", keep=False)
                return
            worker.busy = False
            if worker.loading:
                worker.loading = False
                if "error" in answer:
                    self._fail_all(worker.data, answer["error"])
                    worker.data = None
            elif worker.cell is None:
                self._cameras_done(worker.data, answer)
            else:
                record = answer.get("record") or {"error": str(answer.get("error"))}
                self._record(worker.cell, record, keep=True)

    def _check(self, worker: Process) -> None:
        """Kill what has passed a limit."""
        if not worker.busy:
            return
        limit = _LOADING if worker.loading else self._limits.seconds
        if time.perf_counter() - worker.since > limit:
            self._lost(worker, f"killed after {limit:g} s, the most that a cell may take", keep=True)
        elif (held := worker.held_bytes()) is not None and held > self._limits.memory:
            most = self._limits.memory / 1e9
            self._lost(worker, f"killed at {held / 1e9:.3g} GB of memory, above the limit of {most:g} GB", keep=True)

    def _lost(self, worker: Process, reason: str, *, keep: bool) -> None:
        """Record what a process that is gone, or has to go, was doing."""
        data, cell, loading, busy = worker.data, worker.cell, worker.loading, worker.busy
        self._dismiss(worker)
        if not busy or data is None:
            return
        if loading:
            self._fail_all(data, reason)
        elif cell is None:
            self._cameras_done(data, {"error": f"cameras: {reason}"})
        else:
            frames, points = sequences.size(cell.data, self._root)
            self._record(cell, {"frames": frames, "points": points, "error": reason}, keep=keep)

    def _cameras_done(self, data: Data | None, answer: dict[str, Any]) -> None:
        if data is None:
            return
        error = answer.get("error") or answer.get("record", {}).get("error")
        self._cameras[data] = True
        if error is not None:
            for cell in [c for c in self._waiting[data] if c.cameras == "intersection"]:
                self._waiting[data].remove(cell)
                self._record(cell, {"error": error}, keep=False)

    def _fail_all(self, data: Data | None, reason: str) -> None:
        waiting = self._waiting.pop(data, None) if data is not None else None
        for cell in waiting or ():
            self._record(cell, {"error": reason}, keep=False)

    def _record(self, cell: Cell, record: Record, *, keep: bool) -> None:
        if keep:
            self._store.write(cell, record)
        self._clock.finish(cell, self._store.resolved(record))

    def _dismiss(self, worker: Process) -> None:
        self._selector.unregister(worker.answers)
        self._workers.remove(worker)
        worker.end()


def readable(path: Path) -> bool:
    """Whether cameras are kept, and whole."""
    try:
        # An open file: numpy does not close one that it opened itself and cannot read.
        with path.open("rb") as stream, np.load(stream) as kept:
            return {"rotations", "seconds"} <= set(kept.files) and kept["rotations"].ndim == 3
    except Exception:  # noqa: BLE001 (a damaged archive raises what zipfile and zlib please)
        return False
