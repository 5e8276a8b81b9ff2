"""Trajectories torn at the borders of temporal groups (the paper's figure of hard temporal grouping).

A border between groups of frames may break a smooth trajectory. Measured as the root mean square over points of the
second difference over time of the error, at borders relative to elsewhere: about 1 where borders tear nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.curves import COLOURS, Curve, Panel, curve_figure
from nrsfm.experiments.rows import (
    collect,
    e3d,
    error_text,
    in_order,
    noise_title,
    noises,
    sequence_title,
    table_lines,
    usable,
)

_NOISE = 0.03
_TORN = 1.5
_COUNTS, _DIMENSIONS = (2, 4, 8), (5, 10)
_LONG = ("face-seq3", "face-seq4", "ict-rom99")
Options = tuple[tuple[str, Any], ...]


class TemporalTearing:
    """The jump in acceleration at group borders."""

    name = "temporal-tearing"
    title = "Trajectories at the borders of temporal groups"
    question = "Do hard temporal groups break trajectories?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Algorithm 1 with K_t runs of frames or k-means cells, of dimension 5, 10 or chosen; without; Algorithm 2.

        Frames that follow one another: the long faces and ict, 3,000 points, true cameras, so that nothing has to be
        aligned. The groups are kept apart (``grouping`` off merges no cells of frames).
        """
        names = scope.having(_LONG[:1] if scope.quick else _LONG)
        points = 600 if scope.quick else 3000
        cells = []
        for name in names:
            for noise in (_NOISE,) if scope.quick else (0.0, _NOISE):
                data = Data(name, noise, points=points)
                variants: list[tuple[str, Options]] = [("geometry-aware", ()), ("grassmann", (("temporal", False),))]
                for kind in ("consecutive", "kmeans"):
                    for count in (2, 8) if scope.quick else _COUNTS:
                        for dimension in (None, 5) if scope.quick else (None, *_DIMENSIONS):
                            options: Options = (("temporal_cells", count), ("temporal_kind", kind), ("grouping", False))
                            options += (("temporal_dimension", dimension),) if dimension else ()
                            variants.append(("grassmann", options))
                cells += [
                    Cell(data, method, "known", options, ("errors", "acceleration", "chosen"))
                    for method, options in variants
                    if scope.using([method])
                ]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell: ``jump`` is the acceleration of the error at borders over that elsewhere.

        For variants without temporal groups it is taken at the borders that four runs of frames would have.
        """

        def take(cell: Cell, record: Record) -> Iterable[Row]:
            found = record.get("acceleration")
            if found is None:
                return [{"error": "the truth, or its frame, is not known"}]
            frames = len(found["track"])
            given = record["chosen"].get("temporal_borders")
            borders = [frames * k // 4 for k in range(1, 4)] if given is None else given
            return [
                {
                    "kind": kind(dict(cell.options), cell.method),
                    "e3d": e3d(record),
                    "jump": jump(found["error"], borders),
                    "true_jump": jump(found["truth"], borders),
                    "borders": borders,
                    "own_borders": given is not None,
                    "track": [round(v, 5) for v in found["track"]],
                    "true_track": [round(v, 5) for v in found["true_track"]],
                    "acceleration": [float(f"{v:.4g}") for v in found["error"]],
                }
            ]

        return collect(cells, records, take)

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """One trajectory with its borders; the jump of all variants."""
        good = usable(rows, "jump")
        if not good:
            return []
        found = [self._trajectories(good)]
        if usable(good, own_borders=True):
            found.append(self._jumps(good))
        return found

    def _trajectories(self, rows: Sequence[Row]) -> Picture:
        """The most torn of the variants with runs of frames, those without temporal groups: one point over time."""
        own = usable(rows, "jump", own_borders=True) or list(rows)
        own = usable(own, temporal_kind="consecutive") or own  # few borders, which can be seen one by one
        worst = max(own, key=lambda row: float(row["jump"]))
        same = usable(rows, sequence=worst["sequence"], noise=worst["noise"])
        shown = [worst, *[row for row in same if not row["own_borders"]][::-1]]
        frames = list(range(len(worst["track"])))
        grid, values = [], np.array([row[name] for row in shown for name in ("track", "true_track")])
        low, high = float(values.min()), float(values.max())
        room = 0.08 * (high - low) + 1e-9
        for row in shown:
            curves = [
                Curve("truth", frames, row["true_track"], "#a8937c"),
                Curve("recovered", frames, row["track"], COLOURS[1]),
            ]
            borders = row["borders"] if row["own_borders"] else ()
            top = max([*worst["acceleration"], *row["acceleration"]])
            grid.append(
                [
                    Panel(row["kind"], curves, f"position of one point, object’s size = 1; {_count(borders)}",
                          uprights=[b - 0.5 for b in borders], named=True, limits=(low - room, high + room),
                          x_label="frame" if row is shown[-1] else ""),
                    Panel("", [Curve("", frames[1:-1], row["acceleration"], COLOURS[1])],
                          f"acceleration of the error, all points; at borders {row['jump']:.1f}× elsewhere",
                          uprights=[b - 0.5 for b in borders], limits=(0.0, 1.1 * top),
                          x_label="frame" if row is shown[-1] else ""),
                ]
            )  # fmt: skip
        figure = curve_figure(
            "A trajectory at the borders of temporal groups",
            f"{sequence_title(worst['sequence'])}, {noise_title(worst['noise'])}, true cameras · "
            "dashed: borders between groups of frames",
            grid,
            tall=1.5,
            share="none",
        )
        caption = (
            "The point that moves most in truth, along the direction in which it moves most, in the variant with runs "
            "of frames that has the largest jump, and in those without temporal groups. Nothing is aligned."
        )
        return Picture(f"{self.name}-trajectory", figure, caption)

    def _jumps(self, rows: Sequence[Row]) -> Picture:
        names, levels = in_order(rows, "sequence"), noises(rows)
        grid = [
            [
                Panel(
                    sequence_title(name),
                    _jump_curves(usable(rows, "jump", sequence=name, noise=noise), noise),
                    noise_title(noise),
                    x_label="K_t" if noise == levels[-1] else "",
                    y_label="jump" if name == names[0] else "",
                    ticks=[(count, str(count)) for count in _COUNTS],
                    log_y=True,
                    level=1.0,
                    named=name == names[-1],
                )
                for name in names
            ]
            for noise in levels
        ]
        figure = curve_figure(
            "Acceleration at the borders of temporal groups",
            "that of the error, at borders over elsewhere · 1: borders tear nothing",
            grid,
            share="all",
            names=1.4,
        )
        caption = (
            "Root mean square of the second difference over time of S − S_GT, at frames beside a border over that "
            "at the others. Runs: consecutive frames; k-means: frames of similar shape; p_t free: from the noise."
        )
        return Picture(f"{self.name}-jumps", figure, caption)

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """Hard groups tear; without them nothing does; what it costs."""
        good = usable(rows, "jump")
        own, others = usable(good, own_borders=True), usable(good, own_borders=False)
        claim = "Hard temporal groups tear trajectories at their borders."
        if not own:
            return [Finding(claim, "not measured", "No run with temporal groups has a border.")]
        # What is left of a border that tears nothing: the same measure at borders that no method drew.
        base = max([_TORN, *(1.2 * row["jump"] for row in others)])
        torn = [row for row in own if row["jump"] > base]
        verdict = "reproduced" if len(torn) > len(own) / 2 else "in part" if torn else "not reproduced"
        worst = max(own, key=lambda row: float(row["jump"]))
        text = (
            f"In {len(torn)} of {len(own)} runs of Algorithm 1 with temporal groups the error accelerates at borders "
            f"by more than {base:.1f} times what it does elsewhere; most in {_words(worst)}: {worst['jump']:.1f} times."
        )
        if others:
            most = max(row["jump"] for row in others)
            text += f" Without temporal groups, at the same kind of border: at most {most:.1f} times."
        found = [Finding(claim, verdict, text)]
        free = [row for row in own if row.get("temporal_dimension") is None]
        fixed = [row for row in own if row.get("temporal_dimension") is not None]
        if free and fixed:
            claim = (
                "The dimension of the temporal subspaces decides it (not claimed in the paper; the question is ours)."
            )
            share = [sum(row["jump"] > base for row in some) / len(some) for some in (free, fixed)]
            verdict = "reproduced" if share[0] < 0.5 * share[1] else "not reproduced"
            text = (
                f"Torn are {100 * share[1]:.0f}% of the runs of fixed dimension and {100 * share[0]:.0f}% of those in "
                f"which it follows the noise."
            )
            found.append(Finding(claim, verdict, text))
        return found

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Variants down; jump and error of each sequence across."""
        good = usable(rows, "jump")
        heads = sorted({(row["noise"], row["sequence"]) for row in good})
        body = []
        for variant in in_order(good, "kind"):
            shown = []
            for noise, name in heads:
                some = usable(good, kind=variant, sequence=name, noise=noise)
                shown.append(f"{some[0]['jump']:.2f}× ({error_text(some[0]['e3d'])})" if some else "–")
            body.append([variant, *shown])
        if not body:
            return []
        head = [f"{sequence_title(n)}{', noise' if v else ''}" for v, n in heads]
        return ["Jump at borders, and e3D:", "", *table_lines(["variant", *head], body)]


def _jump_curves(rows: Sequence[Row], noise: float) -> list[Curve]:
    """A curve over K_t for each kind of groups and dimension; a free dimension cuts nothing where there is no noise."""
    curves = []
    for i, (group, word) in enumerate((("consecutive", "runs"), ("kmeans", "k-means"))):
        for dimension in (None, 10, 5) if noise else (10, 5):
            some = [row for row in usable(rows, temporal_kind=group) if row.get("temporal_dimension") == dimension]
            some.sort(key=lambda row: int(row["temporal_cells"]))
            if some:
                words = f"{word}, p_t {dimension or 'free'}"
                colour = COLOURS[i] if dimension else COLOURS[i + 2]
                x, y = [row["temporal_cells"] for row in some], [row["jump"] for row in some]
                curves.append(Curve(words, x, y, colour, dashed=dimension == 5))
    return curves


def jump(acceleration: Sequence[float], borders: Sequence[int]) -> float | None:
    """Mean acceleration at frames whose second difference spans a border, over the mean elsewhere.

    ``acceleration[i]`` belongs to frame i + 1; a border b lies between frames b − 1 and b. ``None`` without borders, or
    where no frame is away from them.
    """
    at = np.zeros(len(acceleration), dtype=bool)
    for b in borders:
        for frame in (b - 1, b):
            if 1 <= frame <= len(acceleration):
                at[frame - 1] = True
    values = np.asarray(acceleration, dtype=np.float64)
    if not at.any() or at.all() or values[~at].mean() <= 0:
        return None
    return float(values[at].mean() / values[~at].mean())


def kind(options: Mapping[str, Any], method: str) -> str:
    """The variant in words."""
    if method == "geometry-aware":
        return "Algorithm 2"
    if options.get("temporal") is False:
        return "Algorithm 1 without temporal groups"
    groups = "runs of frames" if options["temporal_kind"] == "consecutive" else "k-means cells of frames"
    dimension = options.get("temporal_dimension")
    size = f"dimension {dimension}" if dimension else "dimension from the noise"
    return f"Algorithm 1, {options['temporal_cells']} {groups}, {size}"


def _words(row: Row) -> str:
    return f"{row['kind']} ({sequence_title(row['sequence'])}, {noise_title(row['noise'])})"


def _count(borders: Sequence[int]) -> str:
    return f"{len(borders)} border{'s' if len(borders) != 1 else ''}" if borders else "no borders"
