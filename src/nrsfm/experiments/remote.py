"""Cells on the workers of a dask cluster: each in a process of its own there, kept here as soon as it is finished.

A worker runs a cell as this machine would (:func:`nrsfm.experiments.runner.run_cells`), in a folder that goes away: so
the limits are kept there, and what is recorded is the same. The files that the cell leaves come back and are put into
the store. A cell whose worker is lost is run again by another.
"""

from __future__ import annotations

import dataclasses
import tempfile
from concurrent.futures import CancelledError
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.experiments.base import Cell, Data, Record
from nrsfm.experiments.kept import Store
from nrsfm.experiments.runner import Clock, Limits, readable, run_cells, weight
from nrsfm.experiments.worker import in_one_line
from nrsfm.streaming.cluster import Cluster
from nrsfm.streaming.connecting import ClusterError, require_seen

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Computed:
    """What came of a cell: the name of its files, those that it left, and its record."""

    stem: str
    files: dict[str, bytes]
    record: Record


def compute(cell: Cell, root: Path | None, limits: Limits, files: Mapping[str, bytes]) -> Computed:
    """On a worker: run a cell; ``files`` are cameras that were estimated before."""
    with tempfile.TemporaryDirectory(prefix="nrsfm-cell-") as name:
        folder = Path(name)
        store = Store(folder, root)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        record = run_cells([cell], store, root, jobs=1, threads=1, limits=limits)[cell.key]
        made = {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in files}
        return Computed(store.stem(cell), made, record)


class Sweep:
    """The cells of one run on a cluster; those that share cameras follow the first of them, which estimates these."""

    def __init__(
        self, cells: list[Cell], store: Store, root: Path | None, client: Any, limits: Limits, clock: Clock
    ) -> None:
        self._store, self._limits, self._clock = store, limits, clock
        self._root = None if root is None else root.resolve()
        self._cluster = Cluster(client)
        self._under_way: dict[Any, Cell] = {}
        self._followers: dict[Data, list[Cell]] = {}
        if self._root is not None:
            require_seen(client, self._root)
        for cell in sorted(cells, key=lambda cell: -weight(cell, root)):
            if cell.cameras != "intersection" or readable(store.cameras_path(cell.data)):
                self._submit(cell)
            elif cell.data in self._followers:
                self._followers[cell.data].append(cell)
            else:
                self._followers[cell.data] = []
                self._submit(cell)

    def run(self) -> None:
        """Until every cell has its record."""
        while self._under_way:
            self._clock.running = (f"{len(self._under_way)} cells on the cluster",)
            future = next(self._cluster.finished(self._under_way))
            cell = self._under_way.pop(future)
            self._clock.finish(cell, self._record(cell, future))
            self._follow(cell)

    def _submit(self, cell: Cell) -> None:
        files = {}
        if cell.cameras == "intersection":
            path = self._store.cameras_path(cell.data)
            files = {path.name: path.read_bytes()} if readable(path) else {}
        future = self._cluster.client.submit(
            compute, cell, self._root, self._limits, files, key=f"cell-{self._store.stem(cell)}", pure=False
        )
        self._under_way[future] = cell

    def _follow(self, cell: Cell) -> None:
        """Once cameras are there, those that waited for them; else the next tries, and says what goes wrong."""
        waiting = self._followers.get(cell.data, [])
        if cell.cameras != "intersection" or not waiting:
            return
        some = waiting if readable(self._store.cameras_path(cell.data)) else waiting[:1]
        self._followers[cell.data] = waiting[len(some) :]
        for other in some:
            self._submit(other)

    def _record(self, cell: Cell, future: Any) -> Record:
        """What came back, its files kept."""
        from nrsfm.files.atomic import atomic_file

        try:
            found: Computed = future.result()
        except CancelledError as error:
            raise ClusterError(f"cluster: the scheduler gave up a cell: {error}") from error
        except Exception as error:  # noqa: BLE001 (whatever went wrong belongs in the table, beside its cell)
            return {"error": f"the worker was lost: {in_one_line(error)}"}
        stem = self._store.stem(cell)
        if found.stem != stem:
            return {"error": "the worker's nrsfm, or its files of the sequence, differ from those here"}
        last = f"{stem}.json"  # what says that the others are there
        for name in sorted(found.files, key=lambda name: name == last):
            with atomic_file(self._store.folder / name) as stream:
                stream.write(found.files[name])
        return (self._store.read(cell) if last in found.files else None) or found.record
