"""What each part of both algorithms is worth (the paper's analysis 5).

Twice: as the paper's boxes are written (plain nuclear norm, no shrinking of noise, subspaces of fixed dimension), and
with this package's defaults, parts switched off one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import COLOURS, Curve, Panel, curve_figure
from nrsfm.experiments.rows import (
    collect,
    e3d,
    error_text,
    face_number,
    in_order,
    listed,
    method_title,
    noise_title,
    noises,
    percent,
    sequence_title,
    table_lines,
    usable,
)

Options = tuple[tuple[str, Any], ...]

_NOISE = 0.03
_SPATIAL_DIMENSION = 6
_CELLS = 10
# Algorithm 1's constraints and Algorithm 2's, from none to all; the names are what the figure's axis says.
_PARTS: dict[str, tuple[tuple[str, Options], ...]] = {
    "grassmann": (
        ("neither", (("spatial", False), ("temporal", False))),
        ("space", (("temporal", False),)),
        ("time", (("spatial", False),)),
        ("both", ()),
    ),
    "geometry-aware": (
        ("none", (("spatial", False),)),
        ("cells", (("grouping", False),)),
        ("groups", (("projection", False),)),
        ("lower", ()),
    ),
}
_MEANING = {
    "neither": "neither constraint",
    "space": "spatial subspaces",
    "time": "temporal subspaces",
    "both": "both",
    "none": "no subspaces",
    "cells": "subspaces, no grouping",
    "groups": "grouping on the original manifold",
    "lower": "grouping on the lower manifold",
}
_FURTHER: tuple[tuple[str, str, Options], ...] = (
    *(
        (method, what, options)
        for method in ("geometry-aware", "grassmann")
        for what, options in (
            ("no denoising", (("denoise", False),)),
            ("plain nuclear norm", (("reweight", 0.0),)),
            ("plain norm, no denoising", (("denoise", False), ("reweight", 0.0))),
        )
    ),
    ("grassmann", "no grouping", (("grouping", False),)),
    ("bmm", "defaults", ()),
    ("bmm", "no denoising", (("denoise", False),)),
)
_PUBLISHED = {  # the paper's Algorithm 1: neither, spatial, temporal, both
    1: (0.084, 0.052, 0.050, 0.044),
    2: (0.070, 0.051, 0.043, 0.038),
    3: (0.056, 0.034, 0.037, 0.028),
    4: (0.060, 0.038, 0.036, 0.030),
}
_SETTINGS = {"box": "as in the paper's boxes", "defaults": "with our defaults"}


def temporal_dimension(sequence: str) -> int:
    """The dimension p_t: 4 where two groups share ten frames (faces 1 and 2), else 10."""
    return 4 if face_number(sequence) in (1, 2) else 10


def _box(sequence: str, method: str, part: str) -> Options:
    """Options that the boxes have by writing, beside those of the part; the temporal ones are Algorithm 1's."""
    box: Options = (("denoise", False), ("reweight", 0.0))
    if part not in ("neither", "time", "none"):
        box += (("spatial_cells", _CELLS), ("spatial_dimension", _SPATIAL_DIMENSION))
    if part in ("time", "both"):
        box += (("temporal_dimension", temporal_dimension(sequence)),)
    return box


class Ablation:
    """Parts switched off, with true cameras."""

    name = "ablation"
    title = "What each part is worth"
    question = "How much does each constraint of the two algorithms lower the error?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Four faces and ict, with and without noise.

        The boxes run on 1,000 points in 10 cells: without shrinking, noise gives every cell full rank, and the time
        grows with all of them. The defaults run on 3,000 points.
        """
        return [cell for cell, _, _ in self._asked(scope)]

    def _asked(self, scope: Scope) -> list[tuple[Cell, str, str]]:
        """Cells with their setting and part."""
        names = (
            scope.faces()[::2] if scope.quick else list(dict.fromkeys([*scope.faces(), *scope.having(["ict-rom99"])]))
        )
        few, many = (300, 600) if scope.quick else (1000, 3000)
        found = []
        for name in names:
            for noise in (0.0, _NOISE):
                for method in scope.using(_PARTS):
                    for part, options in _PARTS[method]:
                        box = options + _box(name, method, part)
                        found.append((self._cell(name, noise, few, method, box), "box", part))
                        found.append((self._cell(name, noise, many, method, options), "defaults", part))
                for method, part, options in () if scope.quick else _FURTHER:
                    if method in scope.using():
                        found.append((self._cell(name, noise, many, method, options), "further", part))
        return found

    @staticmethod
    def _cell(name: str, noise: float, points: int, method: str, options: Options) -> Cell:
        return Cell(Data(name, noise, points=points), method, "known", options, ("errors", "groups"))

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell, with ``setting`` and ``part``."""

        def words(cell: Cell) -> Row:
            given = set(cell.options)
            for setting in ("box", "defaults"):
                for part, options in _PARTS.get(cell.method, ()):
                    box = _box(cell.data.sequence, cell.method, part) if setting == "box" else ()
                    if set(options + box) == given:
                        return {"setting": setting, "part": part}
            for method, part, options in _FURTHER:
                if method == cell.method and set(options) == given:
                    return {"setting": "further", "part": part}
            return {"setting": "", "part": ""}

        return [
            words(cell) | row
            for cell in cells
            for row in collect([cell], records, lambda _, record: [{"e3d": e3d(record), "groups": record["groups"]}])
        ]

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """Error relative to no constraint: algorithms down, settings across."""
        good = usable(rows, "e3d")
        if not usable(good, setting="box") and not usable(good, setting="defaults"):
            return []
        heads = [(setting, noise) for setting in _SETTINGS for noise in noises(good)]
        grid = [
            [self._panel(good, method, *head, head == heads[0], head == heads[-1]) for head in heads]
            for method in in_order(good, "method")
            if method in _PARTS
        ]
        figure = curve_figure(
            "What each part is worth",
            "error over that without any constraint, true cameras · below 1 the part helps",
            grid,
            share="all",
        )
        caption = (
            "Error of each variant over that of the variant without constraints. Boxes: plain nuclear norm, no "
            f"shrinking, p = {_SPATIAL_DIMENSION} in {_CELLS} cells, two groups of frames of dimension 4 (10 frames) "
            "or 10, 1,000 points. Defaults: 3,000 points. Dotted: mean of the paper's four faces."
        )
        return [Picture(self.name, figure, caption)]

    def _panel(self, rows: Sequence[Row], method: str, setting: str, noise: float, first: bool, last: bool) -> Panel:
        parts = [part for part, _ in _PARTS[method]]
        curves = []
        if method == "grassmann" and setting == "box" and not noise:
            gains = [sum(e[i] / e[0] for e in _PUBLISHED.values()) / len(_PUBLISHED) for i in range(4)]
            curves.append(Curve("paper, mean of 4", range(4), gains, COLOURS[5], quiet=True, name_at_end=True))
        for j, name in enumerate(in_order(rows, "sequence")):
            errors = _errors(rows, name, noise, method, setting)
            if parts[0] in errors:
                at = [i for i, part in enumerate(parts) if part in errors]
                gains = [errors[parts[i]] / errors[parts[0]] for i in at]
                curves.append(Curve(sequence_title(name), at, gains, COLOURS[j % len(COLOURS)]))
        return Panel(
            f"{method_title(method)}",
            curves,
            f"{'boxes' if setting == 'box' else 'defaults'}, {noise_title(noise)}",
            y_label="relative error" if first else "",
            ticks=list(enumerate(parts)),
            named=last,
            level=1.0,
            x_limits=(-0.3, 3.3),
        )

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """Both constraints help Algorithm 1; neighbours help Algorithm 2; the lower manifold is the better one."""
        good = usable(rows, "e3d")
        return [
            self._judge(
                good,
                "grassmann",
                "Both constraints help Algorithm 1: either alone lowers the error, both together most.",
                lambda e: [e["space"] < 0.98 * e["neither"], e["time"] < 0.98 * e["neither"],
                           e["both"] <= 1.02 * min(e["space"], e["time"]) and e["both"] < 0.98 * e["neither"]],
            ),
            self._judge(
                good,
                "geometry-aware",
                "The neighbouring constraint (grouping on the lower manifold) lowers the error of Algorithm 2.",
                lambda e: [e["lower"] < 0.98 * e["cells"]],
            ),
            self._judge(
                good,
                "geometry-aware",
                "Grouping is better on the lower manifold than on the original one.",
                lambda e: [e["lower"] < 0.99 * e["groups"]],
            ),
        ]  # fmt: skip

    def _judge(self, rows: Sequence[Row], method: str, claim: str, holds: Any) -> Finding:
        """The verdict is on the boxes without noise, which is the paper's experiment; the text tells the rest."""
        parts = [part for part, _ in _PARTS[method]]
        counts: dict[tuple[str, float], list[bool]] = {}
        told = []
        for setting in _SETTINGS:
            for noise in noises(rows):
                complete = [
                    errors
                    for name in in_order(rows, "sequence")
                    if set(parts) <= set(errors := _errors(rows, name, noise, method, setting))
                ]
                if complete:
                    held = counts[setting, noise] = [one for errors in complete for one in holds(errors)]
                    changes = [
                        f"{_MEANING[part]} {percent(_mean_change(complete, part, parts[0]))}" for part in parts[1:]
                    ]
                    told.append(
                        f"{_SETTINGS[setting]}, {noise_title(noise)}: {sum(held)} of {len(held)} comparisons hold; "
                        f"{', '.join(changes)}"
                    )
        if not told:
            return Finding(claim, "not measured", f"No complete set of variants of {method_title(method)}.")
        verdict, passed = "not measured", counts.get(("box", 0.0), [])
        if passed:
            verdict = "reproduced" if all(passed) else "in part" if any(passed) else "not reproduced"
        names = listed([sequence_title(name) for name in in_order(rows, "sequence")])
        text = (
            "Judged as in the paper's boxes, without noise, with true cameras. Changes of the error against that "
            f"with {_MEANING[parts[0]]}, geometric mean over {names}. "
        ) + " ".join(f"{words[0].upper()}{words[1:]}." for words in told)
        noisy = [sum(held) / len(held) for (setting, noise), held in counts.items() if setting == "box" and noise]
        if passed and noisy and max(noisy) > 0.5 > sum(passed) / len(passed):
            text += " What the paper found without noise appears here with noise."
        return Finding(claim, verdict, text)

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Variants down, sequences across, for each noise."""
        good = usable(rows, "e3d")
        lines = []
        names = in_order(good, "sequence")
        for noise in noises(good):
            body = []
            for setting, words in {**_SETTINGS, "further": "with our defaults, but"}.items():
                for method in in_order(good, "method"):
                    parts = in_order(usable(good, method=method, setting=setting), "part")
                    whole = {n: _errors(good, n, noise, method, "defaults") for n in names}
                    for part in parts:
                        errors = [_errors(good, name, noise, method, setting).get(part) for name in names]
                        shown = [
                            error_text(error) + _change(error, whole[name].get(_PARTS[method][-1][0]))
                            if setting == "further" and method in _PARTS
                            else error_text(error)
                            for name, error in zip(names, errors, strict=True)
                        ]
                        body.append([method_title(method), words, _MEANING.get(part, part), *shown])
            lines += [f"e3D, {noise_title(noise)} (changes are against the algorithm's defaults):", ""]
            lines += table_lines(["method", "", "variant", *map(sequence_title, names)], body)
        return lines


def _mean_change(complete: Sequence[Mapping[str, float]], part: str, reference: str) -> float:
    """Geometric mean of error over reference, less 1."""
    ratios = [max(errors[part], 1e-9) / max(errors[reference], 1e-9) for errors in complete]
    return math.prod(ratios) ** (1.0 / len(ratios)) - 1.0


def _change(error: float | None, reference: float | None) -> str:
    return "" if error is None or not reference else f" ({percent(error / reference - 1)})"


def _errors(rows: Sequence[Row], name: str, noise: float, method: str, setting: str) -> dict[str, float]:
    some = usable(rows, "e3d", sequence=name, noise=noise, method=method, setting=setting)
    return {row["part"]: row["e3d"] for row in some}
