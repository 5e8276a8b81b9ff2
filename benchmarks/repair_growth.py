"""How the time of repair grows with the number of points on the same surface."""

from __future__ import annotations

from statistics import median
from typing import Any

from benchmarks import quiet, targets
from benchmarks.children import TIMED_THREADS, run_task
from benchmarks.store import Context, data_folder, say
from benchmarks.tables import Check, amount, noise_words, table
from benchmarks.tracks import OCCLUDED, OUTLIERS

TITLE = "Growth of repair with the number of points"
_SEQUENCE = "face-seq3"
_METHOD = "geometry-aware"  # what follows repair is short beside it
_SIZES = (7_325, 29_299, 117_196)
_ROUNDS = 1
_KINDS = ((0.0, f"30% {OCCLUDED}"), (targets.NOISE, f"30% {OCCLUDED}"), (targets.NOISE, f"10% {OUTLIERS}"))


def measure(context: Context) -> dict[str, Any]:
    """Every size and kind of damage, each in a process of its own."""
    data_folder()
    rows: list[dict[str, Any]] = []
    others = []
    for noise, damage in _KINDS:
        for points in _SIZES:
            watch = quiet.Watch.start()
            given = {"sequence": _SEQUENCE, "points": points, "noise": noise, "damage": damage}
            row = run_task("repair_growth_task", given | {"method": _METHOD, "rounds": _ROUNDS})
            others.append(watch.others())
            rows.append(row | given)
            say(f"repair-growth: {points} points, noise {noise:g}, {damage}: {_seconds(row):.2f} s")
    known = [value for value in others if value is not None]
    return {"rows": rows, "others": max(known) if known else None, "threads": TIMED_THREADS}


def _seconds(row: dict[str, Any]) -> float:
    return float(median(found["repair"] + found["resection"] for found in row["rounds"]))


def _row(values: dict[str, Any], points: int, noise: float, damage: str) -> dict[str, Any]:
    return next(r for r in values["rows"] if (r["points"], r["noise"], r["damage"]) == (points, noise, damage))


def _words(noise: float, damage: str) -> str:
    return f"{noise_words(noise)}, {damage}"


def _check(values: dict[str, Any], noise: float, damage: str) -> Check:
    small, large = _SIZES[-2:]
    ratio = _seconds(_row(values, large, noise, damage)) / _seconds(_row(values, small, noise, damage))
    return Check(f"{small:,} → {large:,} points, {_words(noise, damage)}: time of repair", ratio, _limit(), "×")


def _limit() -> float:
    return targets.REPAIR_GROWTH * _SIZES[-1] / _SIZES[-2]


def checks(values: dict[str, Any]) -> list[Check]:
    """Growth between the two larger sizes."""
    return [_check(values, *kind) for kind in _KINDS]


def render(values: dict[str, Any]) -> list[str]:
    """Seconds at every size, and growth."""
    lines = [
        f"The surface of `{_SEQUENCE}` sampled more and more densely, 99 frames, damaged, `{_METHOD}`, cameras "
        f"estimated, {values['threads']} threads, each row in a process of its own: one run each. Repair "
        "is the finding of wrong entries, the completion, and the resection of what was not complete. Linear growth "
        f"would be ×{_SIZES[-1] / _SIZES[-2]:g} between the two larger sizes; {100 * (targets.REPAIR_GROWTH - 1):.0f}% "
        f"is left to the clock. {quiet.sentence(values['others'])}",
        "",
    ]
    rows = []
    for kind in _KINDS:
        found = [_row(values, points, *kind) for points in _SIZES]
        cells = [f"{_seconds(row):.2f} ({median(r['whole'] for r in row['rounds']):.2f})" for row in found]
        per_point = 1e6 * _seconds(found[-1]) / _SIZES[-1]
        rows.append([_words(*kind), *cells, amount(per_point), _check(values, *kind).cell()])
    head = ["tracks", *(f"{points:,} points, seconds of repair (whole run)" for points in _SIZES)]
    return lines + table([*head, "µs for a point at the largest", "growth"], rows)
