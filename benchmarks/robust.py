"""What missing entries, outliers and drift cost the default method on the entries that are left."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import Check, amount, error, noise_words, table
from benchmarks.tracks import BACK, DRIFT, OCCLUDED, OUTLIERS, RANDOM, Data

TITLE = "Missing entries, outliers and drift"
SEQUENCES = ("face-seq3", "face-seq4", "ict-rom99")
NOISES = (0.0, 0.01, targets.NOISE)
DAMAGES = (
    "",
    f"30% {OCCLUDED}",
    f"30% {BACK}",
    f"50% {RANDOM}",
    f"5% {OUTLIERS}",
    f"10% {OUTLIERS}",
    f"5% {DRIFT}",
)
_SEED = 0


def _case(sequence: str, noise: float, damage: str) -> Case:
    return Case(Data(sequence, noise, _SEED, damage=damage), targets.AUTO, "estimated")


def measure(context: Context) -> dict[str, Any]:
    """Every sequence, noise and damage, at full density."""
    cases = [_case(s, noise, damage) for s in SEQUENCES for noise in NOISES for damage in DAMAGES]
    return run_cases("robust", cases, ("robust",), context)


def _record(values: dict[str, Any], sequence: str, noise: float, damage: str) -> dict[str, Any]:
    record: dict[str, Any] = values["records"].get(_case(sequence, noise, damage).key, {})
    return record


def _ratio(values: dict[str, Any], sequence: str, noise: float, damage: str) -> float | None:
    found = _record(values, sequence, noise, damage).get("robust") or {}
    own, complete = found.get("error"), found.get("complete")
    return None if own is None or complete is None else own / max(complete, 1e-12)


def _check(values: dict[str, Any], sequence: str, noise: float, damage: str) -> Check:
    tracks = noise_words(noise)
    what = f"{targets.marked(sequence)}, {tracks}, {damage}: error / that with complete tracks"
    return Check(what, _ratio(values, sequence, noise, damage), targets.ROBUST[damage], "×")


def checks(values: dict[str, Any]) -> list[Check]:
    """The damages that have a target, with and without noise."""
    return [_check(values, s, noise, damage) for s in SEQUENCES for noise in NOISES for damage in targets.ROBUST]


def render(values: dict[str, Any]) -> list[str]:
    """One table for each sequence."""
    lines = [
        f"`{targets.AUTO}` at full density, no option set, seed {_SEED}. Error: each frame aligned on its own, only "
        "entries that were seen and are right, against the truth; 'undamaged': the same entries reconstructed from "
        "complete tracks. 'Hidden': the entries that were missing or wrong, then the same ones from complete tracks; "
        "no target speaks of them. Precision and recall: of the entries taken for wrong (confidence below ½), among "
        "points that are reconstructed. In brackets: the share of what was seen that falls on points not "
        "reconstructed. The errors of clean tracks are so small that a ratio says little: the "
        "absolute errors, and tracks with 1% noise, are beside them.",
        "",
    ]
    head = ["tracks", "damage", "error", "undamaged", "ratio", "hidden", "hidden, undamaged", "precision", "recall"]
    head += ["taken for wrong", "points not reconstructed", "seconds"]
    for sequence in SEQUENCES:
        rows = [_row(values, sequence, noise, damage) for noise in NOISES for damage in DAMAGES]
        lines += [f"**{targets.marked(sequence)}**", "", *table(head, rows)]
    return [*lines, "Seconds with one thread, other runs beside it.", ""]


def _row(values: dict[str, Any], sequence: str, noise: float, damage: str) -> list[str]:
    record = _record(values, sequence, noise, damage)
    tracks = noise_words(noise)
    if "error" in record:
        return [tracks, damage or "none", f"failed: {record['error']}", *[""] * 9]
    found = record.get("robust") or {}
    ratio = _ratio(values, sequence, noise, damage)
    if damage in targets.ROBUST:
        cell = _check(values, sequence, noise, damage).cell()
    else:
        cell = "–" if ratio is None or not damage else f"{ratio:.3f}×"
    return [
        tracks,
        damage or "none",
        error(found.get("error")),
        error(found.get("complete")) if damage else "–",
        cell,
        error(found.get("hidden")),
        error(found.get("hidden_complete")) if damage else "–",
        _share(found.get("precision")),
        _share(found.get("recall")),
        _share(found.get("accused")),
        _lost(found),
        amount(record.get("seconds")),
    ]


def _lost(found: dict[str, Any]) -> str:
    """Points without a shape, and how much of what was seen they are."""
    if not found.get("not_reconstructed"):
        return _share(found.get("not_reconstructed"))
    return f"{_share(found['not_reconstructed'])} ({_share(found.get('seen_of_these'))})"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.3g}%"
