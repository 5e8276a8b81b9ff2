"""Reconstruct and score: the cases of the accuracy sections, each run once with one thread.

Cases that share a sequence, a noise level and a seed are run together, so that the data are made once. What is
measured is exact to repeat (one thread, seeded), so a case is run again only when the code has changed.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from benchmarks import store

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclasses.dataclass(frozen=True)
class Data:
    """Which tracks: a data set, noise as a ratio of max|W|, and the noise's seed."""

    sequence: str
    noise: float = 0.0
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Case:
    """One call of ``reconstruct``; ``cameras`` is "known" or "estimated", ``options`` are (name, value) pairs."""

    data: Data
    method: str
    cameras: str
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def key(self) -> str:
        """The case in words, its name in the kept results."""
        data = self.data
        noise = f"noise {data.noise:g} seed {data.seed}" if data.noise else "clean"
        words = [data.sequence, noise, self.cameras, self.method, *(f"{k}={v}" for k, v in self.options)]
        return " | ".join(words)


def run_cases(section: str, cases: Iterable[Case], measures: tuple[str, ...], context: store.Context) -> dict[str, Any]:
    """Run what is not kept already and return the record of every case, by key.

    ``measures`` names functions of ``_MEASURES``. A case that raises is recorded as ``{"error": ...}`` and does
    not stop the others; the page shows it as failed.
    """
    store.data_folder()
    digest = store.code_digest()
    before = store.read(section)
    records: dict[str, Any] = dict(before["values"].get("records", {})) if before else {}
    groups: dict[Data, list[Case]] = {}
    wanted = list(cases)
    for case in wanted:
        kept = records.get(case.key)
        stale = context.fresh or kept is None or kept["code"] != digest or "error" in kept
        if context.wanted(case.data.sequence) and stale:
            groups.setdefault(case.data, []).append(case)
    records = {case.key: records[case.key] for case in wanted if case.key in records}
    # Spawned processes read the limit before NumPy starts its threads.
    os.environ.update(dict.fromkeys(THREADS, "1"))
    start, done, total = time.perf_counter(), 0, sum(len(g) for g in groups.values())
    if total < len(wanted):
        store.say(f"{section}: {total} of {len(wanted)} cases to run")
    with ProcessPoolExecutor(context.jobs, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(_run_group, data, group, measures) for data, group in groups.items()]
        for (data, group), task in zip(groups.items(), tasks, strict=True):
            try:
                found = task.result()
            except BrokenProcessPool as error:
                found = {case.key: {"error": f"process lost: {error}"} for case in group}
            records |= {key: record | {"code": digest} for key, record in found.items()}
            store.write(section, {"records": records})  # what is done stays done if the rest is interrupted
            done += len(group)
            noise = f" noise {data.noise:g} seed {data.seed}" if data.noise else ""
            store.say(f"{section}: {done}/{total} {data.sequence}{noise} ({time.perf_counter() - start:.0f} s)")
    return {"records": records}


def _run_group(data: Data, cases: list[Case], measures: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    import logging

    from nrsfm import datasets, reconstruct

    logging.getLogger("nrsfm").setLevel(logging.ERROR)  # warnings are kept with the result
    sequence = datasets.load(data.sequence, store.data_folder(), noise=data.noise, seed=data.seed)
    records: dict[str, dict[str, Any]] = {}
    for case in cases:
        rotations = sequence.rotations if case.cameras == "known" else None
        start = time.perf_counter()
        try:
            result = reconstruct(sequence.tracks, case.method, rotations, **dict(case.options))
            seconds = time.perf_counter() - start
            record = {name: _MEASURES[name](result, sequence) for name in measures}
        except Exception as error:  # noqa: BLE001 (whatever went wrong belongs in the table, beside its case)
            records[case.key] = {"error": f"{type(error).__name__}: {error}"}
            continue
        kept = {name: result.diagnostics.get(name) for name in ("iterations", "chosen", "warnings")}
        kept["cameras"] = _json(result.diagnostics.get("cameras", {}))
        kept["cells"] = result.diagnostics.get("compression", {}).get("cells")
        records[case.key] = {**record, "seconds": round(seconds, 3), **_json(kept)}
    return records


def _json(value: Any) -> Any:
    """The value as JSON gives it back; what JSON does not know becomes text."""
    return json.loads(json.dumps(value, default=str))


def _global(result: Any, sequence: Any) -> float | None:
    from nrsfm import shape_error

    # Truth in the camera's frame turns with the camera: one alignment in the object's frame means nothing.
    return None if sequence.note["frame"] == "camera" else shape_error(result, sequence.shapes, "global")


def _aligned(align: str) -> Callable[[Any, Any], float]:
    def measure(result: Any, sequence: Any) -> float:
        from nrsfm import shape_error

        return shape_error(result, sequence.shapes, align)

    return measure


def _camera_frame(result: Any, sequence: Any) -> float | None:
    import numpy as np

    from nrsfm.metrics import camera_frame_error

    rotations = sequence.rotations
    if sequence.note["frame"] == "camera":
        rotations = np.broadcast_to(np.eye(3), (len(sequence.shapes), 3, 3))
    return None if rotations is None else camera_frame_error(result, sequence.shapes, rotations)


def _rotation(result: Any, sequence: Any) -> float | None:
    from nrsfm.metrics import rotation_error

    return None if sequence.rotations is None else rotation_error(result, sequence.rotations)


def _true_turn(_: Any, sequence: Any) -> float | None:
    """Largest angle in degrees between the true viewing directions of two frames."""
    import numpy as np

    if sequence.rotations is None:
        return None
    axes = sequence.rotations[:, 2]
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))


def _unreflected(result: Any, sequence: Any) -> float:
    """Mean over frames of the similarity error without reflection: it tells a shape from its mirror image."""
    import numpy as np

    errors = []
    for estimate, truth in zip(result.shapes, sequence.shapes, strict=True):
        a = np.asarray(estimate, dtype=np.float64)
        b = np.asarray(truth, dtype=np.float64)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        u, values, vt = np.linalg.svd(a.T @ b)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        scale = float(values @ sign) / float(np.sum(a * a))
        errors.append(np.linalg.norm(scale * a @ (u * sign) @ vt - b) / np.linalg.norm(b))
    return float(np.mean(errors))


_MEASURES: dict[str, Callable[[Any, Any], Any]] = {
    "per_frame": _aligned("per-frame"),
    "similarity": _aligned("similarity"),
    "global": _global,
    "camera_frame": _camera_frame,
    "rotation": _rotation,
    "true_turn": _true_turn,
    "unreflected": _unreflected,
}
