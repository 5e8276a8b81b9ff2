"""Whether the standard deviations of the depths are right: the shares of errors within one and two of them."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context
from benchmarks.tables import amount, noise_words, table
from benchmarks.tracks import Data

TITLE = "Standard deviation of depth"
SEQUENCES = (*targets.SEQUENCES, "mesh_horse_gallop")
_NOISES = (0.0, targets.NOISE)


def _case(sequence: str, noise: float) -> Case:
    return Case(Data(sequence, noise), targets.AUTO, "estimated")


def measure(context: Context) -> dict[str, Any]:
    """Every mesh, clean and with noise, at full density."""
    cases = [_case(sequence, noise) for sequence in SEQUENCES for noise in _NOISES]
    return run_cases("calibration", cases, ("per_frame", "global", "rotation", "calibration"), context, ("auto",))


def checks(values: dict[str, Any]) -> list[Any]:
    """None: there is no target."""
    return []


def render(values: dict[str, Any]) -> list[str]:
    """Shares, and the sizes of errors and deviations."""
    lines = [
        f"`{targets.AUTO}`, all points and frames, cameras estimated, seed 0. Depths are compared in the frames of "
        "their own cameras, the true ones in those of the true cameras, so that errors of the cameras count. "
        "Calibrated normal errors would give 68.3% and 95.4%, and equal root mean squares."
        "",
    ]
    rows = []
    for sequence in SEQUENCES:
        for noise in _NOISES:
            record = values["records"].get(_case(sequence, noise).key, {})
            found = record.get("calibration")
            tracks = noise_words(noise)
            if not found:
                rows.append([targets.marked(sequence), tracks, record.get("error", "not measured"), "", "", ""])
                continue
            rows.append(
                [
                    targets.marked(sequence),
                    tracks,
                    f"{100 * found['within_1']:.1f}%",
                    f"{100 * found['within_2']:.1f}%",
                    f"{found['deviation_rms'] / max(found['error_rms'], 1e-300):.2f}",
                    f"{amount(found['error_rms'])}",
                ]
            )
    head = ["", "tracks", "within 1 deviation", "within 2", "rms deviation / rms error"]
    return lines + table([*head, "rms error, unit of the data"], rows)
