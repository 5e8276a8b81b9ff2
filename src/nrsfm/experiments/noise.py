"""Error against the noise of the tracks: the paper's figure of mean e3D on the four faces, for every method.

Each face is cut to evenly spread points, so that ten repeats of every level and method finish in reasonable time. The
cameras of the intersection method are shared by all methods; their own ones are used in the first repeat alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nrsfm.experiments import published
from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import Curve, Panel, curve_figure, method_colour
from nrsfm.experiments.markdown import folded, table
from nrsfm.experiments.rows import e3d, error_text, in_order, listed, method_title, sequence_title, usable
from nrsfm.experiments.table import uses_intersection
from nrsfm.experiments.table_findings import OWN

_RATIOS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.055)
_REPEATS, _POINTS = 10, 2000
_QUICK_RATIOS, _QUICK_REPEATS, _QUICK_POINTS, _QUICK_FACES = (0.0, 0.02, 0.05), 2, 300, 2
_EQUAL = 0.005  # errors that differ by less are equal
_LIKE = 1.5  # slopes within this factor are alike
_MEASURES = ("errors", "seconds")


@dataclass(frozen=True)
class Level:
    """Mean e3D of the faces at one ratio: over the repeats, with their standard deviation."""

    ratio: float
    mean: float
    spread: float
    repeats: int


class Noise:
    """e3D against the ratio of noise."""

    name = "noise"
    title = "Noise"
    question = "How fast does the error grow with the noise of the tracks?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Faces × ratios × repeats × methods; own cameras in the first repeat."""
        faces = scope.faces()[:_QUICK_FACES] if scope.quick else scope.faces()
        ratios = _QUICK_RATIOS if scope.quick else _RATIOS
        repeats, points = (_QUICK_REPEATS, _QUICK_POINTS) if scope.quick else (_REPEATS, _POINTS)
        cells = []
        for face in faces:
            for ratio in ratios:
                for seed in range(repeats if ratio else 1):
                    data = Data(face, ratio, seed, points=points)
                    cells += [Cell(data, method, "intersection", measures=_MEASURES) for method in scope.using()]
                    if seed == 0 and not scope.quick:
                        others = [method for method in scope.using() if not uses_intersection(method)]
                        cells += [Cell(data, method, "own", measures=_MEASURES) for method in others]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell."""
        rows = []
        for cell in cells:
            record = records.get(cell.key)
            if record is None:
                continue
            row: Row = {
                "sequence": cell.data.sequence,
                "points": record.get("points"),
                "noise": cell.data.noise,
                "repeat": cell.data.seed,
                "method": cell.method,
                "cameras": cell.cameras,
            }
            failed = "error" in record
            rows.append(row | ({"error": record["error"]} if failed else {"e3d": e3d(record)}))
        return rows

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """All methods; beside them the paper's three, measured and published."""
        found = levels(rows, "intersection")
        if not found:
            return []
        own = levels([row for row in rows if row.get("repeat") == 0], "own")
        first = [_panel("Every method", "cameras of the intersection method", found, log=True)]
        first.append(_against_published(found))
        figure = curve_figure("Error against noise", _subtitle(rows), [first], tall=3.0, share="none")
        drawn = [Picture(self.name, figure, _caption(rows))]
        if own:
            title = "Error against noise, with the cameras of each method's publication"
            panel = _panel("Methods that have cameras of their own", "", own, log=True)
            figure = curve_figure(title, _subtitle(rows, 1), [[panel]], tall=3.0)
            drawn.append(Picture(f"{self.name}-own", figure, f"{title}."))
        return drawn

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """Order, strength under much noise, and slopes."""
        found = levels(rows, "intersection")
        return [_order(found), _strongest(found), _slopes(found)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Means and spreads by method and ratio."""
        lines: list[str] = []
        for kind, words in (("intersection", "Cameras of the intersection method"), ("own", "Own cameras, one repeat")):
            found = levels([r for r in rows if kind == "intersection" or r.get("repeat") == 0], kind)
            if not found:
                continue
            ratios = sorted({level.ratio for series in found.values() for level in series})
            body = []
            for method, series in found.items():
                by = {level.ratio: level for level in series}
                texts = [_text(by[ratio]) if ratio in by else "–" for ratio in ratios]
                slope = _slope(series)
                body.append([method_title(method), *texts, "–" if slope is None else f"{slope:.2f}"])
            part = [f"**{words}**: mean e3D ± standard deviation over the repeats", ""]
            part += table(["", *(f"{100 * ratio:g}%" for ratio in ratios), "slope"], body)
            lines += part if kind == "intersection" else folded(words, part[2:])
        return lines


def levels(rows: Sequence[Row], cameras: str) -> dict[str, list[Level]]:
    """For each method the mean over faces, then over repeats, at each ratio.

    A repeat counts if every face has a number in it: the mean of other faces would be another quantity.
    """
    good = usable(rows, "e3d", cameras=cameras)
    faces = in_order([row for row in rows if row["cameras"] == cameras], "sequence")
    found: dict[str, list[Level]] = {}
    for method in in_order(good, "method"):
        for ratio in sorted({row["noise"] for row in good if row["method"] == method}):
            here = [row for row in good if row["method"] == method and row["noise"] == ratio]
            values = {(row["repeat"], row["sequence"]): row["e3d"] for row in here}
            repeats = [r for r in in_order(here, "repeat") if all((r, face) in values for face in faces)]
            means = [float(np.mean([values[r, face] for face in faces])) for r in repeats]
            if means:
                spread = float(np.std(means, ddof=1)) if len(means) > 1 else 0.0
                found.setdefault(method, []).append(Level(ratio, float(np.mean(means)), spread, len(means)))
    return found


def _slope(series: Sequence[Level]) -> float | None:
    """Growth of e3D per unit of the ratio: least squares over the noisy levels."""
    noisy = [level for level in series if level.ratio > 0]
    if len(noisy) < 2:
        return None
    return float(np.polyfit([level.ratio for level in noisy], [level.mean for level in noisy], 1)[0])


def _text(level: Level) -> str:
    spread = f" ± {error_text(level.spread)}" if level.repeats > 1 else ""
    return error_text(level.mean) + spread


def _subtitle(rows: Sequence[Row], repeats: int | None = None) -> str:
    faces = in_order(rows, "sequence")
    points = max((row["points"] or 0 for row in rows), default=0)
    words = f"mean of {len(faces)} faces, {points:,} evenly spread points each, "
    repeats = repeats or 1 + max(row["repeat"] for row in rows)
    if repeats == 1:
        return words + "one repeat; each frame aligned on its own"
    return words + f"{repeats} repeats; each frame aligned on its own; bands: one standard deviation"


def _caption(rows: Sequence[Row]) -> str:
    return (
        f"e3D against the standard deviation of the noise as a share of max|W|, on "
        f"{listed([sequence_title(name) for name in in_order(rows, 'sequence')])}. Published curves are dotted."
    )


def _panel(title: str, note: str, found: Mapping[str, Sequence[Level]], *, log: bool, y_label: str = "e3D") -> Panel:
    curves = [
        Curve(
            method_title(method),
            [100 * level.ratio for level in series],
            [level.mean for level in series],
            method_colour(method),
            spread=[level.spread for level in series],
            strong=method in OWN,
        )
        for method, series in found.items()
    ]
    return Panel(title, curves, note, "noise, % of max|W|", y_label, log_y=log, named=True)


def _against_published(found: Mapping[str, Sequence[Level]]) -> Panel:
    curves = []
    for method, values in published.NOISE.items():
        colour = method_colour(method)
        if method in found:
            series = found[method]
            x, y = [100 * level.ratio for level in series], [level.mean for level in series]
            spread = [level.spread for level in series]
            curves.append(Curve(method_title(method), x, y, colour, spread=spread, strong=method in OWN))
        x = [100 * ratio for ratio in published.NOISE_RATIOS]
        curves.append(
            Curve("" if method in found else f"{method_title(method)}, published", x, list(values), colour, quiet=True)
        )
    return Panel("The paper's three", curves, "dotted: as published, on other faces", "noise, % of max|W|", named=True)


def _order(found: Mapping[str, Sequence[Level]]) -> Finding:
    claim = "Algorithm 2 is better than Algorithm 1, and both than DS, at every level of noise."
    by = {method: {level.ratio: level.mean for level in found.get(method, ())} for method in (*OWN, "ds")}
    missing = [method_title(method) for method, values in by.items() if not values]
    if missing:
        return Finding(claim, "not measured", f"Without numbers: {listed(missing)}.")
    first, second, ds = by["grassmann"], by["geometry-aware"], by["ds"]
    ratios = sorted(ratio for ratio in first if ratio > 0 and ratio in second and ratio in ds)
    if not ratios:
        return Finding(claim, "not measured", "There is no level of noise that all three have numbers at.")
    ahead = [ratio for ratio in ratios if second[ratio] < first[ratio] * (1.0 - _EQUAL)]
    behind = [ratio for ratio in ratios if second[ratio] > first[ratio] * (1.0 + _EQUAL)]
    both = [ratio for ratio in ratios if max(first[ratio], second[ratio]) < ds[ratio]]
    full = len(ahead) == len(both) == len(ratios)
    verdict = "reproduced" if full else "in part" if len(both) == len(ratios) or ahead else "not reproduced"
    text = (
        f"Both are better than DS at {len(both)} of {len(ratios)} levels; Algorithm 2 is better than Algorithm 1 at "
        f"{len(ahead)}, worse at {len(behind)} and equal within {100 * _EQUAL:g}% at the others. "
    )
    text += "; ".join(
        f"{100 * ratio:g}%: Algorithm 2 {error_text(second[ratio])}, Algorithm 1 {error_text(first[ratio])}, DS "
        f"{error_text(ds[ratio])}"
        for ratio in (ratios[0], ratios[-1])
    )
    return Finding(claim, verdict, text + ".")


def _strongest(found: Mapping[str, Sequence[Level]]) -> Finding:
    claim = "Under strong noise both algorithms are more accurate than every other method of the paper's comparison."
    last = {method: series[-1] for method, series in found.items() if series[-1].ratio > 0}
    top = max((level.ratio for level in last.values()), default=0.0)
    means = {method: level.mean for method, level in last.items() if level.ratio == top}
    ours = {method: value for method, value in means.items() if method in OWN}
    others = {method: value for method, value in means.items() if method in published.COMPARED}
    if len(ours) < 2 or not others:
        return Finding(claim, "not measured", "The two, or all others, have no numbers under noise.")
    rival = min(others, key=others.__getitem__)
    better = sum(value < others[rival] for value in ours.values())
    verdict = ("not reproduced", "in part", "reproduced")[better]
    text = (
        f"At {100 * top:g}%: {listed([f'{method_title(m)} {error_text(v)}' for m, v in ours.items()])}; the best of "
        f"{len(others)} others is {method_title(rival)} with {error_text(others[rival])}."
    )
    newer = {m: v for m, v in means.items() if m not in ours and m not in others and v < min(ours.values())}
    if newer:
        named = listed([f"{method_title(m)} {error_text(v)}" for m, v in newer.items()])
        text += f" Outside that comparison, better still: {named}."
    return Finding(claim, verdict, text)


def _slopes(found: Mapping[str, Sequence[Level]]) -> Finding:
    told = {m: float(np.polyfit(published.NOISE_RATIOS, v, 1)[0]) for m, v in published.NOISE.items()}
    claim = (
        f"The error of both algorithms grows gently with the noise: by {told['grassmann']:.2f} (Algorithm 1) and "
        f"{told['geometry-aware']:.2f} (Algorithm 2) per unit of the ratio."
    )
    slopes = {method: slope for method in OWN if (slope := _slope(found.get(method, ()))) is not None}
    if len(slopes) < 2:
        return Finding(claim, "not measured", "Two levels of noise are needed.")
    gentle = [method for method, slope in slopes.items() if slope <= _LIKE * told[method]]
    verdict = ("not reproduced", "in part", "reproduced")[len(gentle)]
    text = f"Measured: {listed([f'{method_title(m)} {s:.2f}' for m, s in slopes.items()])}"
    ds = _slope(found.get("ds", ()))
    text += f"; DS {ds:.2f} (published {told['ds']:.2f})." if ds is not None else "."
    return Finding(claim, verdict, f"{text} Counted as gentle: at most {_LIKE:g} times the published slope.")
