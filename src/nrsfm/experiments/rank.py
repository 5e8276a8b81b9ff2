"""Fit to the tracks and to the truth against the rank K (the paper's analysis 4).

PTA and MP take K as a parameter, of their own cameras too. BMM and the two algorithms leave the rank to the nuclear
norm; here their S♯ is held to rank K by the option ``rank``, and their cameras choose a K of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import Curve, Panel, curve_figure, method_colour
from nrsfm.experiments.rows import (
    collect,
    error_text,
    in_order,
    listed,
    method_title,
    pearson,
    sequence_title,
    some_of,
    table_lines,
    usable,
)

_RANKS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20)
_QUICK = (1, 2, 4, 8)
_METHODS = ("bmm", "pta", "mp", "grassmann", "geometry-aware")
_SPARSE, _GLOBAL, _OURS = ("bmm", "pta"), ("mp",), ("grassmann", "geometry-aware")
_FITS = {"reprojection": "‖W − RS‖ / ‖W‖", "shape": "‖S_GT − S‖ / ‖S_GT‖"}
_CAMERA_WORDS = {"own": "with the cameras of each method", "known": "with true cameras"}


def takes_rank(method: str) -> bool:
    """Whether the method has an option ``rank``."""
    from nrsfm.methods import get_method

    return any(field.name == "rank" for field in dataclasses.fields(get_method(method).Options))


class Rank:
    """Reprojection error and shape fit against K."""

    name = "rank"
    title = "Fit to the tracks and fit to the truth against the rank"
    question = "Do reprojection error and shape error fall together as the rank K grows?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Four faces without noise; own cameras as in the paper, and true ones, which leave only shapes to blame."""
        from nrsfm.methods import get_method

        faces = scope.faces()[::2] if scope.quick else scope.faces()
        points = 800 if scope.quick else 3000
        cells = []
        for name in faces:
            for cameras in ("own", "known"):
                for method in scope.using(_METHODS):
                    if takes_rank(method):
                        ranks = _QUICK if scope.quick else _RANKS
                        data, source = Data(name, points=points), cameras
                        if cameras == "own" and get_method(method).camera_method == "intersection":
                            source = "intersection"  # the same cameras, estimated once for every K
                        cells += [Cell(data, method, source, (("rank", k),), ("fits",)) for k in ranks]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a method and K; ``cameras`` is "own" or "known"."""
        rows = collect(cells, records, lambda _, record: [dict(record["fits"])])
        return [row | {"cameras": "known" if row["cameras"] == "known" else "own"} for row in rows]

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """One figure with own cameras, one with true ones: fits down, faces across."""
        found = []
        for cameras in in_order(rows, "cameras"):
            good = usable(rows, "rank", "reprojection", "shape", cameras=cameras)
            if not good:
                continue
            names = in_order(good, "sequence")
            grid = [
                [self._panel(good, name, fit, j == 0, j == len(names) - 1, i == 1) for j, name in enumerate(names)]
                for i, fit in enumerate(_FITS)
            ]
            figure = curve_figure(
                f"Two fits against the rank, {_CAMERA_WORDS[cameras]}",
                "above: how far the shapes are from the tracks · below: how far they are from the truth, one alignment",
                grid,
                share="row",
            )
            caption = (
                f"Relative reprojection error and shape error against K, {_CAMERA_WORDS[cameras]}, no noise. Every "
                "method is run with K as the rank of its shapes. What is below 10⁻⁴ is drawn there."
            )
            found.append(Picture(f"{self.name}-{cameras}", figure, caption))
        return found

    def _panel(self, rows: Sequence[Row], name: str, fit: str, first: bool, last: bool, bottom: bool) -> Panel:
        curves = []
        for method in in_order(rows, "method"):
            some = _by_rank(rows, name, method)
            if some:
                x, y = [row["rank"] for row in some], [max(row[fit], 1e-4) for row in some]
                curves.append(
                    Curve(method_title(method), x, y, method_colour(method), dashed=method == "geometry-aware")
                )
        most = max(int(row["rank"]) for row in rows)
        ticks = [(k, str(k)) for k in (1, 2, 5, 10, 20) if k <= most]
        return Panel(
            sequence_title(name),
            curves,
            {"reprojection": "fit to the tracks", "shape": "fit to the truth"}[fit],
            x_label="K" if bottom else "",
            y_label=_FITS[fit] if first else "",
            ticks=ticks,
            log_x=True,
            log_y=True,
            named=last,
        )

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """What the paper says of sparse methods, of MP, and of its own, judged with own cameras where there are any."""
        good = usable(rows, "rank", "reprojection", "shape")
        cameras = "own" if any(row["cameras"] == "own" for row in good) else "known"
        trends = {
            (name, method, kind): _trend(some)
            for kind in in_order(good, "cameras")
            for method in in_order(good, "method")
            for name in in_order(good, "sequence")
            if len(some := _by_rank(usable(good, cameras=kind), name, method)) >= 3
        }

        def of(methods: Sequence[str]) -> dict[tuple[str, str], _Trend]:
            return {(n, m): t for (n, m, kind), t in trends.items() if m in methods and kind == cameras}

        def told(methods: Sequence[str]) -> str:
            parts = [
                f"{method_title(m)}, {sequence_title(n)}: {t.text}"
                for (n, m, kind), t in trends.items()
                if m in methods and kind == cameras
            ]
            return f"{_CAMERA_WORDS[cameras][0].upper()}{_CAMERA_WORDS[cameras][1:]}, no noise: {some_of(parts)}."

        found = []
        for methods, claim, holds in (
            (
                _SPARSE,
                "For the sparse methods (BMM, PTA) neither the reprojection error nor the shape error falls with K.",
                lambda t: not t.reprojection_falls and not t.shape_falls,
            ),
            (
                _GLOBAL,
                "For MP the shape error does not follow the reprojection error as K grows.",
                lambda t: not t.shape_falls or t.correlation < 0.5,
            ),
            (
                _OURS,
                "For both algorithms both errors fall with K, and they correlate highly.",
                lambda t: t.reprojection_falls and t.shape_falls and t.correlation >= 0.9,
            ),
        ):
            judged = of(methods)
            if not judged:
                found.append(
                    Finding(claim, "not measured", f"No curve of {listed([method_title(m) for m in methods])}.")
                )
                continue
            count = sum(bool(holds(trend)) for trend in judged.values())
            verdict = "reproduced" if count == len(judged) else "in part" if count else "not reproduced"
            text = f"So in {count} of {len(judged)} curves. {told(methods)}"
            found.append(Finding(claim, verdict, text))
        return found

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Errors at the least and the greatest K, and their correlation."""
        good = usable(rows, "rank", "reprojection", "shape")
        lines = []
        for cameras in in_order(good, "cameras"):
            body = []
            for method in in_order(good, "method"):
                for name in in_order(good, "sequence"):
                    some = _by_rank(usable(good, cameras=cameras), name, method)
                    if len(some) < 2:
                        continue
                    best = min(some, key=lambda row: float(row["shape"]))
                    body.append(
                        [
                            method_title(method),
                            sequence_title(name),
                            *(f"{error_text(some[0][fit])} → {error_text(some[-1][fit])}" for fit in _FITS),
                            f"{error_text(best['shape'])} at K = {best['rank']}",
                            _signed(_trend(some).correlation),
                        ]
                    )
            if body:
                last = f"K = {good[0]['rank']} to the greatest"
                lines += [f"{_CAMERA_WORDS[cameras][0].upper()}{_CAMERA_WORDS[cameras][1:]}, from {last}:", ""]
                head = ["method", "sequence", "reprojection", "shape", "least shape error", "correlation"]
                lines += table_lines(head, body)
        return lines


@dataclasses.dataclass(frozen=True)
class _Trend:
    reprojection_falls: bool
    shape_falls: bool
    correlation: float
    text: str


def _signed(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")


def _by_rank(rows: Sequence[Row], name: str, method: str) -> list[Row]:
    return sorted(usable(rows, sequence=name, method=method), key=lambda row: int(row["rank"]))


def _trend(rows: Sequence[Row]) -> _Trend:
    """How both fits go with K: one falls if it ends a tenth below its start and within a tenth of its least."""
    fits = {fit: [float(row[fit]) for row in rows] for fit in _FITS}

    def falls(values: Sequence[float]) -> bool:
        return values[-1] < 0.9 * values[0] and values[-1] <= 1.1 * min(values) + 1e-4

    correlation = pearson(fits["reprojection"], fits["shape"])
    words = [f"{word} {error_text(fits[fit][0])} → {error_text(fits[fit][-1])}" for fit, word in
             (("reprojection", "tracks"), ("shape", "truth"))]  # fmt: skip
    return _Trend(
        falls(fits["reprojection"]),
        falls(fits["shape"]),
        correlation,
        f"{', '.join(words)}, r = {_signed(correlation)}",
    )
