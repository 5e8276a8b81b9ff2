"""What the section about size says of sequences of thousands of frames."""

from __future__ import annotations

from statistics import mean
from typing import Any

from benchmarks import long_task, targets
from benchmarks.size_parts import GIGA, LONG_METHODS, LONG_NOISE
from benchmarks.tables import Check, error, noise_words, table

CAMERAS = "Rz(6° sin(1.7t + 1)) · Rx(18° sin(4.3t + 0.4)) · Ry(45° sin 3t), t = 2πf/345"
_ALIGNED = {"per-frame": "error", "global": "error with one alignment"}


def _by_case(part: dict[str, Any]) -> dict[tuple[str, float], dict[int, list[dict[str, Any]]]]:
    """Runs by method and noise, then by number of frames, 0 for the pieces."""
    found: dict[tuple[str, float], dict[int, list[dict[str, Any]]]] = {}
    for row in part["rows"]:
        found.setdefault((row["method"], row["noise"]), {})[row["frames"]] = row["runs"]
    return found


def checks(part: dict[str, Any] | None) -> list[Check]:
    """Time and memory of the whole take, the worst of all runs; its error beside that of its pieces, run by run."""
    what = f"{long_task.POINTS:,} × {long_task.FRAMES:,}"
    cases = _by_case(part) if part else {}
    wholes = [runs[long_task.FRAMES][0] for runs in cases.values()]
    seconds = max(one["seconds"] for one in wholes) if wholes else None
    peak = max(one["peak_bytes"] for one in wholes) / GIGA if wholes else None
    found = [
        Check(f"{what}: longest time", seconds, targets.SIZE_LONG_SECONDS, " s"),
        Check(f"{what}: peak memory", peak, targets.SIZE_MEMORY, " GB"),
    ]
    for method in LONG_METHODS:
        for noise in LONG_NOISE:
            runs = cases.get((method, noise))
            for align, name in _ALIGNED.items():
                ratio = None
                if runs:
                    ratio = runs[long_task.FRAMES][0][align] / mean(run[align] for run in runs[0])
                words = f"{what}, {noise_words(noise)}, `{method}`: {name} / mean of its {long_task.PIECE}-frame pieces"
                found.append(Check(words, ratio, targets.SIZE_LONG_ERROR, "×"))
    return found


def render(part: dict[str, Any]) -> list[str]:
    """One row for each length, method and noise."""
    head = ["method", "tracks", "frames", "seconds", "peak, GB", "e3D", "one alignment", "virtual points"]
    head += ["directions", "key frames", "share of ‖W‖² discarded", "left out of the directions"]
    rows = []
    for (method, noise), by_frames in _by_case(part).items():
        for frames, runs in by_frames.items():
            rows.append([f"`{method}`", noise_words(noise), *_cells(frames, runs)])
    return [
        f"`{long_task.TAKE}`, {long_task.POINTS:,} points, float32, under the cameras {CAMERAS} in frame f: its first "
        f"frames, and the whole; then {long_task.PIECES} pieces of {long_task.PIECE} frames spread evenly over it, "
        "each on its own (means of all columns, but the most memory). Nothing set but the method; tracks and truth in "
        "memory; single runs. e3D: each frame aligned by itself; beside it one alignment for a whole sequence, or a "
        "whole piece. Discarded: what the compression cuts off and shrinks away, noise included. What the directions "
        "of the iteration leave out is a root mean square per coordinate in units of the tracks' own.",
        "",
        *table(head, rows),
    ]


def _cells(frames: int, runs: list[dict[str, Any]]) -> list[str]:
    def average(name: str) -> float:
        return mean(run[name] for run in runs)

    last = runs[-1]
    pieces = f"{len(runs)} pieces of {long_task.PIECE}"
    return [
        f"{frames:,}" if frames else pieces,
        f"{average('seconds'):.1f}",
        f"{max(run['peak_bytes'] for run in runs) / GIGA:.2f}",
        error(average("per-frame")),
        error(average("global")),
        f"{round(average('virtual_points')):,}",
        str(last["directions"] or "") if frames else "",
        str(last["key_frames"] or "") if frames else "",
        f"{average('discarded'):.1e}",
        f"{last['cut']:.1e}" if frames and last["cut"] else "",
    ]
