"""The default method beside the better of Algorithms 1 and 2, on every sequence, with more and more noise."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import Check, amount, error, table
from benchmarks.tracks import Data

TITLE = "Never worse than Algorithms 1 and 2"
POINTS = 2_000
NOISES = (0.0, 0.01, 0.03, 0.05)
_SEED = 0
_METHODS = (targets.AUTO, *targets.OWN)
_PERSPECTIVE = ("back_real126", "back_real245", "mat1500_persp", "flag250_persp", "hulk_persp")
SEQUENCES = (
    *targets.SEQUENCES,
    "ict-rom346",
    "mesh_horse_gallop",
    "pickup",
    "yoga",
    "stretch",
    "drink",
    "dance",
    "walking",
    "shark",
    "face1",
    *_PERSPECTIVE,
)
_SLOW = ("drink", "pickup", "yoga", "stretch", "ict-rom346", "back_real245", "back_real126")


def _case(sequence: str, noise: float, method: str) -> Case:
    return Case(Data(sequence, noise, _SEED, points=POINTS), method, "estimated")


def measure(context: Context) -> dict[str, Any]:
    """Every sequence and noise with the three methods, those of many frames first."""
    order = sorted(SEQUENCES, key=lambda name: _SLOW.index(name) if name in _SLOW else len(_SLOW))
    cases = [_case(sequence, noise, method) for sequence in order for noise in NOISES for method in _METHODS]
    return run_cases("never-worse", cases, _measures, context, borrow=("auto-ablation",))


def _measures(case: Case) -> tuple[str, ...]:
    name = _measure(case.data.sequence)
    return (name, "global") if name == "per_frame" else (name,)


def _measure(sequence: str) -> str:
    return "similarity" if sequence in _PERSPECTIVE else "per_frame"


def _value(values: dict[str, Any], sequence: str, noise: float, method: str) -> float | None:
    value: float | None = values["records"].get(_case(sequence, noise, method).key, {}).get(_measure(sequence))
    return value


def _check(values: dict[str, Any], sequence: str, noise: float) -> Check:
    """How many times the error of the better of the two; None where one of the three is missing."""
    own = _value(values, sequence, noise, targets.AUTO)
    others = [_value(values, sequence, noise, method) for method in targets.OWN]
    known = [value for value in others if value is not None]
    ratio = own / max(min(known), 1e-12) if own is not None and len(known) == len(others) else None
    what = f"`{targets.AUTO}` / the better of two, {targets.marked(sequence)}, noise {100 * noise:g}%"
    return Check(what, ratio, targets.NEVER_WORSE, "×")


def checks(values: dict[str, Any]) -> list[Check]:
    """One ratio for every sequence and noise."""
    return [_check(values, sequence, noise) for sequence in SEQUENCES for noise in NOISES]


def render(values: dict[str, Any]) -> list[str]:
    """Ratios, then the errors behind them."""
    found = checks(values)
    ratios = [(check.value, check.what) for check in found if check.value is not None]
    tuned = [check for check in found if "(tuned)" in check.what]
    held = [check for check in found if "(tuned)" not in check.what]
    lines = [
        f"The error of `{targets.AUTO}` divided by the smaller one of `grassmann` and `geometry-aware`: cameras "
        f"estimated, no option set, seed {_SEED}. Each frame aligned on its own, under perspective "
        f"({', '.join(_PERSPECTIVE)}) by a similarity. Of dense sequences {POINTS:,} evenly spread points are taken, "
        "to keep it payable; the noise is Gaussian with σ in percent of max|W|. The two whole takes of some 4,000 "
        "frames and the video without point-to-point truth are left out.",
        "",
        f"Kept in {sum(check.passed for check in held)} of {len(held)} held-out cells and in "
        f"{sum(check.passed for check in tuned)} of {len(tuned)} tuned ones.",
        "",
    ]
    if ratios:
        worst, least = max(ratios), min(ratios)
        better = sum(ratio < 1 for ratio, _ in ratios)
        lines += [
            f"Better than both in {better} of {len(ratios)}; from {amount(least[0])}× ({_place(least[1])}) to "
            f"{amount(worst[0])}× ({_place(worst[1])}).",
            "",
        ]
    cells = iter(found)
    head = ["", *(f"noise {100 * noise:g}%" if noise else "clean" for noise in NOISES)]
    rows = [[targets.marked(s), *(_ratio(next(cells)) for _ in NOISES)] for s in SEQUENCES]
    lines += table(head, rows)
    names = ", ".join(f"`{method}`" for method in _METHODS)
    lines += [f"**Errors**: {names}", ""]
    return lines + table(
        head, [[targets.marked(s), *(_errors(values, s, noise) for noise in NOISES)] for s in SEQUENCES]
    )


def _place(what: str) -> str:
    return what.split(", ", 1)[1]


def _ratio(check: Check) -> str:
    return f"no number {check.mark}" if check.value is None else f"{check.value:.3f} {check.mark}"


def _errors(values: dict[str, Any], sequence: str, noise: float) -> str:
    return ", ".join(error(_value(values, sequence, noise, method)) for method in _METHODS)
