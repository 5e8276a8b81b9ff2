"""Seconds of a whole reconstruction, beside one dense SVD in the same process."""

from __future__ import annotations

from statistics import median
from typing import Any

from benchmarks import quiet, targets
from benchmarks.children import TIMED_THREADS, run_task
from benchmarks.store import Context, data_folder
from benchmarks.tables import Check, Fact, amount, noise_words, table

TITLE = "Speed"
_LONG, _SHORT = "face-seq3", ("face-seq1", "face-seq2")
_ROUNDS = 3
_NOISES = (0.0, targets.NOISE)


def measure(context: Context) -> dict[str, Any]:
    """29,299 × 99 interleaved with the SVD, then 29,299 × 10."""
    data_folder()
    settings = {"methods": targets.METHODS, "rounds": _ROUNDS}
    watch = quiet.Watch.start()
    long = run_task("speed_task", settings | {"jobs": [(_LONG, n) for n in _NOISES], "svd": True})
    short = run_task("speed_task", settings | {"jobs": [(s, n) for s in _SHORT for n in _NOISES], "svd": False})
    return {"long": long, "short": short, "others": watch.others(), "threads": TIMED_THREADS}


def _key(sequence: str, noise: float, method: str) -> str:
    return f"{sequence} {noise:g} {method}"


def _ratio(values: dict[str, Any], noise: float, method: str) -> Check:
    run = values["long"]["runs"][_key(_LONG, noise, method)]
    ratio = median(run["seconds"]) / median(values["long"]["svd"])
    what = f"29,299 × 99, {noise_words(noise)}, `{method}`: time of one dense SVD"
    return Check(what, ratio, targets.SPEED_RATIO, "×")


def _seconds(values: dict[str, Any], sequence: str, noise: float, method: str) -> Check:
    run = values["short"]["runs"][_key(sequence, noise, method)]
    what = f"29,299 × 10 ({sequence}), {noise_words(noise)}, `{method}`"
    return Check(what, median(run["seconds"]), targets.SPEED_SHORT, " s")


def _cells(values: dict[str, Any]) -> Fact:
    found = [values["long"]["runs"][_key(_LONG, n, m)]["cells"] for n in _NOISES for m in targets.OWN]
    text = f"{min(found)} cells" if min(found) == max(found) else f"{min(found)} to {max(found)} cells"
    return Fact(f"at least {targets.SPEED_CELLS} cells in the timed runs", min(found) >= targets.SPEED_CELLS, text)


def checks(values: dict[str, Any]) -> list[Check | Fact]:
    """Ratios, the number of cells, and the short sequences."""
    ratios = [_ratio(values, noise, method) for noise in _NOISES for method in targets.METHODS]
    short = [_seconds(values, s, n, m) for s in _SHORT for n in _NOISES for m in targets.METHODS]
    return [*ratios, _cells(values), *short]


def render(values: dict[str, Any]) -> list[str]:
    """Ratios, seconds, stages."""
    svd = values["long"]["svd"]
    lines = [
        f"`reconstruct` from tracks in memory to shapes, cameras estimated, all options at their defaults "
        f"({_cells(values).cell()}), {values['threads']} threads. Medians of {_ROUNDS} rounds in one process; each "
        f"round runs everything once. The yardstick is `numpy.linalg.svd(A, full_matrices=False)` of a random "
        f"297 × 29,299 float64 matrix in the same rounds: {_span(svd)}. {quiet.sentence(values['others'])}",
        "",
    ]
    rows = [
        [
            noise_words(noise),
            f"`{method}`",
            _ratio(values, noise, method).cell(),
            f"{min(values['long']['runs'][_key(_LONG, noise, method)]['seconds']) / min(svd):.2f}×",
            *_details(values["long"], _LONG, noise, method),
        ]
        for noise in _NOISES
        for method in targets.METHODS
    ]
    lines += ["**29,299 points, 99 frames**", ""]
    lines += table(
        [
            "tracks",
            "method",
            "ratio to the SVD",
            "ratio of the least times",
            "seconds (least to most)",
            "iterations",
            "stages, seconds",
        ],
        rows,
    )
    rows = [
        [
            sequence,
            noise_words(noise),
            f"`{method}`",
            _seconds(values, sequence, noise, method).cell(),
            *_details(values["short"], sequence, noise, method),
        ]
        for sequence in _SHORT
        for noise in _NOISES
        for method in targets.METHODS
    ]
    lines += ["**29,299 points, 10 frames**", ""]
    head = ["", "tracks", "method", "median", "seconds (least to most)", "iterations", "stages, seconds"]
    lines += table(head, rows)
    lines += ["The published MATLAB takes about 900 s for the 99 frames and 150 s for the 10, on another machine.", ""]
    return lines


def _span(seconds: list[float]) -> str:
    return f"{median(seconds):.2f} s ({min(seconds):.2f} to {max(seconds):.2f})"


def _details(part: dict[str, Any], sequence: str, noise: float, method: str) -> list[str]:
    run = part["runs"][_key(sequence, noise, method)]
    middle = sorted(range(_ROUNDS), key=run["seconds"].__getitem__)[_ROUNDS // 2]
    stages = ", ".join(f"{name} {amount(seconds)}" for name, seconds in run["stages"][middle].items() if name != method)
    own = run["stages"][middle].get(method)
    return [_span(run["seconds"]), str(run["iterations"]), f"{stages}, method {amount(own)}"]
