"""What each part of the default method is worth: switched off one at a time."""

from __future__ import annotations

import dataclasses
from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import amount, error, noise_words, table
from benchmarks.tracks import Data

TITLE = "Parts of the default method switched off"
SEQUENCES = ("face-seq1", "face-seq3", "face-seq4", "ict-rom99", "pickup", "stretch", "dance", "back_real126")
_POINTS = 2_000
_NOISES = (0.0, targets.NOISE)
_SIMILARITY = ("back_real126",)
_STAGES: tuple[tuple[str, Any], ...] = (
    ("denoise", False),
    ("camera_method", "rigid"),
    ("camera_path", "free"),
    ("refine", False),
    ("gauge", "method"),
    ("perspective", "off"),
    ("outliers", False),
)
Option = tuple[str, Any]


def switches() -> list[Option | None]:
    """None for the default, then every part of the method that can be switched off, then parts of the stages."""
    from nrsfm.methods import get_method

    fields = dataclasses.fields(get_method(targets.AUTO).Options)
    own: list[Option] = [(field.name, False) for field in fields if field.default is True]
    return [None, *own, *_STAGES]


def _case(sequence: str, noise: float, switch: Option | None) -> Case:
    data = Data(sequence, noise, 0, points=_POINTS)
    return Case(data, targets.AUTO, "estimated", () if switch is None else (switch,))


def _name(sequence: str) -> str:
    return "similarity" if sequence in _SIMILARITY else "per_frame"


def measure(context: Context) -> dict[str, Any]:
    """Every sequence, clean and noisy, with every switch."""
    order = sorted(SEQUENCES, key=lambda name: name not in _SIMILARITY)
    cases = [_case(sequence, noise, switch) for sequence in order for noise in _NOISES for switch in switches()]

    def measures(case: Case) -> tuple[str, ...]:
        name = _name(case.data.sequence)
        return (name, "global") if name == "per_frame" else (name,)

    return run_cases("auto-ablation", cases, measures, context, borrow=("never-worse",))


def checks(values: dict[str, Any]) -> list[Any]:
    """None: there is no target."""
    return []


def render(values: dict[str, Any]) -> list[str]:
    """Errors with each part off, clean and noisy, then after one alignment for the gauge's sake."""
    records = values["records"]
    lines = [
        f"`{targets.AUTO}` with one part off at a time, cameras estimated, at most {_POINTS:,} points, seed 0. "
        "Each frame aligned on its own (back_real126: by a similarity), in bold where leaving the part out changes "
        "the error by more than 2%. 'Seconds' are sums over the sequences, with one thread and other runs beside.",
        "",
    ]
    for noise in _NOISES:
        rows = [_row(records, noise, switch) for switch in switches()]
        lines += [f"**{100 * noise:g}% noise**" if noise else "**Clean**", ""]
        lines += table(["off", *map(targets.marked, SEQUENCES), "seconds"], rows)
    rows = []
    for noise in _NOISES:
        for switch in (None, ("gauge", "method"), ("camera_method", "rigid"), ("camera_path", "free")):
            found = [records.get(_case(s, noise, switch).key, {}).get("global") for s in SEQUENCES]
            rows.append([noise_words(noise), _title(switch), *map(error, found)])
    lines += ["**One alignment for the sequence**, which feels the object frame and the cameras", ""]
    return lines + table(["tracks", "off", *map(targets.marked, SEQUENCES)], rows)


def _title(switch: Option | None) -> str:
    return "nothing" if switch is None else f"`{switch[0]}={switch[1]}`"


def _row(records: dict[str, Any], noise: float, switch: Option | None) -> list[str]:
    cells, seconds = [], 0.0
    for sequence in SEQUENCES:
        record = records.get(_case(sequence, noise, switch).key, {})
        value = record.get(_name(sequence))
        whole = records.get(_case(sequence, noise, None).key, {}).get(_name(sequence))
        text = "failed" if "error" in record else error(value)
        changed = value is not None and whole and abs(value / whole - 1) > 0.02
        cells.append(f"**{text}**" if changed else text)
        seconds += record.get("seconds", 0.0)
    return [_title(switch), *cells, amount(seconds)]
