"""Error against p, the dimension of the spatial subspaces, for both algorithms (the paper's analysis 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import COLOURS, Curve, Panel, curve_figure, method_colour
from nrsfm.experiments.rows import (
    collect,
    e3d,
    enough,
    error_text,
    face_number,
    in_order,
    listed,
    method_title,
    noise_title,
    noises,
    sequence_title,
    some_of,
    spearman,
    table_lines,
    usable,
)

_DIMENSIONS = (2, 4, 6, 8, 10, 12, 15, 20, 25, 30, 40)
_QUICK = (2, 4, 8, 15, 30)
_NOISE = 0.03
_METHODS = ("grassmann", "geometry-aware")
_ENOUGH = {1: (10, 15), 2: (10, 15), 3: (25, 30), 4: (25, 30)}
# The paper's curve for Algorithm 2, read off its figure.
_PUBLISHED = {1: ((3, 9, 15), (0.167, 0.082, 0.040)), 3: ((15, 27), (0.066, 0.027))}


class SingularValues:
    """Error against p, with true cameras."""

    name = "singular-values"
    title = "How many singular vectors a subspace needs"
    question = "How does the error change with p, the dimension of the spatial subspaces?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Both algorithms, four faces, with and without noise, p from 2 to 40.

        3,000 points give 10 cells of 300 points each, the least of the paper's 10 to 50; what p is enough depends on
        the expressions, not on the density.
        """
        faces = scope.faces()[::2] if scope.quick else scope.faces()
        points = 1500 if scope.quick else 3000
        return [
            Cell(Data(name, noise, points=points), method, "known", (("spatial_dimension", p),), ("errors",))
            for name in faces
            for noise in (0.0, _NOISE)
            for method in scope.using(_METHODS)
            for p in (_QUICK if scope.quick else _DIMENSIONS)
        ]

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell."""
        return collect(cells, records, lambda _, record: [{"e3d": e3d(record)}])

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """A panel for each face, a row for each noise."""
        good = usable(rows, "e3d")
        if not good:
            return []
        sequences, levels = in_order(good, "sequence"), noises(good)
        grid = [
            [
                self._panel(good, name, noise, j == 0, j == len(sequences) - 1, i == len(levels) - 1)
                for j, name in enumerate(sequences)
            ]
            for i, noise in enumerate(levels)
        ]
        subtitle = (
            "ring: from here on within 5% of the least error · grey: enough in the paper · dotted: the paper’s curve"
        )
        figure = curve_figure("Error against p, the dimension of a subspace", subtitle, grid)
        caption = (
            "e3D of both algorithms against p, each frame aligned, true cameras. Grey: what the paper found to be "
            "enough. Dotted: the paper's curve of Algorithm 2, on the original sequence."
        )
        return [Picture(self.name, figure, caption)]

    def _panel(self, rows: Sequence[Row], name: str, noise: float, first: bool, last: bool, bottom: bool) -> Panel:
        curves = []
        for method in in_order(rows, "method"):
            p, error = _curve(rows, name, noise, method)
            if p:
                title = method_title(method)
                second = method == "geometry-aware"  # the two often lie on each other
                ring = (enough(p, error),)
                curves.append(Curve(title, p, error, method_colour(method), dashed=second, ring=ring))
        number = face_number(name)
        if not noise and number in _PUBLISHED:
            curves.append(Curve("", *_PUBLISHED[number], COLOURS[5], quiet=True))
        band = (*_ENOUGH[number], "") if number and not noise else None
        return Panel(
            sequence_title(name),
            curves,
            noise_title(noise),
            x_label="p" if bottom else "",
            y_label="e3D" if first else "",
            band=band,
            log_y=True,
            named=last,
            x_limits=(0, max(row["spatial_dimension"] for row in rows) + 1),
        )

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """The error falls with p; so many are enough."""
        claim_fall = "The error falls as p grows, for both algorithms."
        claim_enough = "10 to 15 singular vectors are enough for faces 1 and 2, 25 to 30 for faces 3 and 4."
        good = usable(rows, "e3d", noise=0.0)
        curves = {
            (name, method): curve
            for name in in_order(good, "sequence")
            for method in in_order(good, "method")
            if len((curve := _curve(good, name, 0.0, method))[0]) >= 3
        }
        if not curves:
            return [
                Finding(claim, "not measured", "No curve has three points.") for claim in (claim_fall, claim_enough)
            ]
        falls = {key: _falls(*curve) for key, curve in curves.items()}
        number = sum(falls.values())
        verdict = "reproduced" if number == len(falls) else "in part" if number else "not reproduced"
        told = [
            f"{sequence_title(name)}, {method_title(method)}: {error_text(error[0])} at p = {p[0]}, "
            f"{error_text(error[-1])} at p = {p[-1]}"
            for (name, method), (p, error) in curves.items()
        ]
        text = f"It does in {number} of {len(falls)} curves without noise, with true cameras ({some_of(told)})."
        found = [Finding(claim_fall, verdict, text), self._enough(claim_enough, curves, falls)]
        return found + self._noisy(rows)

    def _enough(
        self,
        claim: str,
        curves: Mapping[tuple[str, str], tuple[list[int], list[float]]],
        falls: Mapping[tuple[str, str], bool],
    ) -> Finding:
        told, within, below = [], 0, 0
        judged = [key for key in curves if face_number(key[0])]
        for name, method in judged:
            p = enough(*curves[name, method])
            low, high = _ENOUGH[face_number(name) or 1]
            within += low <= p <= high and falls[name, method]
            below += p < low or not falls[name, method]
            told.append(f"{sequence_title(name)}, {method_title(method)}: {p:g}")
        if not judged:
            return Finding(claim, "not measured", "None of the faces was computed.")
        verdict = "reproduced" if within == len(judged) else "not reproduced" if not within else "in part"
        end = ""
        if below:
            end = f" In {below} of {len(judged)} fewer are enough than the paper found."
        if (more := len(judged) - within - below) > 0:
            end += f" In {more} of {len(judged)} more are needed."
        text = f"From this p on the error is within 5% of its least ({'; '.join(told)}).{end}"
        return Finding(claim, verdict, text)

    def _noisy(self, rows: Sequence[Row]) -> list[Finding]:
        """What noise changes: not a claim of the paper's, but its natural question."""
        good = usable(rows, "e3d")
        worse, told = 0, []
        levels = [noise for noise in noises(good) if noise]
        for noise in levels:
            for name in in_order(good, "sequence"):
                p, error = _curve(good, name, noise, "geometry-aware")
                if len(p) >= 3:
                    best = error.index(min(error))
                    worse += error[-1] > 1.03 * error[best]
                    told.append(f"{sequence_title(name)}: least at p = {p[best]}, {error_text(error[best])}, "
                                f"{error_text(error[-1])} at p = {p[-1]}")  # fmt: skip
        if not told:
            return []
        claim = "A small p also protects against noise (not claimed in the paper; the question is ours)."
        verdict = "reproduced" if worse == len(told) else "in part" if worse else "not reproduced"
        why = (
            " The compression has already shrunk the noise out of every cell, so that a large p finds nothing to add."
            if worse < len(told)
            else ""
        )
        text = f"With {listed([noise_title(n) for n in levels])}, Algorithm 2: {some_of(told)}.{why}"
        return [Finding(claim, verdict, text)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Values of p down, faces across, for each algorithm and noise."""
        good = usable(rows, "e3d")
        if not good:
            return []
        heads = [
            (name, noise, method)
            for noise in noises(good)
            for method in in_order(good, "method")
            for name in in_order(good, "sequence")
        ]
        values = {(r["sequence"], r["noise"], r["method"], r["spatial_dimension"]): r["e3d"] for r in good}
        lines = []
        for noise in noises(good):
            some = [head for head in heads if head[1] == noise]
            lines += [f"e3D, {noise_title(noise)}:", ""]
            lines += table_lines(
                ["p", *(f"{sequence_title(n)}, {method_title(m)}" for n, _, m in some)],
                [
                    [str(p), *(error_text(values.get((*head, p))) for head in some)]
                    for p in sorted({r["spatial_dimension"] for r in good})
                ],
            )
        return lines


def _curve(rows: Sequence[Row], name: str, noise: float, method: str) -> tuple[list[int], list[float]]:
    some = sorted(
        usable(rows, "e3d", sequence=name, noise=noise, method=method), key=lambda row: int(row["spatial_dimension"])
    )
    return [row["spatial_dimension"] for row in some], [row["e3d"] for row in some]


def _falls(p: Sequence[float], error: Sequence[float]) -> bool:
    """From the least p to the best the error falls by a tenth, and nowhere in between does it rise much."""
    best = error.index(min(error))
    return error[0] > 1.1 * error[best] and spearman(p[: best + 1], error[: best + 1]) < -0.7 if best else False
