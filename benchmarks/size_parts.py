"""What the section about size measures: each part makes its tracks, measures them in fresh processes, and ends."""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import store, targets
from benchmarks.children import KEEPS_MEMORY, run_task
from benchmarks.long_task import FRAMES
from benchmarks.size_data import Size, surface, write_tracks

METHOD = "geometry-aware"
CELLS = {"spatial_cells": 50}
BARE = {"deviation": False}  # standard deviations are a second result, a third as large as the shapes
VERTICES = Size(6_706, 346, "vertices")
ACTOR = Size(1_180_232, 346, "subdivided")
MILLIONS = Size(10_000_000, 100, "random")
FEW, MANY = Size(250_000, 99), Size(1_000_000, 99)
ROUNDS, SVD_ROUNDS = 3, 5
SPEED = "face-seq3"

_BASE = Size(100_000, 99)
_GRID_POINTS = (10_000, 1_000_000)
_GRID_FRAMES = (25, 50, 200, 346)
_GRID_CELLS = (20, 100, 200)
_GRID_METHODS = ("bmm", "grassmann", "auto", "pta", "csf1", "csf2", "ksta", "mp", "smsr", "rbmm", "organic", "em-pnd")

GIGA = 1e9


def scratch() -> tempfile.TemporaryDirectory[str]:
    """A folder that is deleted afterwards, in ``NRSFM_SCRATCH`` or beside the kept numbers."""
    folder = Path(os.environ.get("NRSFM_SCRATCH") or store.OUTPUT / "size")
    folder.mkdir(parents=True, exist_ok=True)
    return tempfile.TemporaryDirectory(dir=folder, prefix="size-")


def _file(folder: Path, size: Size) -> Path:
    """The file of tracks of a size, made where it is not there."""
    file = folder / size.file_name
    if not file.exists():
        start = time.perf_counter()
        write_tracks(surface(size), file)
        store.say(f"size: {file.name}: {size.nbytes / GIGA:.2f} GB in {time.perf_counter() - start:.0f} s")
    return file


def _run(
    folder: Path,
    size: Size,
    options: dict[str, Any],
    *,
    method: str = METHOD,
    from_file: bool = True,
    rounds: int = 1,
    keeps_memory: bool = False,
) -> dict[str, Any]:
    """One reconstruction in a process of its own: from file to file, or in memory.

    ``keeps_memory``: what a round has freed serves the next one, so that medians hold no time of the system's for new
    memory.
    """
    shapes = folder / "shapes" / "shapes.npy"
    shapes.parent.mkdir(exist_ok=True)
    given = {"file": str(_file(folder, size)), "mapped": from_file, "shapes_file": str(shapes) if from_file else None}
    given |= {"size": dataclasses.asdict(size), "method": method, "options": options, "rounds": rounds, "score": True}
    try:
        row = run_task("size_task", given, more=KEEPS_MEMORY if keeps_memory else None)
    finally:
        shutil.rmtree(shapes.parent)
    names = ("size", "method", "options", "mapped")
    store.say(
        f"size: {size.points} x {size.frames}, {method}, {options}: {median(row['seconds']):.1f} s, "
        f"peak {row['peak_bytes'] / GIGA:.2f} GB, e3D {row['errors']['per-frame']:.4f}"
    )
    return row | {name: given[name] for name in names}


def _actor(folder: Path) -> dict[str, Any]:
    """The largest sequence of this literature in size, and the vertices alone."""
    return {"large": _run(folder, ACTOR, CELLS), "small": _run(folder, VERTICES, CELLS)}


def _growth(folder: Path) -> dict[str, Any]:
    """In memory, where nothing waits for a disk; and the larger one from file to file."""
    few, many = (_run(folder, s, CELLS | BARE, from_file=False, rounds=ROUNDS, keeps_memory=True) for s in (FEW, MANY))
    fresh = _run(folder, MANY, CELLS | BARE, from_file=False, rounds=ROUNDS)
    return {"few": few, "many": many, "fresh": fresh, "file": _run(folder, MANY, CELLS | BARE)}


def _millions(folder: Path) -> dict[str, Any]:
    return {"large": _run(folder, MILLIONS, CELLS | {"memory": f"{targets.SIZE_BUDGET:g}GB"})}


def _speed(_: Path) -> dict[str, Any]:
    jobs = [(SPEED, targets.NOISE)]
    return run_task("speed_task", {"jobs": jobs, "methods": [METHOD], "rounds": SVD_ROUNDS, "svd": True})


def _grid(folder: Path) -> dict[str, Any]:
    """One thing changed at a time."""
    sizes = [Size(points, _BASE.frames) for points in _GRID_POINTS]
    sizes += [Size(_BASE.points, frames) for frames in _GRID_FRAMES]
    rows = [_run(folder, size, CELLS | BARE) for size in (_BASE, *sizes)]
    rows += [_run(folder, _BASE, {"spatial_cells": cells} | BARE) for cells in _GRID_CELLS]
    rows += [_run(folder, _BASE, BARE, method=method) for method in _GRID_METHODS]
    return {"rows": rows}


LONG_FRAMES = (346, 1000, 2000, FRAMES)
LONG_METHODS, LONG_NOISE = (METHOD, "auto"), (0.0, 0.01)


def _long(_: Path) -> dict[str, Any]:
    """The beginning of a long take, more and more of it; and pieces of it, each on its own."""
    rows = []
    for method in LONG_METHODS:
        for noise in LONG_NOISE:
            for frames in (*LONG_FRAMES, 0):
                given = {"method": method, "noise": noise, "frames": frames}
                found = run_task("long_task", given)["rows"]
                store.say(f"size: long: {given}: {sum(row['seconds'] for row in found):.1f} s")
                rows.append(given | {"runs": found})
    return {"rows": rows}


PARTS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "actor": _actor,
    "growth": _growth,
    "ten-million": _millions,
    "speed": _speed,
    "long": _long,
    "grid": _grid,
}
