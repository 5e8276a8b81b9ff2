"""Energy, gap and error per iteration, and how many iterations the methods take (the paper's analysis 1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import Curve, Panel, curve_figure, method_colour
from nrsfm.experiments.dots import Dot, dots_figure
from nrsfm.experiments.rows import (
    collect,
    e3d,
    error_text,
    in_order,
    listed,
    method_title,
    noise_title,
    sequence_title,
    table_lines,
    usable,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOISE = 0.03
_OURS = ("grassmann", "geometry-aware")
_FOLLOWED = ("bmm", *_OURS)
_STEPS = (1, 2, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 150, 160)
_QUICK = (1, 5, 20, 40, 60, 80, 100, 120, 140)
_PAPER = (120, 150)


class Convergence:
    """How the methods come to their end."""

    name = "convergence"
    title = "Iterations"
    question = "How do energy, gap and error fall, and how many iterations does it take?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Every method on two faces; BMM and the two algorithms on all, with noise too, and stopped early.

        A run that is stopped after n iterations has the shapes that the whole run had then: no randomness depends on
        the end. True cameras; 3,000 points, 1,000 for the other methods.
        """
        faces, two = scope.faces(), scope.faces()[::2]
        points, fewer = (600, 300) if scope.quick else (3000, 1000)
        whole = ("iterations", "stop_reason", "history", "errors")
        cells = [
            Cell(Data(name, noise, points=points), method, "known", (), whole)
            for name in (two if scope.quick else faces)
            for noise in (0.0, _NOISE)
            for method in scope.using(_FOLLOWED)
        ]
        cells += [
            Cell(Data(name, points=fewer), method, "known", (), whole)
            for name in two
            for method in scope.using()
            if method not in _FOLLOWED
        ]
        cells += [
            Cell(Data(name, points=points), method, "known", (("max_iterations", count),), ("iterations", "errors"))
            for name in two
            for method in scope.using(_FOLLOWED)
            for count in (_QUICK if scope.quick else _STEPS)
        ]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell; whole runs have ``energy`` and ``gap`` of every iteration as lists."""

        def take(cell: Cell, record: Record) -> Iterable[Row]:
            row: Row = {"iterations": record["iterations"], "e3d": e3d(record)}
            if "history" in record:
                history = record["history"] or {}
                row["stop_reason"] = record["stop_reason"]
                for name in ("energy", "gap"):
                    row[name] = [float(f"{v:.5g}") for v in history.get(name, []) if v is not None]
            return [row]

        return collect(cells, records, take)

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """Curves of the three that are followed; iterations of all."""
        found = []
        whole = [row for row in usable(rows, "iterations") if "stop_reason" in row]
        names = [n for n in in_order(rows, "sequence") if _errors(rows, n, in_order(rows, "method"))]
        if names:
            grid = [
                [
                    self._history(whole, name, "energy", name == names[-1]),
                    self._history(whole, name, "gap", name == names[-1]),
                    self._error(rows, name, name == names[-1]),
                ]
                for name in names
            ]
            figure = curve_figure(
                "On the way to the solution",
                "true cameras, no noise",
                grid,
                share="none",
            )
            caption = (
                "Energy ½‖W − RS‖² + γ‖S♯‖_* over its last value, the gap between S♯ and f(S), and the error of a "
                "run that was stopped there, over iterations."
            )
            found.append(Picture(f"{self.name}-curves", figure, caption))
        if whole:
            caption = (
                "Iterations until each method stopped: a dot for every sequence, hollow with 3% noise; a cross where "
                "the limit of iterations ended the run. Grey: what the paper says of its algorithms."
            )
            found.append(Picture(f"{self.name}-iterations", self._dots(whole), caption))
        return found

    def _dots(self, rows: Sequence[Row]) -> Figure:
        runs = {
            method: [
                Dot(row["iterations"], hollow=bool(row["noise"]), crossed=row["stop_reason"] == "iteration limit")
                for row in rows
                if row["method"] == method
            ]
            for method in in_order(rows, "method")
        }
        return dots_figure(
            "Iterations until the method stops",
            "a dot a sequence · hollow: 3% noise · ×: stopped by the limit",
            [(method_title(method), method_colour(method), dots) for method, dots in runs.items()],
            "iterations",
            (*_PAPER, "paper"),
        )

    def _history(self, rows: Sequence[Row], name: str, what: str, bottom: bool) -> Panel:
        curves = []
        for method in _FOLLOWED:
            for row in usable(rows, sequence=name, noise=0.0, method=method):
                values = np.asarray(row.get(what) or [], dtype=np.float64)
                if what == "energy" and len(values):
                    values = values / values[-1]
                if len(values):
                    x = list(range(1, len(values) + 1))
                    curves.append(
                        Curve(
                            method_title(method),
                            x,
                            list(np.maximum(values, 1e-12)),
                            method_colour(method),
                            dashed=method == "geometry-aware",
                        )
                    )
        return Panel(
            sequence_title(name),
            curves,
            {"energy": "energy over its last value", "gap": "gap between S♯ and f(S)"}[what],
            x_label="iteration" if bottom else "",
            log_y=True,
            limits=(3e-7, 30.0) if what == "gap" else None,
        )

    def _error(self, rows: Sequence[Row], name: str, bottom: bool) -> Panel:
        curves = []
        for method, (x, y) in _errors(rows, name, _FOLLOWED).items():
            dashed = method == "geometry-aware"
            curves.append(Curve(method_title(method), x, y, method_colour(method), dashed=dashed))
        return Panel(
            sequence_title(name),
            curves,
            "e3D when stopped here",
            x_label="iteration" if bottom else "",
            band=(*_PAPER, "paper"),
            log_y=True,
            named=True,
        )

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """120 to 150 iterations; whether the end is an end; when the error has settled."""
        whole = [row for row in usable(rows, "iterations") if "stop_reason" in row]
        ours = [row for row in whole if row["method"] in _OURS]
        claim = "Both algorithms take 120 to 150 iterations."
        if not ours:
            found = [Finding(claim, "not measured", "Neither algorithm was run to its end.")]
        else:
            inside = [row for row in ours if _PAPER[0] <= row["iterations"] <= _PAPER[1]]
            told = []
            for method in in_order(ours, "method"):
                numbers = [row["iterations"] for row in ours if row["method"] == method]
                told.append(f"{method_title(method)} {min(numbers)} to {max(numbers)}")
            verdict = "reproduced" if len(inside) == len(ours) else "in part" if inside else "not reproduced"
            text = (
                f"{listed(told)} on {listed([sequence_title(n) for n in in_order(ours, 'sequence')])}, with "
                f"{listed([noise_title(n) for n in sorted({row['noise'] for row in ours})])}; {len(inside)} of "
                f"{len(ours)} runs are within the paper's range."
            )
            found = [Finding(claim, verdict, text)]
        limited = [row for row in whole if row["stop_reason"] == "iteration limit"]
        if whole:
            claim = "Every method comes to an end of its own (not claimed in the paper; the question is ours)."
            words = [f"{method_title(r['method'])} on {sequence_title(r['sequence'])}" for r in limited]
            text = (
                f"{len(limited)} of {len(whole)} runs were ended by their limit of iterations: {listed(words)}."
                if limited
                else f"All {len(whole)} runs of {len(in_order(whole, 'method'))} methods did."
            )
            verdict = "reproduced" if not limited else "in part" if len(limited) < len(whole) else "not reproduced"
            found.append(Finding(claim, verdict, text))
        return found + self._settled(rows)

    def _settled(self, rows: Sequence[Row]) -> list[Finding]:
        told, late, total = [], 0, 0
        for name in in_order(rows, "sequence"):
            for method, (x, y) in _errors(rows, name, _OURS).items():
                if len(x) < 3:
                    continue
                total += 1
                close = [abs(value - y[-1]) <= 0.01 * y[-1] for value in y]
                first = next(x[i] for i in range(len(x)) if all(close[i:]))
                late += first >= 0.9 * x[-1]
                told.append(f"{method_title(method)}, {sequence_title(name)}: {first} of {x[-1]}")
        if not total:
            return []
        claim = "All these iterations are needed (not claimed in the paper; the question is ours)."
        verdict = "reproduced" if late == total else "in part" if late else "not reproduced"
        text = f"From this iteration on the error is within 1% of its last value: {'; '.join(told)}."
        return [Finding(claim, verdict, text)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Iterations and reasons to stop, methods down."""
        whole = [row for row in usable(rows, "iterations") if "stop_reason" in row]
        heads = sorted({(row["noise"], row["sequence"]) for row in whole})
        body = []
        for method in in_order(whole, "method"):
            shown = []
            for noise, name in heads:
                some = usable(whole, sequence=name, noise=noise, method=method)
                shown.append(f"{some[0]['iterations']} ({some[0]['stop_reason']})" if some else "–")
            body.append([method_title(method), *shown])
        if not body:
            return []
        head = ["iterations (reason to stop)", *(f"{sequence_title(n)}{', noise' if v else ''}" for v, n in heads)]
        lines = table_lines(head, body)
        errors = [
            [
                sequence_title(name),
                method_title(method),
                ", ".join(f"{n}: {error_text(v)}" for n, v in zip(x, y, strict=True)),
            ]
            for name in in_order(rows, "sequence")
            for method, (x, y) in _errors(rows, name, _FOLLOWED).items()
        ]
        return lines + (
            table_lines(["sequence", "method", "e3D when stopped after so many iterations"], errors) if errors else []
        )


def _errors(rows: Sequence[Row], name: str, methods: Sequence[str]) -> dict[str, tuple[list[int], list[float]]]:
    """By method the iterations of stopped runs and the end of the whole one, and the errors."""
    found = {}
    for method in methods:
        some = usable(rows, "e3d", "iterations", sequence=name, noise=0.0, method=method)
        if any("max_iterations" in row for row in some):
            points = sorted({row["iterations"]: row["e3d"] for row in some}.items())
            found[method] = ([n for n, _ in points], [e for _, e in points])
    return found
