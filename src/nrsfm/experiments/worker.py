"""The process that computes cells: ``python -m nrsfm.experiments.worker``, told by lines of JSON.

A line holds one job: data to load, a cell of these data, or the cameras that the intersection method finds for them.
Each is answered by one line. The end of the input ends the process, whatever it does, so that none outlives a runner
that was killed.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import json
import logging
import os
import queue
import resource
import sys
import threading
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.kept import cameras_cell, plain
from nrsfm.experiments.measures import Measured, get_measure

if TYPE_CHECKING:
    from nrsfm.datasets.sequence import Sequence

AS_PUBLISHED: dict[str, Any] = {"outliers": False, "perspective": "off", "gauge": "method", "deviation": False}
"""Options of every cell that does not say otherwise: the tracks as they are, an affine camera and the method's own
object frame, as in the published numbers; no seconds for what these do not have."""

_LONGEST = 300  # characters of an error's text


def cell_to_json(cell: Cell) -> dict[str, Any]:
    """The cell as plain values."""
    return dataclasses.asdict(cell)


def cell_from_json(values: dict[str, Any]) -> Cell:
    """The cell again; options and measures become tuples."""
    options = tuple((str(name), _tuple(value)) for name, value in values["options"])
    return Cell(**{**values, "data": Data(**values["data"]), "options": options, "measures": tuple(values["measures"])})


def _tuple(value: Any) -> Any:
    return tuple(_tuple(item) for item in value) if isinstance(value, list) else value


def run_cell(cell: Cell, sequence: Sequence, folder: Path, stem: str, cameras: Path | None = None) -> dict[str, Any]:
    """Reconstruct and measure; the record, or ``{"error": text}`` with what was raised."""
    sizes = {"frames": sequence.tracks.n_frames, "points": sequence.tracks.n_points}
    try:
        return sizes | _measured(cell, sequence, folder, stem, cameras)
    except Exception as error:  # noqa: BLE001 (whatever went wrong belongs in the table, beside its cell)
        return sizes | {"error": in_one_line(error)}


def in_one_line(error: BaseException) -> str:
    """What was raised, for a table."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    return (text if type(error).__module__.startswith("nrsfm.") else f"{kind}: {text}")[:_LONGEST]


def _measured(cell: Cell, sequence: Sequence, folder: Path, stem: str, cameras: Path | None) -> dict[str, Any]:
    from nrsfm import reconstruct
    from nrsfm.errors import InputError

    measures = {name: get_measure(name) for name in cell.measures}  # an unknown name is found before the work
    rotations, camera_seconds = None, None
    if cell.cameras == "known":
        rotations = sequence.rotations
        if rotations is None:
            raise InputError(f"the true cameras of '{sequence.name}' are not known")
    elif cell.cameras == "intersection":
        if cameras is None:
            raise InputError("the cameras of the intersection method are missing")
        with np.load(cameras) as kept:
            rotations, camera_seconds = kept["rotations"], float(kept["seconds"])
    _trim()
    before = _held_bytes()
    resettable = _reset_peak()
    start = time.perf_counter()
    options = AS_PUBLISHED | _mesh(cell, sequence) | dict(cell.options)
    result = reconstruct(sequence.tracks, cell.method, rotations, **options)
    seconds = time.perf_counter() - start
    peak = _peak_bytes() - before if resettable and before is not None else None
    measured = Measured(result, sequence, cell, seconds, peak, camera_seconds, folder, stem)
    return {name: plain(measure(measured)) for name, measure in measures.items()}


def _mesh(cell: Cell, sequence: Sequence) -> dict[str, Any]:
    """The sequence's mesh, for a method that asks for neighbours."""
    from nrsfm.methods import get_method

    takes = any(field.name == "faces" for field in dataclasses.fields(get_method(cell.method).Options))
    given = {"faces", "grid"} & set(dict(cell.options))
    return {"faces": sequence.faces} if takes and not given and sequence.faces is not None else {}


def estimate_cameras(data: Data, sequence: Sequence, path: Path) -> dict[str, Any]:
    """Keep the cameras of the intersection method as .npz: ``rotations``, and the ``seconds`` that they took."""
    from nrsfm import reconstruct
    from nrsfm.files.atomic import atomic_file

    cell = cameras_cell(data)
    try:
        result = reconstruct(sequence.tracks, cell.method, **(AS_PUBLISHED | dict(cell.options)))
    except Exception as error:  # noqa: BLE001 (told to every cell that needs these cameras)
        return {"error": f"cameras: {in_one_line(error)}"}
    seconds = result.diagnostics["seconds"]["cameras"]
    with atomic_file(path) as stream:
        np.savez(stream, rotations=result.rotations, seconds=np.float64(seconds))
    return {"seconds": seconds}


def _held_bytes() -> int | None:
    """Memory that this process holds now."""
    return _status("VmRSS")


def _peak_bytes() -> int:
    """Most memory that this process held since the last reset.

    From VmHWM where the kernel tells: ru_maxrss also counts what the parent held before this process began.
    """
    kernel = _status("VmHWM")
    if kernel is not None:
        return kernel
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _status(name: str) -> int | None:
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith(name):
                return int(line.split()[1]) * 1024
    except OSError:
        pass  # not Linux
    return None


def _reset_peak() -> bool:
    """Begin a new peak; false where the kernel has no such thing."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


def _trim() -> None:
    """Give memory that is free, but still held for later, back to the system: it would hide in the next peak."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _load_libraries() -> None:
    """Load what methods load when first used, so that the first cell's memory and seconds are not charged for it."""
    import scipy.linalg
    import scipy.optimize
    import scipy.sparse.linalg
    import scipy.spatial
    import scipy.special  # noqa: F401

    from nrsfm import reconstruct

    reconstruct(np.random.default_rng(0).standard_normal((12, 60, 2)), "bmm", max_iterations=3)


def main() -> None:
    """Answer until the input ends."""
    # Answers have a channel of their own: what a library prints must not end up among them.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    jobs: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(jobs,), daemon=True).start()
    logging.getLogger("nrsfm").setLevel(logging.ERROR)  # warnings are kept with the result
    desk = Desk()
    _load_libraries()
    while True:
        _answer(answers, desk.answer(jobs.get()))


class Desk:
    """What a worker has before it: the folders, and the sequence that its cells are computed of."""

    def __init__(self) -> None:
        self._folder = Path()
        self._root: Path | None = None
        self._data: Data | None = None
        self._sequence: Sequence | None = None

    def answer(self, job: dict[str, Any]) -> dict[str, Any]:
        """Do one job; ``{"ready": true}``, ``{"record": ...}`` or ``{"error": text}``."""
        if "folder" in job:
            self._folder, self._root = Path(job["folder"]), Path(job["root"]) if job["root"] else None
        if "data" in job:
            return self._load(Data(**job["data"]))
        if self._sequence is None or self._data is None:
            return {"error": "no data"}
        cameras = Path(job["cameras"]) if job["cameras"] else None
        if "cell" in job:
            cell = cell_from_json(job["cell"])
            return {"record": run_cell(cell, self._sequence, self._folder, job["stem"], cameras)}
        return {"record": estimate_cameras(self._data, self._sequence, Path(job["cameras"]))}

    def _load(self, data: Data) -> dict[str, Any]:
        from nrsfm.experiments import sequences

        self._data = self._sequence = None  # before the next is there: two may not fit
        try:
            self._sequence = sequences.load(data, self._root)
        except Exception as error:  # noqa: BLE001 (told to every cell of this data)
            return {"error": in_one_line(error)}
        self._data = data
        return {"ready": True}


def _read(jobs: queue.SimpleQueue[dict[str, Any]]) -> None:
    for line in sys.stdin:
        jobs.put(json.loads(line))
    os._exit(0)  # the runner has gone, or wants no more


def _answer(answers: IO[str], value: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):
        answers.write(json.dumps(value, allow_nan=False) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
