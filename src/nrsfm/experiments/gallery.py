"""Every sequence drawn: tracks of one frame, the reconstruction from three sides, the truth, the subspaces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.rows import collect, e3d, error_text, listed, sequence_title, table_lines, usable
from nrsfm.viewing.panels import Window, box, caption, draw_shape, window
from nrsfm.viewing.scene import Scene, turned
from nrsfm.viewing.style import ESTIMATE, GREY, INK, TRUTH, WIDTH, group_colours, house_style, new_figure, rgb
from nrsfm.viewing.tracks import place_colours, set_window, spread_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_METHOD = "geometry-aware"
_LONGEST = 400  # frames
_PAGES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("faces", "Faces", ("original-face", "face-seq", "built-in-face", "original-actor", "ict-")),
    (
        "surfaces",
        "Surfaces",
        ("original-paper", "original-tshirt", "built-in-sheet", "mesh_horse", "back_", "mat1500", "flag250", "hulk"),
    ),
    ("motion-capture", "Motion capture", ("pickup", "yoga", "stretch", "drink", "dance", "walking", "shark", "face1")),
)
_QUICK = ("face-seq1", "pickup", "back_real126")
# Their y axis points up; in pictures it points down.
_Y_UP = ("face-seq", "ict-", "pickup", "yoga", "stretch", "drink", "walking", "shark", "dance")
_SIDE = 50.0
_HEADER, _EDGE, _NAMES, _TALL, _LEAST = 1.36, 0.22, 1.42, 1.5, 0.85
_FILLED, _BETWEEN = 0.96, 0.16  # share of a column; inches between rows
_COLUMNS = ("tracks", "from one side", "from the front", "from the other", "truth", "subspaces")


class Gallery:
    """Pictures of every sequence."""

    name = "gallery"
    title = "Gallery"
    question = "What do the reconstructions look like?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Algorithm 2 with its own cameras on every sequence, dense where it is; the first 400 frames."""
        names = scope.having(_QUICK) if scope.quick else list(scope.sequences)
        return [
            Cell(Data(name, frames=_LONGEST), method, "own", (), ("errors", "rotation", "groups", "gallery"))
            if not name.startswith("built-in")  # those would be generated with so many frames
            else Cell(Data(name), method, "own", (), ("errors", "rotation", "groups", "gallery"))
            for name in names
            for method in scope.using([_METHOD])
        ]

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a sequence; ``arrays`` is the file with what is drawn."""

        def take(_: Cell, record: Record) -> Iterable[Row]:
            size = {name: record.get(name) for name in ("frames", "points")}
            found = {"e3d": e3d(record), "rotation": record["rotation"], "groups": record["groups"]}
            return [size | found | {"arrays": record["gallery"]}]

        return collect(cells, records, take)

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """A page for each kind of sequence."""
        good = [row for row in usable(rows) if row.get("arrays")]
        found, left = [], {row["sequence"]: row for row in good}
        for stem, title, starts in _PAGES:
            some = [row for start in starts for name, row in left.items() if name.startswith(start)]
            some = [row for row in some if left.pop(row["sequence"], None) is not None]
            if some:
                found.append(self._page(f"{self.name}-{stem}", title, some))
        if left:
            found.append(self._page(f"{self.name}-others", "Other sequences", list(left.values())))
        return found

    def _page(self, name: str, title: str, rows: Sequence[Row]) -> Picture:
        caption_text = (
            "Algorithm 2 with its own cameras; of each sequence the frame that is least like the others. Tracks are "
            "coloured by place, the points of a subspace alike; the truth is seen as in the picture beside it."
        )
        if any(row["sequence"].startswith("face-seq") for row in rows):
            caption_text += " The mesh of the stand-in faces has a seam beside the mouth, in the truth as well."
        return Picture(name, gallery_figure(f"{title}: tracks in, shapes out", rows), caption_text)

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """Whether the shapes are reliable, by number and with the names of those that are not."""
        claim = "The method recovers the 3D shape of the deforming subject reliably and accurately."
        good = usable(rows, "e3d")
        if not good:
            return [Finding(claim, "not measured", "No sequence with known truth was reconstructed.")]
        close = [row for row in good if row["e3d"] < 0.1]
        far = sorted((row for row in good if row["e3d"] >= 0.1), key=lambda row: -float(row["e3d"]))
        verdict = "reproduced" if not far else "in part" if close else "not reproduced"
        text = f"With its own cameras Algorithm 2 is within 10% of the truth on {len(close)} of {len(good)} sequences."
        if far:
            names = [f"{sequence_title(row['sequence'])} ({error_text(row['e3d'])})" for row in far]
            text += f" It is not on {listed(names)}."
        return [Finding(claim, verdict, text)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Sequences down."""
        body = [
            [
                sequence_title(row["sequence"]),
                f"{row['frames']} × {row['points']:,}",
                error_text(row["e3d"]),
                "–" if row["rotation"] is None else f"{row['rotation']:.1f}°",
                "–" if row["groups"] is None else str(row["groups"]),
            ]
            for row in usable(rows)
        ]
        return table_lines(["sequence", "frames × points", "e3D", "rotation error", "groups"], body) if body else []


def gallery_figure(title: str, rows: Sequence[Row]) -> Figure:
    """A row of pictures for each sequence."""
    column = (WIDTH - _NAMES - _EDGE) / len(_COLUMNS)
    drawn = []
    for row in rows:
        with np.load(row["arrays"]) as kept:
            arrays = upright({name: kept[name] for name in kept.files}, row["sequence"])
        drawn.append((row, int(arrays["frame"]), _Strip(arrays, column)))
    with house_style():
        height = _HEADER + sum(strip.tall + _BETWEEN for _, _, strip in drawn) + 0.1
        figure = new_figure(height, title, "one frame of each sequence · Algorithm 2, cameras estimated")
        for j, word in enumerate(_COLUMNS):
            centre = _NAMES + (j + 0.5) * column
            caption(figure, centre, _HEADER - 0.36, word, weight="bold", color=INK, size=9)
        top = _HEADER
        for row, frame, strip in drawn:
            _describe(figure, row, frame, top + strip.tall / 2, height)
            strip.draw(figure, top)
            top += strip.tall + _BETWEEN
    return figure


def upright(arrays: dict[str, np.ndarray], sequence: str) -> dict[str, np.ndarray]:
    """The arrays turned about x by half a turn where the sequence's y axis points up."""
    if not sequence.startswith(_Y_UP):
        return arrays
    signs = np.array([1.0, -1.0, -1.0])
    turns = {2: signs[:2], 3: signs}
    names = ("tracks", "widest", "shape", "truth")
    return arrays | {name: arrays[name] * turns[arrays[name].shape[1]] for name in names if name in arrays}


def _describe(figure: Figure, row: Row, frame: int, middle: float, height: float) -> None:
    lines: list[tuple[str, dict[str, Any]]] = [
        (sequence_title(row["sequence"]), {"size": 9.5, "weight": "bold", "color": INK}),
        (f"{row['frames']} × {row['points']:,}", {"size": 8.2, "color": GREY}),
        (f"frame {frame}", {"size": 8.2, "color": GREY}),
        (f"e3D {error_text(row['e3d'])}" if row.get("e3d") is not None else "no truth", {"size": 8.2, "color": GREY}),
    ]
    for i, (text, style) in enumerate(lines):
        up = middle + (i - (len(lines) - 1) / 2) * 0.18
        figure.text(0.3 / WIDTH, 1 - up / height, text, va="center", **style)


class _Strip:
    """One sequence: panels side by side, as high as the highest of them needs."""

    def __init__(self, arrays: dict[str, np.ndarray], column: float) -> None:
        self._column = column
        shape = np.asarray(arrays["shape"], dtype=np.float64)
        self._truth_known, self._grouped = "truth" in arrays, "groups" in arrays
        self._scene = Scene(
            frames=np.zeros(1, dtype=int),
            shapes=shape[None],
            truth=None,
            views=np.eye(3)[None],
            middle=np.eye(3),
            triangles=arrays.get("triangles"),
            edges=arrays.get("edges"),
            errors=None,
            size=1.0,
            alignment="",
        )
        views = [turned(np.eye(3), angle) for angle in (_SIDE, 0.0, -_SIDE)]
        self._panels: list[tuple[int, np.ndarray, np.ndarray, float, bool]] = [
            (j + 1, shape @ view.T, rgb(ESTIMATE), 1.0, False) for j, view in enumerate(views)
        ]
        if self._truth_known:
            self._panels.append((4, np.asarray(arrays["truth"], dtype=np.float64) @ views[2].T, rgb(TRUTH), 1.0, False))
        if self._grouped:
            labels, palette = group_colours(arrays["groups"], shape)
            colours = palette[np.searchsorted(labels, arrays["groups"])]
            self._panels.append((5, shape, colours, 0.6, True))
        self._points, self._widest = (np.asarray(arrays[name], dtype=np.float64) for name in ("tracks", "widest"))
        self._shown = spread_points(self._widest)
        self._windows = [window([cloud], margin=0.04) for _, cloud, *_ in self._panels]
        seen = window([self._points[self._shown]], margin=0.04)
        # One scale for all shapes of the row, each around its own middle; the tracks have theirs.
        half = (max(w.half[0] for w in self._windows), max(w.half[1] for w in self._windows))
        self._units = max(2 * half[0] / (_FILLED * column), 2 * half[1] / _TALL)
        self._track_units = max(2 * seen.half[0] / (_FILLED * column), 2 * seen.half[1] / _TALL)
        self.tall = max(_LEAST, 2 * half[1] / self._units, 2 * seen.half[1] / self._track_units)
        self._seen = seen

    def draw(self, figure: Figure, top: float) -> None:
        """Draw all panels with their upper edge at ``top`` inches."""
        wide = _FILLED * self._column
        room = (wide * self._units / 2, self.tall * self._units / 2)
        for (j, cloud, colours, strength, crisp), own in zip(self._panels, self._windows, strict=True):
            draw_shape(
                figure,
                _NAMES + (j + 0.5) * self._column - wide / 2,
                top,
                self._units,
                Window(own.centre, room),
                cloud,
                colours,
                self._scene,
                strength=strength,
                crisp=crisp,
            )
        for j, known, word in ((4, self._truth_known, "not known"), (5, self._grouped, "none")):
            if not known:
                caption(figure, _NAMES + (j + 0.5) * self._column, top + self.tall / 2 - 0.06, word)
        axes = box(figure, _NAMES + 0.5 * self._column - wide / 2, top, wide, self.tall)
        set_window(axes, Window(self._seen.centre, (wide * self._track_units / 2, self.tall * self._track_units / 2)))
        places = self._points[self._shown]
        known_places = np.isfinite(places).all(axis=1)
        size = float(np.clip(1500.0 / max(len(places), 1), 2.2, 16.0))
        colours = place_colours(self._widest[self._shown])[known_places]
        axes.scatter(places[known_places, 0], places[known_places, 1], s=size, c=colours, linewidths=0)
