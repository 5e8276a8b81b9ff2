"""Seconds against the number of frames and of points, with each method's slope on log-log axes.

Every cell runs alone, with all cores, on a generated face: the same motion sampled by more frames, the same surface by
more points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from nrsfm.experiments import published
from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import Curve, Panel, curve_figure, method_colour
from nrsfm.experiments.markdown import table
from nrsfm.experiments.rows import in_order, listed, method_title, sequence_title, usable
from nrsfm.experiments.table_findings import OWN

_SEQUENCE = "built-in-face3"
_FRAMES, _FRAMES_POINTS = (10, 25, 50, 100, 200, 346), 2000
_POINTS, _POINTS_FRAMES = (1000, 3000, 10_000, 30_000, 100_000), 30
_QUICK_FRAMES, _QUICK_FRAMES_POINTS = (10, 20, 40), 200
_QUICK_POINTS, _QUICK_POINTS_FRAMES = (200, 1000, 4000), 10
_FITTED = 3  # sizes, the largest, that slopes are fitted to: below, fixed costs hide the growth
_ALIKE = 1.5  # times within this factor are about the same
_FLAT = 0.5  # slope against points below which the number of points hardly matters


class Timing:
    """Seconds against frames and points."""

    name = "time"
    title = "Time"
    question = "How does the time of each method grow with frames and points?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Two series of sizes, every method with its own cameras."""
        if scope.quick:
            sizes = [(f, _QUICK_FRAMES_POINTS) for f in _QUICK_FRAMES] + [
                (_QUICK_POINTS_FRAMES, p) for p in _QUICK_POINTS
            ]
        else:
            sizes = [(f, _FRAMES_POINTS) for f in _FRAMES] + [(_POINTS_FRAMES, p) for p in _POINTS]
        return [
            Cell(Data(_SEQUENCE, frames=f, points=p), method, measures=("seconds", "memory", "iterations"), alone=True)
            for f, p in dict.fromkeys(sizes)
            for method in scope.using()
        ]

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell; ``against``: the series that it belongs to, two rows where these are two."""
        series = _series([(cell.data.frames or 0, cell.data.points or 0) for cell in cells])
        rows = []
        for cell in cells:
            record = records.get(cell.key)
            if record is None:
                continue
            size = (cell.data.frames or 0, cell.data.points or 0)
            row: Row = {"frames": size[0], "points": size[1], "method": cell.method}
            if "error" in record:
                row["error"] = record["error"]
            else:
                seconds, memory = record["seconds"], record["memory"]
                row |= {"seconds": seconds["total"], "seconds_cameras": seconds["cameras"]}
                row |= {"seconds_method": seconds["method"], "memory_mb": None if memory is None else memory / 1e6}
                row["iterations"] = record["iterations"]
            rows += [{"against": against, **row} for against, sizes in series.items() if size in sizes]
        return rows

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """The whole call above, the method's own part below; frames left, points right."""
        if not usable(rows, "seconds"):
            return []
        panels = [[_panel(rows, against, column) for against in ("frames", "points")] for column in _COLUMNS]
        figure = curve_figure(
            "Time against size",
            "each cell alone on the machine; a generated face; beside the names the slope of the three largest sizes",
            panels,
            tall=2.4,
            share="none",
            names=1.3,
        )
        caption = "Seconds of the whole call, cameras included (above), and of the method's own iterations (below)."
        return [Picture(self.name, figure, caption)]

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """What the paper says of processing time, and what the compression promises."""
        return [_same(rows), _faster(rows), _flat(rows)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Slopes and the times at the largest sizes."""
        body = []
        for method in in_order(rows, "method"):
            texts = []
            for against in ("frames", "points"):
                largest = max((r[against] for r in rows if r["against"] == against), default=None)
                there = usable(rows, "seconds", method=method, against=against, **{against: largest})
                texts.append(_amount(there[0]["seconds"]) if there else "–")
                for column in _COLUMNS:
                    found = slope(rows, method, against, column)
                    texts.append("–" if found is None else f"{found:.2f}")
            body.append([method_title(method), *texts])
        if not body:
            return []
        heads = []
        for against in ("frames", "points"):
            sizes = [(r["frames"], r["points"]) for r in rows if r["against"] == against]
            if sizes:
                f, p = max(sizes)
                heads += [f"s at {f} × {p:,}", f"slope in {against}", "of the method alone"]
            else:
                heads += ["–", "–", "–"]
        lines = [
            f"Slopes of log seconds against log size over the {_FITTED} largest sizes.",
            "",
            *table(["", *heads], body),
        ]
        names = [sequence_title(name) for name in published.SECONDS_SEQUENCES]
        told = [[method_title(m), *(f"{value:,.0f}" for value in v)] for m, v in published.SECONDS.items()]
        return [
            *lines,
            "Published seconds (MATLAB, another machine, the original sequences):",
            "",
            *table(["", *names], told),
        ]


_COLUMNS = {"seconds": "whole call", "seconds_method": "the method alone"}


def _series(sizes: Sequence[tuple[int, int]]) -> dict[str, set[tuple[int, int]]]:
    """Which of the sizes (frames, points) differ in frames alone, and which in points alone: the commonest other."""
    frames, points = zip(*sizes, strict=True) if sizes else ((), ())
    fixed_points = max(set(points), key=points.count, default=None)
    fixed_frames = max(set(frames), key=frames.count, default=None)
    return {
        "frames": {size for size in sizes if size[1] == fixed_points},
        "points": {size for size in sizes if size[0] == fixed_frames},
    }


def slope(rows: Sequence[Row], method: str, against: str, column: str = "seconds") -> float | None:
    """Exponent of the growth of the seconds over the largest sizes; ``None`` with less than two of them."""
    found = sorted((r[against], r[column]) for r in usable(rows, column, method=method, against=against))[-_FITTED:]
    if len(found) < 2:
        return None
    size, seconds = np.array(found, dtype=np.float64).T
    return float(np.polyfit(np.log(size), np.log(np.maximum(seconds, 1e-4)), 1)[0])


def _panel(rows: Sequence[Row], against: str, column: str) -> Panel:
    curves = []
    other = "points" if against == "frames" else "frames"
    fixed = in_order([row for row in rows if row["against"] == against], other)
    for method in in_order(rows, "method"):
        found = sorted((r[against], r[column]) for r in usable(rows, column, method=method, against=against))
        if found:
            x, y = zip(*found, strict=True)
            steep = slope(rows, method, against, column)
            name = method_title(method).removesuffix(" priors") + ("" if steep is None else f" · {_steepness(steep)}")
            strong = method in OWN
            curves.append(Curve(name, x, [max(v, 1e-3) for v in y], method_colour(method), strong=strong))
    sizes = sorted({row[against] for row in rows if row["against"] == against})
    ticks = [(float(size), f"{size / 1000:g}k" if size >= 1000 else str(size)) for size in sizes]
    return Panel(
        f"{_COLUMNS[column][0].upper()}{_COLUMNS[column][1:]}",
        curves,
        f"against {against}, {fixed[0]:,} {other}" if len(fixed) == 1 else f"against {against}",
        against if column == "seconds_method" else "",
        "seconds" if against == "frames" else "",
        ticks=ticks,
        log_x=True,
        log_y=True,
        named=True,
    )


def _steepness(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


def _times(rows: Sequence[Row], method: str) -> dict[tuple[int, int], float]:
    return {(row["frames"], row["points"]): row["seconds"] for row in usable(rows, "seconds", method=method)}


def _same(rows: Sequence[Row]) -> Finding:
    claim = "Algorithms 1 and 2 take more or less the same time."
    first, second = (_times(rows, method) for method in OWN)
    ratios = [second[size] / first[size] for size in first if size in second and first[size] > 0]
    if not ratios:
        return Finding(claim, "not measured", "No size has times of both.")
    middle = median(ratios)
    alike = [ratio for ratio in ratios if 1 / _ALIKE <= ratio <= _ALIKE]
    verdict = (
        "reproduced" if len(alike) == len(ratios) else "in part" if 1 / _ALIKE <= middle <= _ALIKE else "not reproduced"
    )
    text = f"Algorithm 2 takes {min(ratios):.2f} to {max(ratios):.2f} times as long (median {middle:.2f}, "
    text += f"{len(ratios)} sizes)."
    return Finding(claim, verdict, text)


def _faster(rows: Sequence[Row]) -> Finding:
    claim = "Both algorithms are far faster than the previous methods of the comparison."
    times = {method: _times(rows, method) for method in (*OWN, *published.COMPARED)}
    ratios = {}
    for method in published.COMPARED:
        common = [size for size in times[method] if all(size in times[own] for own in OWN)]
        if common:
            ratios[method] = median(times[method][s] / max(times[own][s] for own in OWN) for s in common)
    if not ratios:
        return Finding(claim, "not measured", "No method of that comparison has times beside both.")
    slower = [method for method, ratio in ratios.items() if ratio > 1.0]
    verdict = "reproduced" if len(slower) == len(ratios) else "in part" if slower else "not reproduced"
    listing = listed([f"{method_title(m)} {r:.2g}" for m, r in sorted(ratios.items(), key=lambda item: -item[1])])
    text = (
        f"Median time in units of the slower of the two: {listing}. Here the global methods run on the exact "
        "compression too, which they did not when they were published."
    )
    return Finding(claim, verdict, text)


def _flat(rows: Sequence[Row]) -> Finding:
    claim = "The number of points hardly matters to the two algorithms (a promise of the exact compression)."
    found = {method: s for method in OWN if (s := slope(rows, method, "points")) is not None}
    if len(found) < 2:
        return Finding(claim, "not measured", "Two numbers of points are needed.")
    flat = [method for method, value in found.items() if value < _FLAT]
    verdict = ("not reproduced", "in part", "reproduced")[len(flat)]
    listing = listed([f"{method_title(m)} {v:.2f}" for m, v in found.items()])
    return Finding(claim, verdict, f"Slopes against points: {listing}; counted as flat: below {_FLAT:g}.")


def _amount(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{float(f'{value:.3g}'):g}"
