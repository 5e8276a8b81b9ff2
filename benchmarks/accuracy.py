"""Shape errors on the five dense sequences, known and estimated cameras, clean and with 3% noise."""

from __future__ import annotations

from collections.abc import Callable
from statistics import mean
from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import Check, degrees, error, noise_words, table
from benchmarks.tracks import Data

TITLE = "Accuracy of the published algorithms on dense sequences"
_MEASURES = ("per_frame", "global", "rotation")
Records = dict[str, dict[str, Any]]


def _data(sequence: str, noise: float) -> list[Data]:
    return [Data(sequence, noise, seed) for seed in targets.SEEDS] if noise else [Data(sequence)]


def measure(context: Context) -> dict[str, Any]:
    """Every sequence, noise and seed, with every method and both kinds of cameras."""
    # The long sequences first, so that two processes end at about the same time.
    cases = [
        Case(data, method, cameras)
        for sequence in sorted(targets.SEQUENCES, key=lambda name: name[-1] in "12")
        for noise in (0.0, targets.NOISE)
        for data in _data(sequence, noise)
        for method in targets.METHODS
        for cameras in ("known", "estimated")
    ]
    return run_cases("accuracy", cases, _MEASURES, context, borrow=("auto",))


def _mean(records: Records, sequence: str, noise: float, cameras: str, method: str, name: str) -> float | None:
    """Mean over the seeds of one number, or None where a run failed or is missing."""
    found = [records.get(Case(data, method, cameras).key, {}).get(name) for data in _data(sequence, noise)]
    known = [value for value in found if value is not None]
    return mean(known) if len(known) == len(found) else None


def _cell(records: Records, row: targets.Row, sequence: str, limit: float) -> Check:
    values = [_mean(records, sequence, row.noise, row.cameras, method, "per_frame") for method in row.methods]
    found = [value for value in values if value is not None]
    return Check(f"{row.title}: {sequence}", min(found) if found else None, limit)


def checks(values: dict[str, Any]) -> list[Check]:
    """Every cell of the table of targets."""
    return [
        _cell(values["records"], row, sequence, limit)
        for row in targets.ACCURACY
        for sequence, limit in zip(targets.SEQUENCES, row.limits, strict=True)
    ]


def render(values: dict[str, Any]) -> list[str]:
    """The table of targets, then each method under each condition."""
    records: Records = values["records"]
    cells = iter(checks(values))
    lines = [
        'e3D with each frame aligned by an orthogonal matrix of its own (`align="per-frame"`); with noise, the mean '
        f"over seeds {targets.SEEDS[0]} to {targets.SEEDS[-1]}. The noise is Gaussian with σ = 3% of max|W|, the rows "
        "of W centred. One set of defaults for every cell; 'two' are `grassmann` and `geometry-aware`.",
        "",
    ]
    lines += table(
        ["", *targets.SEQUENCES],
        [[row.title, *(next(cells).cell() for _ in targets.SEQUENCES)] for row in targets.ACCURACY],
    )
    views: list[tuple[str, str, str, Callable[[float | None], str]]] = [
        ("per_frame", "Each frame aligned on its own", "", error),
        (
            "global",
            "One alignment for the sequence",
            "object frame; with estimated cameras their error counts too",
            error,
        ),
        ("rotation", "Error of the estimated cameras", "mean angle after one common alignment", degrees),
    ]
    for name, title, remark, text in views:
        rows = []
        for cameras in ("known", "estimated") if name != "rotation" else ("estimated",):
            for noise in (0.0, targets.NOISE):
                for method in targets.METHODS if name != "rotation" else targets.METHODS[:1]:
                    numbers = (_mean(records, s, noise, cameras, method, name) for s in targets.SEQUENCES)
                    what = f"{cameras}, {noise_words(noise)}"
                    rows.append([what, f"`{method}`" if name != "rotation" else "any", *map(text, numbers)])
        lines += [f"**{title}**{' (' + remark + ')' if remark else ''}", ""]
        lines += table(["cameras, tracks", "method", *targets.SEQUENCES], rows)
    return lines
