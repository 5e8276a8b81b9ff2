"""Seconds of the default method beside Algorithm 2, in the same process and rounds."""

from __future__ import annotations

from statistics import median
from typing import Any

from benchmarks import quiet, targets
from benchmarks.children import TIMED_THREADS, run_task
from benchmarks.store import Context, data_folder
from benchmarks.tables import Check, amount, noise_words, table

TITLE = "Speed of the default method"
_SEQUENCE = "face-seq3"
_ROUNDS = 3
_NOISES = (0.0, targets.NOISE)
_OTHER = "geometry-aware"
_METHODS = (targets.AUTO, _OTHER)


def measure(context: Context) -> dict[str, Any]:
    """Both methods in turn, end to end."""
    data_folder()
    watch = quiet.Watch.start()
    jobs = [(_SEQUENCE, noise) for noise in _NOISES]
    found = run_task("speed_task", {"methods": _METHODS, "rounds": _ROUNDS, "jobs": jobs, "svd": False})
    return {"runs": found["runs"], "others": watch.others(), "threads": TIMED_THREADS}


def _run(values: dict[str, Any], noise: float, method: str) -> dict[str, Any]:
    run: dict[str, Any] = values["runs"][f"{_SEQUENCE} {noise:g} {method}"]
    return run


def _check(values: dict[str, Any], noise: float) -> Check:
    own, other = (median(_run(values, noise, method)["seconds"]) for method in _METHODS)
    what = f"29,299 × 99, {noise_words(noise)}: time of `{targets.AUTO}` / time of `{_OTHER}`"
    return Check(what, own / other, targets.AUTO_TIME, "×")


def checks(values: dict[str, Any]) -> list[Check]:
    """Clean and noisy."""
    return [_check(values, noise) for noise in _NOISES]


def render(values: dict[str, Any]) -> list[str]:
    """Ratios, seconds, stages."""
    lines = [
        "`reconstruct` from tracks in memory to shapes and their deviations, cameras estimated, no option set, "
        f"{values['threads']} threads. Medians of {_ROUNDS} rounds in one process; each round runs everything once. "
        f"{quiet.sentence(values['others'])}",
        "",
    ]
    rows = []
    for noise in _NOISES:
        for method in _METHODS:
            run = _run(values, noise, method)
            seconds = run["seconds"]
            middle = sorted(range(len(seconds)), key=seconds.__getitem__)[len(seconds) // 2]
            rows.append(
                [
                    noise_words(noise),
                    f"`{method}`",
                    _check(values, noise).cell() if method == targets.AUTO else "",
                    f"{median(seconds):.2f} ({min(seconds):.2f} to {max(seconds):.2f})",
                    str(run["iterations"]),
                    ", ".join(f"{name} {amount(value)}" for name, value in run["stages"][middle].items()),
                ]
            )
    head = ["tracks", "method", f"ratio to `{_OTHER}`", "seconds (least to most)", "iterations", "stages, seconds"]
    return lines + table(head, rows)
