"""Tracks of rendered videos against their truth, shapes from them beside those from perfect tracks; a real video."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

from benchmarks import quiet, store, targets
from benchmarks.children import TIMED_THREADS, TaskError, run_task
from benchmarks.store import Context
from benchmarks.tables import Check, amount, error, table

TITLE = "Tracks of videos"
METHODS = ("naive", "dis", "subspace")
_BEST = "subspace"
_CLOTH = "phisft_R1_video"
_ENTRIES = 400_000  # frames times points that are reconstructed: half of what `nrsfm run` takes


@dataclasses.dataclass(frozen=True)
class Video:
    """A rendered video; ``data`` says that the scene is read from the data folder."""

    scene: str
    variant: str
    size: int = 480
    data: bool = False
    seed: int = 0
    frames: int | None = None

    @property
    def name(self) -> str:
        """In words, the first part of its keys."""
        return f"{self.scene}, {self.variant}"

    @property
    def face(self) -> bool:
        """Whether the targets for faces hold."""
        return self.scene != "flag"


VIDEOS = (
    Video("face", "realistic"),
    Video("face", "realistic+discs"),
    Video("flag", "plain", 500),
    Video("flag", "discs", 500),
    Video("flag", "gaussian", 500),
    Video("flag", "salt-and-pepper", 500),
    Video("face-seq3", "realistic", data=True),
    Video("face-seq4", "realistic", data=True),
    Video("ict-rom99", "realistic", data=True),
)
TUNED = ("face, realistic", "flag, plain")
"""Videos that were looked at while tracking was being made; every other one is held out."""


def measure(context: Context) -> dict[str, Any]:
    """Each video in a process of its own, with those methods whose numbers are not kept already."""
    digest = store.code_digest("tracking")
    before = store.read("tracking")
    records: dict[str, Any] = dict(before["values"].get("records", {})) if before else {}
    plan = {video.name: video for video in VIDEOS}
    wanted = {f"{name} | {method}" for name in (*plan, _CLOTH) for method in METHODS}
    records = {key: record for key, record in records.items() if key in wanted}
    for name in (*plan, _CLOTH):
        if not context.wanted(name):
            continue
        missing = [
            method
            for method in METHODS
            if context.fresh
            or records.get(f"{name} | {method}", {}).get("code") != digest
            or "error" in records[f"{name} | {method}"]
        ]
        settings = _cloth_settings(missing) if name == _CLOTH else _render_settings(plan[name], missing)
        if not missing or settings is None:
            continue
        start, watch = time.perf_counter(), quiet.Watch.start()
        try:
            found = run_task("tracking_task", settings)
        except TaskError as failure:
            found = {method: {"error": str(failure)[-300:]} for method in missing}
        others = watch.others()
        for method, record in found.items():
            records[f"{name} | {method}"] = record | {"code": digest, "others": others}
        store.write("tracking", _values(records))  # what is done stays done if the rest is interrupted
        store.say(f"tracking: {name}, {', '.join(missing)}: {time.perf_counter() - start:.0f} s")
    return _values(records)


def _values(records: dict[str, Any]) -> dict[str, Any]:
    busy = [record["others"] for record in records.values() if record.get("others") is not None]
    return {"records": records, "others": max(busy) if busy else None, "threads": TIMED_THREADS}


def _render_settings(video: Video, methods: list[str]) -> dict[str, Any] | None:
    folder = None
    if video.data:
        try:
            folder = str(store.data_folder())
        except store.DataAbsentError as absent:
            store.say(f"tracking: {video.name} is left out: {absent}")
            return None
    return {
        "scene": video.scene,
        "data": folder,
        "variant": video.variant,
        "size": video.size,
        "seed": video.seed,
        "frames": video.frames,
        "methods": methods,
        "reconstructed": [_BEST],
        "entries": _ENTRIES,
    }


def _cloth_settings(methods: list[str]) -> dict[str, Any] | None:
    try:
        folder = store.data_folder() / _CLOTH
    except store.DataAbsentError as absent:
        store.say(f"tracking: {_CLOTH} is left out: {absent}")
        return None
    if not folder.is_dir():
        store.say(f"tracking: {_CLOTH} is left out: it is not in the data folder")
        return None
    return {"folder": str(folder), "size": None, "methods": methods, "picture": str(store.OUTPUT)}


def _of(values: dict[str, Any], name: str, method: str) -> dict[str, Any]:
    record: dict[str, Any] = values["records"].get(f"{name} | {method}", {})
    return record


def _marked(name: str) -> str:
    return f"{name} (tuned)" if name in TUNED else name


def _ratio(values: dict[str, Any], name: str) -> float | None:
    best, naive = (_of(values, name, method).get("mean") for method in (_BEST, "naive"))
    return best / naive if best is not None and naive else None


def checks(values: dict[str, Any]) -> list[Check]:
    """Against the naive chain over 99 frames, in pixels on faces, and in seconds."""
    found = []
    for video in VIDEOS:
        record = _of(values, video.name, _BEST)
        if not record or not video.face:
            continue
        what = f"tracks, {_marked(video.name)}"
        found.append(Check(f"{what}: mean / naive mean", _ratio(values, video.name), targets.TRACK_RATIO, "×"))
        if video.variant == "realistic":
            found.append(Check(f"{what}: median", record.get("median"), targets.TRACK_MEDIAN, " px"))
    record = _of(values, VIDEOS[0].name, _BEST)
    if record.get("seconds") is not None:
        spent = record["seconds"] * 100 / record["frames"]
        found.append(Check("tracks: 100 frames of 480 × 480, `subspace`", spent, targets.TRACK_SECONDS, " s"))
    return found


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def _pixels(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def render(values: dict[str, Any]) -> list[str]:
    """Tracks, shapes from them, and the real video."""
    lines = [
        "Rendered videos in which every track is known; one seed. The mask of the reference frame alone is given.",
        "End-point error in pixels over all entries that truly are visible. Seconds are those of the whole of",
        f"`track`, with {values['threads']} threads. {quiet.sentence(values['others'])}",
        "",
    ]
    rows = []
    for video in VIDEOS:
        for method in METHODS:
            record = _of(values, video.name, method)
            if not record:
                continue
            first = _marked(video.name) if method == METHODS[0] else ""
            if "error" in record:
                rows.append([first, method, f"failed: {record['error']}", *[""] * 7])
                continue
            share = "" if method == "naive" else f"{_ratio_of(values, video.name, method)}"
            rows.append(
                [
                    first,
                    method,
                    _pixels(record["mean"]),
                    share,
                    _pixels(record["median"]),
                    _percent(record["under_1"]),
                    _percent(record["under_3"]),
                    _percent(record["precision"]),
                    _percent(record["recall"]),
                    amount(record["seconds"]),
                ]
            )
    head = ["", "method", "mean", "/ naive", "median", "under 1 px", "under 3 px", "precision", "recall", "seconds"]
    lines += table(head, rows)
    lines += _shape_lines(values)
    lines += _cloth_lines(values)
    found = checks(values)
    lines += table(["target", ""], [[check.what, check.cell()] for check in found]) if found else []
    return lines


def _ratio_of(values: dict[str, Any], name: str, method: str) -> str:
    own, naive = (_of(values, name, m).get("mean") for m in (method, "naive"))
    return "–" if own is None or not naive else f"{own / naive:.2f}"


def _shape_lines(values: dict[str, Any]) -> list[str]:
    rows = []
    for video in VIDEOS:
        found = _of(values, video.name, _BEST).get("shapes")
        if not found:
            continue
        rows.append(
            [
                _marked(video.name),
                error(found["estimated"]),
                error(found["perfect"]),
                error(found["estimated"] - found["perfect"]),
                f"{found['compared']:,} of {found['points']:,}",
                amount(found["seconds"]["estimated"]),
            ]
        )
    if not rows:
        return []
    text = (
        "Shapes by the default method from `subspace` tracks, and from the true tracks of the same points with their "
        "true visibility: e3D, each frame turned, no scale; over points that both reconstruct. The difference is what "
        "tracking costs."
    )
    head = ["", "estimated tracks", "perfect tracks", "difference", "points compared", "seconds"]
    return [text, "", *table(head, rows)]


def _cloth_lines(values: dict[str, Any]) -> list[str]:
    rows = []
    for method in METHODS:
        record = _of(values, _CLOTH, method)
        if not record:
            continue
        if "error" in record:
            rows.append([method, f"failed: {record['error']}", *[""] * 5])
            continue
        rows.append(
            [
                method,
                _pixels(record["grey_levels"]),
                _pixels(record["photometric"]),
                _percent(record["visible"]),
                _percent(record["inside"]),
                _percent(record["near"]),
                amount(record["seconds"]),
            ]
        )
    if not rows:
        return []
    text = (
        f"`{_CLOTH}`, real cloth with a mask for every frame, of which tracking is told the reference's alone. Over "
        "points called visible: mean difference to the reference in grey levels of 255, the same of evened-out images, "
        "the share of points called visible, and of those the share inside the frame's mask, and within 3 pixels of it."
    )
    head = ["method", "grey levels", "evened out", "visible", "inside the mask", "within 3 px", "seconds"]
    return [text, "", *table(head, rows)]
