"""How time and memory grow with the number of points on the same surface, 99 frames."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import quiet, targets
from benchmarks.children import TIMED_THREADS, run_task
from benchmarks.store import OUTPUT, Context, data_folder, say
from benchmarks.tables import Check, amount, noise_words, table

TITLE = "Growth with the number of points"
_SEQUENCE = "face-seq3"
_SIZES = (7_325, 29_299, 117_196, 468_784)
_SMALL, _LARGE = 29_299, 468_784
_ROUNDS = 3
_BARE = {"deviation": False}  # standard deviations are a second result, half as large as the tracks in float32


def _plan() -> list[tuple[int, float, str]]:
    """(points, noise, dtype) of every row: the sweep, both dtypes at both ends, and noise at both ends."""
    sweep = [(points, 0.0, "float32") for points in _SIZES]
    ends = [(points, noise, dtype) for points in (_SMALL, _LARGE) for noise, dtype in _EXTRA]
    return sweep + ends


_EXTRA = ((0.0, "float64"), (targets.NOISE, "float32"))


def measure(context: Context) -> dict[str, Any]:
    """Every row of the plan, with both algorithms; each measurement is a process of its own."""
    import numpy as np

    from nrsfm import datasets

    folder = data_folder()
    OUTPUT.mkdir(exist_ok=True)
    rows: list[dict[str, Any]] = []
    whole: list[dict[str, Any]] = []
    others = []
    with tempfile.TemporaryDirectory(dir=OUTPUT, prefix=".scaling-") as kept:
        for points, noise, dtype in _plan():
            sequence = datasets.load(_SEQUENCE, folder, points=points, noise=noise, dtype=dtype, truth=False)
            file = Path(kept) / "points.npy"
            np.save(file, sequence.tracks.points)
            del sequence
            for method in targets.OWN:
                watch = quiet.Watch.start()
                given = {"file": str(file), "method": method}
                row = run_task("scaling_task", given | {"rounds": _ROUNDS, "options": _BARE})
                others.append(watch.others())
                rows.append(row | {"method": method, "noise": noise})
                say(f"scaling: {points} points, {dtype}, noise {noise:g}, {method}: {median(row['seconds']):.2f} s")
            if points != _LARGE:
                continue
            for method in (*targets.OWN, targets.AUTO):
                row = run_task("scaling_task", {"file": str(file), "method": method, "rounds": 1, "options": {}})
                whole.append(row | {"method": method, "noise": noise})
                say(f"scaling: {points} points, {dtype}, noise {noise:g}, {method}, with deviations")
    known = [value for value in others if value is not None]
    return {"rows": rows, "whole": whole, "others": max(known) if known else None, "threads": TIMED_THREADS}


def _find(values: dict[str, Any], points: int, noise: float, dtype: str, method: str) -> dict[str, Any]:
    wanted = (points, noise, dtype, method)
    return next(r for r in values["rows"] if (r["points"], r["noise"], r["dtype"], r["method"]) == wanted)


def _growth(values: dict[str, Any], noise: float, dtype: str, method: str) -> tuple[Check, Check]:
    small, large = (_find(values, points, noise, dtype, method) for points in (_SMALL, _LARGE))
    tracks = f"{noise_words(noise)}, {dtype}, `{method}`"
    time = median(large["seconds"]) / median(small["seconds"])
    iteration = median(large["iteration_seconds"]) / median(small["iteration_seconds"])
    return (
        Check(f"29,299 → 468,784 points, {tracks}: time", time, targets.SCALING_TIME, "×"),
        Check(f"29,299 → 468,784 points, {tracks}: time of an iteration", iteration, targets.SCALING_ITERATION, "×"),
    )


def _virtual(values: dict[str, Any], noise: float, dtype: str) -> str:
    """What the iteration works on at both ends, in words that follow the numbers."""
    small, large = (
        next(r for r in values["rows"] if (r["points"], r["noise"], r["dtype"]) == (points, noise, dtype))
        for points in (_SMALL, _LARGE)
    )
    before, after = small["virtual_points"], large["virtual_points"]
    grows = after > 1.05 * before
    tracks = f"{noise_words(noise)}, {dtype}"
    why = "denser sampling lifts more directions above the noise, and an iteration costs that much more"
    return f"- {tracks}: {before:,} → {after:,} virtual points" + (
        f" (×{after / before:.2f}): {why}." if grows else "."
    )


def _memory(row: dict[str, Any]) -> Check:
    tracks = f"{noise_words(row['noise'])}, {row['dtype']}, `{row['method']}`"
    ratio = row["peak_bytes"] / row["input_bytes"]
    what = f"{row['points']:,} points, {tracks}: peak memory of the whole process / input"
    return Check(what, ratio, targets.SCALING_MEMORY, "×")


def _ends() -> list[tuple[float, str, str]]:
    kinds = ((0.0, "float32"), *_EXTRA)
    return [(noise, dtype, method) for noise, dtype in kinds for method in targets.OWN]


def checks(values: dict[str, Any]) -> list[Check]:
    """Growth of time and of an iteration, and memory at the largest size."""
    grown = [check for end in _ends() for check in _growth(values, *end)]
    large = [row for row in values["rows"] if row["points"] == _LARGE]
    return grown + [_memory(row) for row in large]


def render(values: dict[str, Any]) -> list[str]:
    """Growth between the ends, then every row."""
    lines = [
        f"The surface of `{_SEQUENCE}` sampled more and more densely, 99 frames, cameras estimated, defaults but for "
        "`deviation=False`, "
        f"{values['threads']} threads, each measurement in a process of its own: medians of {_ROUNDS} runs; memory is "
        "the peak of the whole process after the first run, with the interpreter, the libraries, the input and the "
        f"float32 result. 'Not at all' for the iteration is taken as at most {targets.SCALING_ITERATION:g}×. "
        + quiet.sentence(values["others"]),
        "",
    ]
    rows = []
    for noise, dtype, method in _ends():
        time, iteration = _growth(values, noise, dtype, method)
        memory = _memory(_find(values, _LARGE, noise, dtype, method))
        what = f"{noise_words(noise)}, {dtype}"
        rows.append([what, f"`{method}`", time.cell(), iteration.cell(), memory.cell()])
    lines += ["**From 29,299 to 468,784 points**", ""]
    lines += table(["", "method", "time", "time of an iteration", "peak memory / input, at 468,784"], rows)
    lines += [_virtual(values, noise, dtype) for noise, dtype in dict.fromkeys((n, d) for n, d, _ in _ends())]
    lines += ["", *_with_deviations(values)]
    rows = []
    for row in sorted(values["rows"], key=lambda r: (r["method"], r["noise"], r["dtype"], r["points"])):
        above = row["peak_bytes"] - row["baseline_bytes"]
        rows.append(
            [
                f"{row['points']:,}",
                f"{noise_words(row['noise'])}, {row['dtype']}",
                f"`{row['method']}`",
                f"{median(row['seconds']):.2f}",
                f"{1e3 * median(row['iteration_seconds']):.2f}",
                str(row["iterations"]),
                f"{row['virtual_points']:,}",
                amount(row["input_bytes"] / 2**20),
                amount(row["peak_bytes"] / 2**20),
                amount(above / 2**20),
                f"{above / row['input_bytes']:.2f}",
            ]
        )
    head = ["points", "tracks", "method", "seconds", "ms per iteration", "iterations", "virtual points"]
    head += ["input, MiB", "peak, MiB", "peak above interpreter and imports, MiB", "the same / input"]
    lines += ["**Every measurement**", ""]
    return lines + table(head, rows)


def _with_deviations(values: dict[str, Any]) -> list[str]:
    """What the defaults take, standard deviations of the depths included, at the largest size."""
    rows = [
        [
            f"{noise_words(row['noise'])}, {row['dtype']}",
            f"`{row['method']}`",
            f"{row['seconds'][0]:.2f}",
            f"{row['peak_bytes'] / row['input_bytes']:.2f}",
            amount(row["peak_bytes"] / 2**20),
        ]
        for row in values.get("whole", [])
    ]
    if not rows:
        return []
    lines = [
        f"**All defaults, with the float32 standard deviations of every depth, at {_LARGE:,} points**, one run",
        "",
    ]
    return lines + table(["", "method", "seconds", "peak memory / input", "peak, MiB"], rows)
