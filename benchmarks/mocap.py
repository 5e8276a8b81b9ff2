"""The sparse motion-capture classics, with estimated and with known cameras."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import Check, degrees, error, table
from benchmarks.tracks import Data

TITLE = "Motion capture, published algorithms"
_SEQUENCES = ("pickup", "yoga", "stretch", "drink", "dance", "face1", "walking", "shark")
_WITHOUT_CAMERAS = ("walking", "shark")
_MEASURES = ("per_frame", "global", "camera_frame", "rotation", "true_turn")
_STILL = 1.0  # degrees: a camera that turns less does not turn


def measure(context: Context) -> dict[str, Any]:
    """Every sequence with every method, cameras estimated, and known where they are known."""
    cases = [
        Case(Data(sequence), method, cameras)
        for sequence in sorted(_SEQUENCES, key=lambda name: name != "drink")  # the longest first
        for cameras in ("estimated", "known")
        if cameras == "estimated" or sequence not in _WITHOUT_CAMERAS
        for method in targets.METHODS
    ]
    return run_cases("mocap", cases, _MEASURES, context)


def _best(values: dict[str, Any], sequence: str, name: str) -> float | None:
    records = values["records"]
    found = [records.get(Case(Data(sequence), m, "estimated").key, {}).get(name) for m in targets.METHODS]
    return min((value for value in found if value is not None), default=None)


def checks(values: dict[str, Any]) -> list[Check]:
    """Best of the three methods after one alignment of the sequence, in either frame."""
    return [
        Check(f"{sequence}, best of three, estimated cameras, one alignment in the {frame} frame", value, limit)
        for name, frame in (("global", "object"), ("camera_frame", "camera"))
        for sequence, limit in targets.MOCAP.items()
        for value in [_best(values, sequence, name)]
    ]


def render(values: dict[str, Any]) -> list[str]:
    """Targets, then every number."""
    records = values["records"]
    cells = iter(checks(values))
    lines = [
        "e3D, best of the three methods, cameras estimated, one orthogonal alignment for the whole sequence. In the "
        "object frame errors of the cameras count in full; in the camera frame (R·S as each camera sees it, the "
        "protocol of the motion-capture literature) a turn of object and camera together does not.",
        "",
    ]
    rows = [[f"{frame} frame", *(next(cells).cell() for _ in targets.MOCAP)] for frame in ("object", "camera")]
    lines += table(["", *targets.MOCAP], rows)
    for cameras in ("estimated", "known"):
        rows = []
        for sequence in _SEQUENCES:
            for method in targets.METHODS:
                record = records.get(Case(Data(sequence), method, cameras).key)
                if record is not None:
                    rows.append(_row(sequence, method, cameras, record))
        lines += [f"**{cameras.capitalize()} cameras**", ""]
        lines += table(["", "method", "K", "rotation", "per frame", "global, object", "global, camera"], rows)
    return lines + _remarks(records)


def _row(sequence: str, method: str, cameras: str, record: dict[str, Any]) -> list[str]:
    if "error" in record:
        return [sequence, f"`{method}`", f"failed: {record['error']}", "", "", "", ""]
    estimated = cameras == "estimated"
    return [
        sequence,
        f"`{method}`",
        str(record["cameras"].get("rank", "–")) if estimated else "–",
        degrees(record["rotation"]) if estimated else "–",
        error(record["per_frame"]),
        error(record["global"]),
        error(record["camera_frame"]),
    ]


def _remarks(records: dict[str, Any]) -> list[str]:
    turns = {key.split(" | ")[0]: r["true_turn"] for key, r in records.items() if r.get("true_turn") is not None}
    still = [name for name in _SEQUENCES if turns.get(name, _STILL) < _STILL]
    lines = []
    if still:
        plural = len(still) > 1
        lines += [
            f"The stored cameras of {', '.join(still)} do not turn at all: with them as known cameras the depth is "
            f"undetermined, and the rotation errors of {'these' if plural else 'this one'} compare with a camera that "
            "stands still.",
            "",
        ]
    lines += [
        f"The truth of {' and '.join(_WITHOUT_CAMERAS)} is given in the camera's frame and without cameras: there is "
        "no rotation error, and no error in the object frame.",
        "",
    ]
    return lines
