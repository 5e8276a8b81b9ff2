"""Reconstruct and score: the cases of the accuracy sections, each run once with one thread.

Cases that share their tracks are run together, so that the data are made once. What is measured is exact to repeat
(one thread, seeded), so a case is run again only when the code has changed, and a section may take over what another
one has measured with the same code.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from benchmarks import scores, store
from benchmarks.tracks import Data, sequence_of

__all__ = ["THREADS", "Case", "Data", "run_cases"]

Measures = tuple[str, ...] | Callable[["Case"], tuple[str, ...]]

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


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
        return " | ".join([self.data.words, self.cameras, self.method, *(f"{k}={v}" for k, v in self.options)])


def run_cases(
    section: str, cases: Iterable[Case], measures: Measures, context: store.Context, borrow: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Run what is not kept already and return the record of every case, by key.

    ``measures`` names functions of ``scores.MEASURES``, for all cases or for each. A case that is kept in a section
    that ``borrow`` names, with these measures and this code, is taken from there. A case that raises is recorded as
    ``{"error": ...}`` and does not stop the others; the page shows it as failed.
    """
    store.data_folder()
    digest = store.code_digest()
    wanted = {case.key: case for case in cases}
    asked = {key: measures(case) if callable(measures) else measures for key, case in wanted.items()}

    def holds(key: str, record: dict[str, Any]) -> bool:
        return record["code"] == digest and "error" not in record and all(name in record for name in asked[key])

    records = {key: record for key, record in _kept(section).items() if key in wanted}
    for other in borrow if not context.fresh else ():
        new = {k: r for k, r in _kept(other).items() if k in wanted and holds(k, r)}
        records |= {k: r for k, r in new.items() if k not in records or not holds(k, records[k])}
    groups: dict[Data, list[tuple[Case, tuple[str, ...]]]] = {}
    for key, case in wanted.items():
        stale = context.fresh or key not in records or not holds(key, records[key])
        if context.wanted(case.data.sequence) and stale:
            groups.setdefault(case.data, []).append((case, asked[key]))
    # Spawned processes read the limit before NumPy starts its threads.
    os.environ.update(dict.fromkeys(THREADS, "1"))
    start, done, total = time.perf_counter(), 0, sum(len(g) for g in groups.values())
    if total < len(wanted):
        store.say(f"{section}: {total} of {len(wanted)} cases to run")
    with ProcessPoolExecutor(context.jobs, mp_context=get_context("spawn")) as pool:
        tasks = {pool.submit(_run_group, data, group): data for data, group in groups.items()}
        for task in as_completed(tasks):
            data = tasks[task]
            try:
                found = task.result()
            except BrokenProcessPool as error:
                found = {case.key: {"error": f"process lost: {error}"} for case, _ in groups[data]}
            records |= {key: record | {"code": digest} for key, record in found.items()}
            store.write(section, {"records": records})  # what is done stays done if the rest is interrupted
            done += len(groups[data])
            store.say(f"{section}: {done}/{total} {data.words} ({time.perf_counter() - start:.0f} s)")
    return {"records": {key: records[key] for key in wanted if key in records}}


def _kept(section: str) -> dict[str, Any]:
    before = store.read(section)
    records: dict[str, Any] = before["values"].get("records", {}) if before else {}
    return records


def _run_group(data: Data, cases: list[tuple[Case, tuple[str, ...]]]) -> dict[str, dict[str, Any]]:
    import logging

    from nrsfm import reconstruct

    logging.getLogger("nrsfm").setLevel(logging.ERROR)  # warnings are kept with the result
    sequence = sequence_of(data)
    records: dict[str, dict[str, Any]] = {}
    for case, measures in cases:
        rotations = sequence.rotations if case.cameras == "known" else None
        start = time.perf_counter()
        try:
            result = reconstruct(sequence.tracks, case.method, rotations, **dict(case.options))
            seconds = time.perf_counter() - start
            record = {name: scores.MEASURES[name](result, sequence) for name in measures}
        except Exception as error:  # noqa: BLE001 (whatever went wrong belongs in the table, beside its case)
            records[case.key] = {"error": f"{type(error).__name__}: {error}"}
            continue
        kept = {name: result.diagnostics.get(name) for name in ("iterations", "chosen", "warnings", "mirror")}
        kept["cameras"] = _json(result.diagnostics.get("cameras", {}))
        kept["cells"] = result.diagnostics.get("compression", {}).get("cells")
        kept["undone"] = (result.diagnostics.get("perspective") or {}).get("undone")
        records[case.key] = {**record, "seconds": round(seconds, 3), **_json(kept)}
    return records


def _json(value: Any) -> Any:
    """The value as JSON gives it back; what JSON does not know becomes text."""
    return json.loads(json.dumps(value, default=str))
