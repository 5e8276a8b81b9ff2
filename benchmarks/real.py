"""Tracks from a real video of a bending back, with everything automatic."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, run_cases
from benchmarks.store import Context, data_folder
from benchmarks.tables import Check, Fact, error, table
from benchmarks.tracks import Data

TITLE = "Tracks from a real video, published algorithms"
_SEQUENCE = "back_real126"
_CHECKED = "geometry-aware"
_MEASURES = ("similarity", "unreflected")
_MIRROR = (("mirror", True),)


def measure(context: Context) -> dict[str, Any]:
    """Every method, and each again with the other of the two mirror images."""
    if not _right_handed():
        raise ValueError(
            f"the true shapes of {_SEQUENCE} have left-handed axes: 'unreflected' would judge them wrongly"
        )
    cases = [
        Case(Data(_SEQUENCE), method, "estimated", options) for method in targets.METHODS for options in ((), _MIRROR)
    ]
    return run_cases("real", cases, _MEASURES, context)


def _right_handed() -> bool:
    """Whether the truth's axes are right-handed.

    The stored camera P (3×4) maps the truth to pixels, x right and y down, with positive depths up to one sign; its
    left 3×3 block then has a positive determinant exactly if the truth's axes are right-handed.
    """
    import numpy as np

    from nrsfm import datasets

    sequence = datasets.load(_SEQUENCE, data_folder())
    camera = np.array(sequence.note["P34"])
    points = np.asarray(sequence.shapes, dtype=np.float64).reshape(-1, 3)
    depth_sign = np.sign(np.median(points @ camera[2, :3] + camera[2, 3]))
    return bool(depth_sign * np.linalg.det(camera[:, :3]) > 0)


def _record(values: dict[str, Any], method: str, options: tuple[tuple[str, Any], ...] = ()) -> dict[str, Any]:
    record: dict[str, Any] = values["records"].get(Case(Data(_SEQUENCE), method, "estimated", options).key, {})
    return record


def _errors(values: dict[str, Any], method: str) -> tuple[float | None, float | None]:
    """Unreflected errors of what is returned, and of its mirror image."""
    returned, mirrored = (_record(values, method, options).get("unreflected") for options in ((), _MIRROR))
    return returned, mirrored


def _mirror(values: dict[str, Any], method: str) -> Fact:
    what = f"{_SEQUENCE}, `{method}`: the mirror convention picks the right one, or says that it cannot know"
    returned, mirrored = _errors(values, method)
    if returned is None or mirrored is None:
        return Fact(what, False, "failed")
    if returned < mirrored:
        return Fact(what, True, "the right one")
    # A warning is what a user sees; a number deep in the diagnostics is not an admission.
    warned = any("mirror" in text for text in _record(values, method).get("warnings") or [])
    return Fact(what, warned, "the wrong one, with a warning" if warned else "the wrong one")


def checks(values: dict[str, Any]) -> list[Check | Fact]:
    """Error and mirror of Algorithm 2."""
    what = f"{_SEQUENCE}, `{_CHECKED}`, similarity per frame"
    return [Check(what, _record(values, _CHECKED).get("similarity"), targets.REAL), _mirror(values, _CHECKED)]


def render(values: dict[str, Any]) -> list[str]:
    """Errors of both mirror images, and which one is returned."""
    lines = [
        f"`{_SEQUENCE}`: 126 tracks in 150 frames, perspective. One similarity per frame, since the truth is in mm and "
        'the tracks are in pixels; `align="similarity"` allows a reflection. The next two columns do not, which tells '
        "the right one of the two solutions from the wrong one.",
        "",
    ]
    rows = []
    for method in targets.METHODS:
        returned, mirrored = _errors(values, method)
        record = _record(values, method)
        check = Check("", record.get("similarity"), targets.REAL)
        rows.append(
            [
                f"`{method}`{' (checked)' if method == _CHECKED else ''}",
                check.cell() if "error" not in record else f"failed: {record['error']}",
                error(returned),
                error(mirrored),
                _mirror(values, method).cell(),
            ]
        )
    lines += table(["", '`align="similarity"`', "as returned", "mirrored", "the convention picks"], rows)
    said = _record(values, _CHECKED).get("mirror")
    lines += [f"What the diagnostics say about the mirror: {_plain(said) if said else 'nothing'}.", ""]
    return lines


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(v)}" for key, v in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)
