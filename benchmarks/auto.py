"""Accuracy of the default method, beside Algorithms 1 and 2, cameras estimated, on dense, sparse and real tracks."""

from __future__ import annotations

from statistics import mean
from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import Check, degrees, error, noise_words, table
from benchmarks.tracks import WITHOUT_TRUTH, Data

TITLE = "Accuracy of the default method"
METHODS = (targets.AUTO, *targets.OWN)
_NOISES = (0.0, targets.NOISE)
_REAL = (Data("back_real126"), Data("back_real245"), Data("back_real245", damage=WITHOUT_TRUTH))
_CAMERA_FRAME = ("dance", "shark")  # one has a camera that stands still, the other a truth in its camera's frame
Records = dict[str, dict[str, Any]]


def _dense(sequence: str, noise: float, method: str) -> list[Case]:
    """The runs that one number is the mean of: seeds of the noise, or of the solver where there is none."""
    if noise:
        return [Case(Data(sequence, noise, seed), method, "estimated") for seed in targets.SEEDS]
    seeds = targets.SEEDS if method == targets.AUTO else targets.SEEDS[:1]
    return [Case(Data(sequence), method, "estimated", (("seed", seed),) if seed else ()) for seed in seeds]


def _sparse(sequence: str, method: str) -> Case:
    return Case(Data(sequence), method, "estimated")


def _measures(case: Case) -> tuple[str, ...]:
    sequence, dense = case.data.sequence, ("per_frame", "global", "rotation")
    if sequence in targets.AUTO_REAL:
        return ("similarity", "counts")
    if sequence in targets.AUTO_MOCAP:
        return (*dense, "camera_frame")
    return (*dense, "calibration") if case.method == targets.AUTO and case.data.seed == 0 else dense


def measure(context: Context) -> dict[str, Any]:
    """Dense sequences with every noise and seed, motion capture, and the real video."""
    long = sorted(targets.SEQUENCES, key=lambda name: name[-1] in "12")
    cases = [_sparse(s, m) for s in sorted(targets.AUTO_MOCAP, key=lambda s: s != "drink") for m in METHODS]
    cases += [Case(data, m, "estimated") for data in _REAL for m in METHODS]
    cases += [case for s in long for noise in _NOISES for m in METHODS for case in _dense(s, noise, m)]
    return run_cases("auto", cases, _measures, context, borrow=("accuracy", "calibration"))


def _mean(records: Records, sequence: str, noise: float, method: str, name: str) -> float | None:
    """Mean over the seeds of one number, or None where a run failed or is missing."""
    found = [records.get(case.key, {}).get(name) for case in _dense(sequence, noise, method)]
    known = [value for value in found if value is not None]
    return mean(known) if len(known) == len(found) else None


def _five(records: Records, noise: float, method: str, name: str = "per_frame") -> list[float | None]:
    """One number for each of the dense sequences, then their mean."""
    values = [_mean(records, sequence, noise, method, name) for sequence in targets.SEQUENCES]
    known = [value for value in values if value is not None]
    return [*values, mean(known) if len(known) == len(values) else None]


def _dense_checks(records: Records, noise: float) -> list[Check]:
    limits = (*targets.AUTO_ACCURACY[noise], targets.AUTO_MEAN[noise])
    names = (*map(targets.marked, targets.SEQUENCES), "mean of the five")
    values = _five(records, noise, targets.AUTO)
    return [
        Check(f"`{targets.AUTO}`, {noise_words(noise)}: {name}", value, limit)
        for name, value, limit in zip(names, values, limits, strict=True)
    ]


def _frame(sequence: str) -> str:
    return "camera_frame" if sequence in _CAMERA_FRAME else "global"


def _mocap_checks(records: Records) -> list[Check]:
    return [
        Check(
            f"`{targets.AUTO}`, {targets.marked(sequence)}, one alignment in the "
            f"{'camera' if sequence in _CAMERA_FRAME else 'object'} frame",
            records.get(_sparse(sequence, targets.AUTO).key, {}).get(_frame(sequence)),
            limit,
        )
        for sequence, limit in targets.AUTO_MOCAP.items()
    ]


def _what(data: Data) -> str:
    return f"{targets.marked(data.sequence)}{', entries without truth hidden' if data.damage else ''}"


def _real_checks(records: Records) -> list[Check]:
    return [
        Check(
            f"`{targets.AUTO}`, {_what(data)}, similarity per frame",
            records.get(Case(data, targets.AUTO, "estimated").key, {}).get("similarity"),
            targets.AUTO_REAL[data.sequence],
        )
        for data in _REAL
    ]


def checks(values: dict[str, Any]) -> list[Check]:
    """Dense sequences and their mean, motion capture, the real video."""
    records: Records = values["records"]
    dense = [check for noise in _NOISES for check in _dense_checks(records, noise)]
    return [*dense, *_mocap_checks(records), *_real_checks(records)]


def render(values: dict[str, Any]) -> list[str]:
    """The targets beside Algorithms 1 and 2, then errors after one alignment and of the cameras."""
    records: Records = values["records"]
    last = targets.SEEDS[-1]
    tuned = ", ".join(targets.TUNED) or "none"
    lines = [
        f"Cameras estimated, no option set. Sequences marked 'tuned' ({tuned}) were looked at while it was made; "
        "all others are held out.",
        "",
        'e3D with each frame aligned by an orthogonal matrix of its own (`align="per-frame"`), all points. With noise '
        f"(Gaussian, σ = 3% of max|W|) the mean over seeds 0 to {last} of the noise; clean, over seeds 0 to {last} of "
        f"`{targets.AUTO}` itself.",
        "",
    ]
    head = ["tracks", "method", *map(targets.marked, targets.SEQUENCES), "mean"]
    rows = []
    for noise in _NOISES:
        rows.append(
            [noise_words(noise), f"`{targets.AUTO}`", *(check.cell() for check in _dense_checks(records, noise))]
        )
        rows += [
            [noise_words(noise), f"`{method}`", *map(error, _five(records, noise, method))] for method in targets.OWN
        ]
    lines += [*table(head, rows), *_spread(records)]
    for name, title, text in (
        ("global", "One alignment for the sequence** (object frame; errors of the cameras count too)**", error),
        ("rotation", "Error of the cameras** (mean angle after one common alignment)**", degrees),
    ):
        rows = [
            [noise_words(noise), f"`{method}`", *map(text, _five(records, noise, method, name))]
            for noise in _NOISES
            for method in METHODS
        ]
        lines += [f"**{title}**".replace("****", ""), "", *table(head, rows)]
    return [*lines, *_mocap_lines(records), *_real_lines(records)]


def _spread(records: Records) -> list[str]:
    """How far the clean results of different solver seeds are apart."""
    gaps = []
    for sequence in targets.SEQUENCES:
        found = [records.get(case.key, {}).get("per_frame") for case in _dense(sequence, 0.0, targets.AUTO)]
        known = [value for value in found if value is not None]
        if len(known) > 1:
            gaps.append((max(known) - min(known), sequence))
    if not gaps:
        return []
    gap, sequence = max(gaps)
    return [f"Clean, the seeds of the method are at most {error(gap)} apart ({sequence}).", ""]


def _mocap_lines(records: Records) -> list[str]:
    lines = [
        "**Motion capture**, one orthogonal alignment for the whole sequence: of the shapes in the object frame for "
        "pickup, yoga, stretch and drink. The stored camera of dance does not turn and the truth of shark is given in "
        "its camera's frame, so a turn of the object cannot be told from one of the camera: for these the shapes are "
        "compared as the cameras see them.",
        "",
    ]
    rows = [["`auto`", *(check.cell() for check in _mocap_checks(records))]]
    for method in targets.OWN:
        found = [(records.get(_sparse(s, method).key, {}), _frame(s)) for s in targets.AUTO_MOCAP]
        rows.append([f"`{method}`", *(error(record.get(name)) for record, name in found)])
    for method in METHODS:
        found = [(records.get(_sparse(s, method).key, {}), "per_frame") for s in targets.AUTO_MOCAP]
        rows.append([f"`{method}`, each frame on its own", *(error(record.get(name)) for record, name in found)])
    return lines + table(["", *map(targets.marked, targets.AUTO_MOCAP)], rows)


def _real_lines(records: Records) -> list[str]:
    lines = [
        "**Tracks from a real video**, one similarity per frame. Only entries whose truth is known and points that "
        "were reconstructed are scored. The tracks of back_real245 are complete as stored, its truth is not; in the "
        "last row the entries without truth are hidden from the methods too.",
        "",
    ]
    rows = []
    for data, check in zip(_REAL, _real_checks(records), strict=True):
        found = [records.get(Case(data, method, "estimated").key, {}) for method in METHODS]
        counts = found[0].get("counts")
        rows.append(
            [
                _what(data),
                check.cell(),
                *(error(record.get("similarity")) for record in found[1:]),
                f"{counts['reconstructed']} of {counts['points']}" if counts else "–",
                f"{counts['seen']:,} of {counts['entries']:,}" if counts else "–",
                f"{counts['scored']:,} of {counts['valid']:,}" if counts else "–",
                "yes" if found[0].get("undone") else "no",
            ]
        )
    head = ["", *(f"`{method}`" for method in METHODS), "points reconstructed", "entries seen"]
    return lines + table([*head, "entries scored of those with truth", "perspective undone"], rows)
