"""Error against the number of subspaces: K_s and K_t, and into how many groups the cells are merged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nrsfm.experiments.ablation import temporal_dimension
from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import COLOURS, Curve, Panel, curve_figure
from nrsfm.experiments.rows import (
    collect,
    e3d,
    enough,
    error_text,
    face_number,
    in_order,
    method_title,
    noise_title,
    noises,
    sequence_title,
    some_of,
    spearman,
    table_lines,
    usable,
)

_NOISE = 0.03
_DIMENSION = 6
_SWEEPS: dict[str, tuple[str, tuple[int, ...], tuple[int, ...]]] = {
    "spatial_cells": ("K_s, cells of points", (5, 10, 15, 20, 25, 30, 40, 50), (5, 20, 50)),
    "temporal_cells": ("K_t, cells of frames", (1, 2, 3, 4, 5, 6, 7, 8), (1, 2, 4)),
    "spatial_groups": ("groups of 20 cells", (2, 4, 6, 10, 15, 20), (2, 10)),
}
_GROUPED = 20
_PUBLISHED = {3: ((5, 10, 15, 20, 25), (0.088, 0.053, 0.041, 0.032, 0.030))}  # K_s, read off the paper's figure


class Subspaces:
    """Error against K_s, K_t and the number of groups."""

    name = "subspaces"
    title = "How many subspaces"
    question = "How does the error depend on the number of spatial and of temporal subspaces?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Four faces of 3,000 points, with and without noise, true cameras.

        Without noise p = 6 is given, with noise p follows the noise; temporal subspaces have dimension 4 on 10 frames
        and 10 on 99. Otherwise nothing would be cut where there is no noise.
        """
        faces = scope.faces()[::2] if scope.quick else scope.faces()
        points = 1500 if scope.quick else 3000
        cells = []
        for name in faces:
            for noise in (0.0, _NOISE):
                for swept, (_, values, few) in _SWEEPS.items():
                    methods = ["grassmann"] if swept == "temporal_cells" else ["geometry-aware"]
                    if swept == "spatial_cells" and not scope.quick:
                        methods = ["grassmann", "geometry-aware"]
                    cells += [
                        Cell(
                            Data(name, noise, points=points),
                            method,
                            "known",
                            _options(name, noise, swept, value),
                            ("errors",),
                        )
                        for method in scope.using(methods)
                        for value in (few if scope.quick else values)
                    ]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell: what was swept, its value, the error."""

        def swept(cell: Cell) -> Row:
            given = dict(cell.options)
            for name in ("temporal_cells", "spatial_groups", "spatial_cells"):
                if name in given:
                    return {"swept": name, "value": given[name]}
            return {"swept": "", "value": None}

        return [
            swept(cell) | row
            for cell in cells
            for row in collect([cell], records, lambda _, record: [{"e3d": e3d(record)}])
        ]

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """What is swept across, noise down."""
        good = usable(rows, "e3d")
        if not good:
            return []
        sweeps = [name for name in _SWEEPS if usable(good, swept=name)]
        levels = noises(good)
        grid = [
            [self._panel(good, name, noise, j == 0, j == len(sweeps) - 1) for j, name in enumerate(sweeps)]
            for noise in levels
        ]
        figure = curve_figure(
            "Error against the number of subspaces",
            "e3D, each frame aligned, true cameras · K_s and groups: Algorithm 2 · K_t: Algorithm 1",
            grid,
        )
        caption = (
            f"Without noise the subspaces of points have dimension {_DIMENSION}, with noise it follows the noise; "
            "those of frames have 4 (10 frames) or 10 (99). Dotted: the paper's curve of face 3 over K_s."
        )
        return [Picture(self.name, figure, caption)]

    def _panel(self, rows: Sequence[Row], swept: str, noise: float, first: bool, last: bool) -> Panel:
        method = "grassmann" if swept == "temporal_cells" else "geometry-aware"
        curves = []
        for j, name in enumerate(in_order(rows, "sequence")):
            x, y = _curve(rows, swept, name, noise, method)
            if x:
                curves.append(Curve(sequence_title(name), x, y, COLOURS[j]))
            if swept == "spatial_cells" and not noise and face_number(name) in _PUBLISHED:
                curves.append(Curve("paper, face 3", *_PUBLISHED[face_number(name) or 3], COLOURS[j], quiet=True))
        return Panel(
            _SWEEPS[swept][0],
            curves,
            noise_title(noise),
            y_label="e3D" if first else "",
            band=(10, 50, "the paper’s range" if noise else "") if swept == "spatial_cells" else None,
            named=last,
        )

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """More cells are better, up to a point; temporal groups tear when there are many."""
        good = usable(rows, "e3d")
        found = [self._spatial(good), self._temporal(good)]
        told, count, total = [], 0, 0
        for noise in noises(good):
            for name in in_order(good, "sequence"):
                x, y = _curve(good, "spatial_groups", name, noise, "geometry-aware")
                if len(x) >= 2:
                    total += 1
                    count += y[0] > 1.02 * y[-1]
                    told.append(f"{sequence_title(name)}, {noise_title(noise)}: {error_text(y[0])} in {x[0]} groups, "
                                f"{error_text(y[-1])} in {x[-1]}")  # fmt: skip
        if total:
            claim = "Merging cells into few groups costs accuracy (not claimed in the paper; the question is ours)."
            text = f"By more than 2% in {count} of {total} curves ({some_of(told)})."
            found.append(Finding(claim, _verdict(count, total), text))
        return found

    def _spatial(self, rows: Sequence[Row]) -> Finding:
        claim = "The error falls with K_s and is flat from 25 subspaces on."
        told, count, total, early = [], 0, 0, 0
        for method in in_order(rows, "method"):
            for noise in noises(rows):
                for name in in_order(rows, "sequence"):
                    x, y = _curve(rows, "spatial_cells", name, noise, method)
                    if len(x) < 3:
                        continue
                    total += 1
                    falls, flat = y[0] > 1.05 * min(y) and spearman(x, y) < 0, enough(x, y)
                    count += falls and flat <= 25
                    early += not falls
                    told.append(
                        f"{sequence_title(name)}, {method_title(method)}, {noise_title(noise)}: {error_text(y[0])} at "
                        f"K_s = {x[0]}, {error_text(y[-1])} at {x[-1]}, within 5% of the least from {flat} on"
                    )
        if not total:
            return Finding(claim, "not measured", "No curve has three points.")
        text = f"So in {count} of {total} curves; in {early} the error does not fall by 5% ({some_of(told)})."
        return Finding(claim, _verdict(count, total), text)

    def _temporal(self, rows: Sequence[Row]) -> Finding:
        claim = "Temporal subspaces lower the error, with a best K_t above 1."
        told, count, total = [], 0, 0
        for noise in noises(rows):
            for name in in_order(rows, "sequence"):
                x, y = _curve(rows, "temporal_cells", name, noise, "grassmann")
                if len(x) < 2 or x[0] != 1:
                    continue
                total += 1
                best = y.index(min(y))
                count += best > 0 and y[best] < 0.98 * y[0]
                told.append(
                    f"{sequence_title(name)}, {noise_title(noise)}: {error_text(y[0])} at K_t = 1, least "
                    f"{error_text(y[best])} at {x[best]}, {error_text(y[-1])} at {x[-1]}"
                )
        if not total:
            return Finding(claim, "not measured", "No curve over K_t.")
        text = (
            f"By more than 2% in {count} of {total} curves ({some_of(told)}). One cell of frames held to this "
            "dimension is a bound on the rank of all shapes; with more cells each has the dimension for itself."
        )
        return Finding(claim, _verdict(count, total), text)

    def table(self, rows: Sequence[Row]) -> list[str]:
        """One table for each sweep: values down, sequences across."""
        good = usable(rows, "e3d")
        lines = []
        for swept, (title, _, _) in _SWEEPS.items():
            some = usable(good, swept=swept)
            heads = [
                (method, noise, name)
                for method in in_order(some, "method")
                for noise in noises(some)
                for name in in_order(some, "sequence")
            ]
            curves = {head: dict(zip(*_curve(some, swept, head[2], head[1], head[0]), strict=True)) for head in heads}
            if heads:
                lines += [f"e3D against {title}:", ""]
                words = [f"{sequence_title(n)}, {method_title(m)}{', noise' if v else ''}" for m, v, n in heads]
                lines += table_lines(
                    [swept, *words],
                    [
                        [str(value), *(error_text(curves[head].get(value)) for head in heads)]
                        for value in sorted({row["value"] for row in some})
                    ],
                )
        return lines


def _options(name: str, noise: float, swept: str, value: int) -> tuple[tuple[str, Any], ...]:
    if swept == "temporal_cells":
        return (("temporal_cells", value), ("temporal_dimension", temporal_dimension(name)))
    options: tuple[tuple[str, Any], ...] = () if noise else (("spatial_dimension", _DIMENSION),)
    if swept == "spatial_groups":
        options += (("spatial_cells", _GROUPED),)
    return (*options, (swept, value))


def _curve(rows: Sequence[Row], swept: str, name: str, noise: float, method: str) -> tuple[list[int], list[float]]:
    some = usable(rows, "e3d", "value", swept=swept, sequence=name, noise=noise, method=method)
    some = sorted(some, key=lambda row: int(row["value"]))
    return [row["value"] for row in some], [row["e3d"] for row in some]


def _verdict(count: int, total: int) -> str:
    return "reproduced" if count == total else "in part" if count else "not reproduced"
