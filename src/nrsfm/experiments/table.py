"""Every method on every sequence: the paper's table, with more of both.

Each method runs with the cameras it was published with, with those of the intersection method, and with the true ones
where they are known, so that errors of shapes and of cameras can be told apart. A method that was published with the
intersection method runs once for the first two.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from nrsfm.experiments import published, sequences
from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.heat import Column, Field, heat_figure
from nrsfm.experiments.markdown import folded, table
from nrsfm.experiments.measures import ALIGNMENTS
from nrsfm.experiments.rows import error_text, in_order, method_title, sequence_title
from nrsfm.experiments.table_findings import (
    KINDS,
    OWN,
    best_of_all,
    limits,
    main_error,
    second_beats_first,
    sparse_methods,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MANY = 22  # columns, from which numbers are written with three digits

_QUICK = (Data("face-seq1", points=800), Data("face1", points=400, frames=40))
_GROUPS = (
    ("original-", "original files"),
    ("face-seq", "faces, stand-ins"),
    ("built-in", "built in"),
    ("ict", "ict faces"),
    ("back", "perspective"),
    ("mat", "perspective"),
    ("flag", "perspective"),
    ("hulk", "perspective"),
    ("mesh", "mesh"),
)


class Table:
    """The paper's table of methods and sequences."""

    name = "table"
    title = "Methods and sequences"
    question = "Which method recovers the shapes best, on which data, at what price?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Every method on every sequence with every kind of cameras; quick: two sequences, cut."""
        if scope.quick:
            asked = [Data(n, points=q.points, frames=q.frames) for q in _QUICK for n in scope.having([q.sequence])]
            asked = asked or [Data(name, points=800, frames=40) for name in scope.sequences[:1]]
        else:
            asked = [Data(name) for name in scope.sequences]
        cells = []
        for data in dict.fromkeys(asked):
            for method in scope.using():
                kinds = ["own"] if uses_intersection(method) else ["own", "intersection"]
                kinds += ["known"] if sequences.has_cameras(data.sequence) else []
                cells += [Cell(data, method, kind) for kind in kinds]
        return cells

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell."""
        return [_row(cell, records[cell.key]) for cell in cells if cell.key in records]

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """One heat table for each kind of cameras, and one of seconds."""
        found = []
        for kind, words in KINDS.items():
            chosen = _of_kind(rows, kind)
            if not any("error" not in row for row in chosen):
                continue
            name = self.name if kind == "own" else f"{self.name}-{kind}"
            found.append(Picture(name, _heat(chosen, words), _caption(kind)))
        if found:
            seconds = _heat_of_seconds(_of_kind(rows, "own"))
            found.append(
                Picture(
                    f"{self.name}-seconds",
                    seconds,
                    "Seconds of one call with own cameras, on one thread, while other cells ran beside it.",
                )
            )
        return found

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """The paper's claims about its table, and whether every method keeps the limits."""
        return [
            *(best_of_all(_of_kind(rows, kind), kind) for kind in ("own", "intersection")),
            second_beats_first(_of_kind(rows, "own")),
            sparse_methods(_of_kind(rows, "own")),
            limits(rows),
        ]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """The main errors, published ones beside them; everything else folded."""
        if not rows:
            return []
        lines = [
            "e3D with each frame aligned on its own by an orthogonal matrix; under perspective, where tracks and truth "
            "have different units, by a similarity (marked ~). Bold: the best of its row.",
            "",
        ]
        for kind, words in KINDS.items():
            chosen = _of_kind(rows, kind)
            if chosen:
                lines += [f"**{words[0].upper()}{words[1:]}**", "", *_matrix(chosen, "main")]
        lines += _published(_of_kind(rows, "own"))
        for kind, words in KINDS.items():
            chosen = _of_kind(rows, kind)
            for column, title in _FOLDED.items():
                if column == "e3d_none" and kind != "known":
                    continue  # estimated cameras leave the object frame open: the number would say nothing
                having = {row["sequence"] for row in chosen if row.get(column) is not None or "error" in row}
                if having:
                    some = [row for row in chosen if row["sequence"] in having]
                    lines += folded(f"{title}, {words}", _matrix(some, column))
        return lines


_FOLDED = {
    "e3d_global": "e3D, one alignment for the sequence",
    "e3d_camera_frame": "e3D in the camera frame, one alignment",
    "e3d_similarity": "e3D, a similarity for each frame",
    "e3d_none": "e3D without alignment",
    "rotation_degrees": "Rotation error in degrees",
    "seconds": "Seconds of the call",
    "memory_mb": "Peak memory in MB above what was held before",
}


def uses_intersection(method: str) -> bool:
    """Whether a method was published with the cameras of the intersection method, and leaves them as they are."""
    from nrsfm.methods import get_method, method_names

    if method not in method_names() or get_method(method).camera_method != "intersection":
        return False
    # A method that improves its cameras has to ask whether they were given.
    return "cameras_known" not in inspect.getsource(sys.modules[type(get_method(method)).__module__])


def _row(cell: Cell, record: Record) -> Row:
    row: Row = {
        "sequence": cell.data.sequence,
        "frames": record.get("frames"),
        "points": record.get("points"),
        "method": cell.method,
        "cameras": cell.cameras,
        "also_intersection": cell.cameras == "own" and uses_intersection(cell.method),
    }
    value, same = published.published_error(cell.method, cell.data.sequence)
    row |= {"published_e3d": value, "published_for": None if value is None else "same data" if same else "stand-in"}
    if "error" in record:
        return row | {"error": record["error"]}
    errors, seconds = record["errors"], record["seconds"]
    row |= {f"e3d_{name.replace('-', '_')}": errors.get(name) for name in ALIGNMENTS}
    memory = record["memory"]
    return row | {
        "rotation_degrees": record["rotation"],
        "seconds": seconds["total"],
        "seconds_cameras": seconds["cameras"] if cell.cameras == "own" else seconds["shared_cameras"],
        "seconds_method": seconds["method"],
        "memory_mb": None if memory is None else memory / 1e6,
    }


def _of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Rows of one kind of cameras; a method's own ones are those of the intersection method where it says so."""
    return [row for row in rows if row["cameras"] == kind or (kind == "intersection" and row["also_intersection"])]


def _value(row: Row, column: str) -> float | None:
    return main_error(row) if column == "main" else row.get(column)


def _by_place(rows: Sequence[Row]) -> dict[tuple[str, str], Row]:
    return {(row["method"], row["sequence"]): row for row in rows}


def _group(sequence: str) -> str:
    return next((words for start, words in _GROUPS if sequence.startswith(start)), "motion capture")


def _column_name(sequence: str) -> str:
    """As short as the group above the column allows."""
    if sequence.startswith("ict-"):
        return sequence.removeprefix("ict-")
    return sequence_title(sequence).partition(" (")[0]


def _heat(rows: Sequence[Row], words: str) -> Figure:
    def text(row: Row) -> str:
        value = main_error(row)
        # Three digits where columns are narrow.
        return error_text(value) if value is None or len(in_order(rows, "sequence")) < _MANY else error_text(value)[:4]

    return _heat_of(rows, "main", f"e3D of every method, {words}", "each frame aligned on its own", text)


def _heat_of_seconds(rows: Sequence[Row]) -> Figure:
    def text(row: Row) -> str:
        value = row["seconds"]
        return f"{value:.0f}" if value >= 10 else f"{value:.1f}" if value >= 1 else f"{value:.2f}".removeprefix("0")

    return _heat_of(
        rows,
        "seconds",
        "Seconds of every method, own cameras",
        "the whole call, one thread, other cells beside it",
        text,
    )


def _heat_of(rows: Sequence[Row], column: str, title: str, subtitle: str, text: Callable[[Row], str]) -> Figure:
    from nrsfm.methods import method_names

    names = in_order(rows, "sequence")
    registered = method_names()
    methods = sorted(in_order(rows, "method"), key=lambda m: registered.index(m) if m in registered else 99)
    found = _by_place(rows)

    def field(method: str, sequence: str) -> Field:
        row = found.get((method, sequence))
        if row is None or "error" in row:
            return Field(None, "" if row is None else _why(row["error"]))
        value = _value(row, column)
        return Field(value, text(row) if value is not None else "–")

    fields = [[field(method, name) for name in names] for method in methods]
    failed = any(entry.value is None and entry.text for row in fields for entry in row)
    return heat_figure(
        title,
        subtitle,
        [method_title(method) for method in methods],
        [Column(_column_name(name), _group(name)) for name in names],
        fields,
        strong=[method in OWN for method in methods],
        foot="time, memory: limit passed · no: cannot run, the reason is below" if failed else "",
    )


def _why(error: str) -> str:
    """Why there is no number, in the room of one."""
    if error.startswith("killed after"):
        return "time"
    return "memory" if error.startswith("killed at") else "no"


def _caption(kind: str) -> str:
    meaning = {
        "own": "Each method with the camera estimation that it was published with.",
        "intersection": "Each method with the cameras that the intersection method finds, the same for all.",
        "known": "Each method with the true cameras: what is left is the error of the shapes.",
    }[kind]
    return f"{meaning} Colours compare with the best method of the same sequence, which is outlined."


def _matrix(rows: Sequence[Row], column: str) -> list[str]:
    """Sequences down, methods across."""
    methods = in_order(rows, "method")
    found = _by_place(rows)
    lines = []
    for name in in_order(rows, "sequence"):
        own = [found.get((method, name)) for method in methods]
        values = [None if row is None or "error" in row else _value(row, column) for row in own]
        best = min((v for v in values if v is not None), default=None)
        title = sequence_title(name)
        if column == "main" and all(row is None or row.get("e3d_per_frame") is None for row in own):
            title += " ~"
        written = error_text if column == "main" or column.startswith("e3d") else _amount
        texts = []
        for row, value in zip(own, values, strict=True):
            if value is None or best is None:
                texts.append("–" if row is None or "error" not in row else _why(row["error"]))
                continue
            text = written(value)
            texts.append(f"**{text}**" if text == written(best) else text)  # what reads the same is as good
        lines.append([title, *texts])
    return table(["", *map(method_title, methods)], lines)


def _amount(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{float(f'{value:.3g}'):g}"


def _published(rows: Sequence[Row]) -> list[str]:
    """Measured beside published."""
    found = _by_place(rows)
    names = [n for n in in_order(rows, "sequence") if any(r["published_e3d"] for r in rows if r["sequence"] == n)]
    if not names:
        return []
    lines = []
    for method in in_order(rows, "method"):
        texts = []
        for name in names:
            row = found.get((method, name), {})
            value = None if "error" in row else main_error(row)
            texts.append(f"{error_text(value)} / {error_text(row.get('published_e3d'))}")
        if any(not text.endswith("–") for text in texts):
            lines.append([method_title(method), *texts])
    kinds = {row["published_for"] for row in rows if row["sequence"] in names and row["published_for"]}
    said = "Measured / published, own cameras. "
    if "stand-in" in kinds:
        said += (
            "**The stand-ins (faces without the word original) are other data than those of the published numbers**: "
            "compare the order of the methods, not the digits. "
        )
    if "same data" in kinds:
        said += "On the original files both are of the same data; the alignment of the published ones is not stated."
    return [said.strip(), "", *table(["", *map(sequence_title, names)], lines)]
