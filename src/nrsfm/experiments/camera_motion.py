"""One deformation under eight camera paths: where each method breaks, and whether it says so."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from nrsfm.experiments.base import Cell, Data, Finding, Picture, Record, Row, Scope
from nrsfm.experiments.fields import Block, Spot, fields_figure
from nrsfm.experiments.paths import path_meaning, path_names
from nrsfm.experiments.rows import (
    collect,
    e3d,
    error_text,
    in_order,
    listed,
    method_title,
    sequence_title,
    table_lines,
    usable,
)

_QUICK_PATHS = ("still", "pan15", "turn", "shake")
_QUICK_METHODS = ("bmm", "geometry-aware", "pta")
_STILL = ("still", "pan5")
_BROKEN = 2.0  # times the error of the true mean shape
_COLUMNS = {
    "still": "still\n±1°",
    "pan5": "pan\n±5°",
    "pan15": "pan\n±15°",
    "pan45": "pan\n±45°",
    "turn": "full\nturn",
    "two-axes": "two\naxes",
    "shake": "shake\n±15°",
    "orbit-roll": "orbit,\nroll",
}
_OURS = ("grassmann", "geometry-aware")


class CameraMotion:
    """Eight camera paths."""

    name = "camera-motion"
    title = "One deformation under eight camera paths"
    question = "Under which camera motion does each method break, and does it say so?"

    def cells(self, scope: Scope) -> list[Cell]:
        """Every method with its own cameras and with those of the intersection method; 400 points, no noise.

        A method that was published with the intersection method is run once.
        """
        from nrsfm.methods import get_method

        name = scope.having(["ict-rom99"])[:1] or scope.faces()[-1:] or list(scope.sequences[:1])
        points, frames = (150, 40) if scope.quick else (400, None)
        return [
            Cell(
                Data(sequence, points=points, frames=frames, camera_path=path),
                method,
                cameras,
                (),
                ("errors", "rotation", "warnings", "yardsticks"),
            )
            for sequence in name
            for path in (_QUICK_PATHS if scope.quick else path_names())
            for method in scope.using(_QUICK_METHODS if scope.quick else None)
            for cameras in ("own", "intersection")
            if cameras == "own" or get_method(method).camera_method != "intersection"
        ]

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """One row a cell. ``warned``: a warning speaks of the camera or of depth. ``broken``: see the findings."""

        def take(_: Cell, record: Record) -> Iterable[Row]:
            error, yardsticks = e3d(record), record["yardsticks"]
            texts = [str(text) for text in record["warnings"] or []]
            broken = error is None or error > _BROKEN * (yardsticks["rigid"] or 0.1)
            return [
                {
                    "e3d": error,
                    "rotation": record["rotation"],
                    "broken": broken,
                    "warned": any("camera" in text or "depth" in text for text in texts),
                    "rigid": yardsticks["rigid"],
                    "flat": yardsticks["flat"],
                    "turn": yardsticks["turn"],
                    "warnings": "; ".join(texts),
                }
            ]

        return collect(cells, records, take)

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """Errors and rotation errors as fields: methods down, paths across."""
        good = usable(rows, "e3d")
        if not good:
            return []
        rigid = max((row["rigid"] or 0.0) for row in good)
        name = sequence_title(good[0]["sequence"])
        found = []
        for what, title, bounds, words in (
            ("e3d", "One deformation, eight camera paths: error of the shapes", (0.02, 0.6), "e3D, each frame aligned"),
            (
                "rotation",
                "One deformation, eight camera paths: error of the cameras",
                (0.3, 60.0),
                "mean angle in degrees",
            ),
        ):
            blocks = [
                Block(head, self._fields(rows, cameras, what))
                for cameras, head in (("own", "own cameras"), ("intersection", "cameras of the intersection method"))
                if cameras == "own" or any(row["cameras"] == cameras for row in rows)
            ]
            figure = fields_figure(
                title,
                f"{name}, {words}",
                blocks,
                [method_title(method) for method in in_order(rows, "method")],
                [_COLUMNS[path] for path in in_order(rows, "camera_path")],
                bounds=bounds,
                foot=f"framed: shapes worse than {error_text(_BROKEN * rigid)}, twice the error of the true mean shape"
                " · ▴ the run warned of its camera or of depth",
            )
            paths = "; ".join(f"{path}: {path_meaning(path)}" for path in in_order(rows, "camera_path"))
            found.append(Picture(f"{self.name}-{'shapes' if what == 'e3d' else 'cameras'}", figure, f"{paths}."))
        return found

    def _fields(self, rows: Sequence[Row], cameras: str, what: str) -> list[list[Spot]]:
        fields = []
        for method in in_order(rows, "method"):
            line = []
            for path in in_order(rows, "camera_path"):
                row = _row(rows, method, path, cameras)
                if row is None:
                    line.append(Spot(None, "–"))
                elif "error" in row:
                    line.append(Spot(None, "failed"))
                else:
                    value = row[what]
                    text = "–" if value is None else _degrees(value) if what == "rotation" else _short(value)
                    line.append(Spot(value, text + (" ▴" if row["warned"] else ""), bool(row["broken"])))
            fields.append(line)
        return fields

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """Results depend on the camera's path; what breaks; whether it says so."""
        good = [row for row in rows if "error" not in row]
        claim = "The same deformation under another camera path gives another result (the paper's stated limitation)."
        ours = usable(good, "e3d", cameras="own")
        spreads = {}
        for method in _OURS:
            some = {row["camera_path"]: row["e3d"] for row in ours if row["method"] == method}
            if len(some) >= 2:
                spreads[method] = some
        if not spreads:
            return [Finding(claim, "not measured", "Neither algorithm was run on two paths.")]
        varied = [method for method, some in spreads.items() if max(some.values()) > 1.5 * min(some.values())]
        told = []
        for method, some in spreads.items():
            best, worst = min(some, key=lambda p: some[p]), max(some, key=lambda p: some[p])
            told.append(
                f"{method_title(method)}: {error_text(some[best])} ({best}) to {error_text(some[worst])} ({worst})"
            )
        verdict = "reproduced" if len(varied) == len(spreads) else "in part" if varied else "not reproduced"
        name, rigid = sequence_title(good[0]["sequence"]), good[0]["rigid"]
        text = f"{name}, own cameras; {'; '.join(told)}. The true mean shape alone has {error_text(rigid)}."
        return [Finding(claim, verdict, text), *self._broken(good)]

    def _broken(self, rows: Sequence[Row]) -> list[Finding]:
        paths = in_order(rows, "camera_path")
        where = []
        for method in in_order(rows, "method"):
            some = [
                row["camera_path"]
                for row in rows
                if row["method"] == method and row["cameras"] == "own" and row["broken"]
            ]
            where.append(f"{method_title(method)}: {listed(some) if some else 'none'}")
        broken = [row for row in rows if row["broken"]]
        silent = [row for row in broken if not row["warned"]]
        alarms = [row for row in rows if row["warned"] and not row["broken"]]
        claim = "Every method needs a camera that turns (the question is ours)."
        still = [row for row in rows if row["camera_path"] in _STILL]
        failed = [row for row in still if row["broken"]]
        verdict = "not measured"
        if still:
            verdict = "reproduced" if len(failed) == len(still) else "in part" if failed else "not reproduced"
        text = (
            "Broken, that is worse than twice the error of the true mean shape, are with own cameras: "
            f"{'; '.join(where)}. Where the camera turns by ±5° or less {len(failed)} of {len(still)} runs break."
        )
        found = [Finding(claim, verdict, text)]
        claim = "A run that breaks says so (the question is ours)."
        if not broken:
            return [*found, Finding(claim, "not measured", f"None of {len(rows)} runs on {len(paths)} paths breaks.")]
        verdict = "reproduced" if not silent else "in part" if len(silent) < len(broken) else "not reproduced"
        names = list(dict.fromkeys(f"{method_title(r['method'])} on {r['camera_path']}" for r in silent))
        text = f"Of {len(broken)} broken runs {len(broken) - len(silent)} warned."
        if silent:
            text += f" Silent: {listed(names[:12])}{f', and {len(names) - 12} more' if len(names) > 12 else ''}."
        text += f" {len(alarms)} of {len(rows) - len(broken)} runs that did not break warned too."
        return [*found, Finding(claim, verdict, text)]

    def table(self, rows: Sequence[Row]) -> list[str]:
        """Methods down, paths across: error, rotation error, and whether it warned."""
        paths = in_order(rows, "camera_path")
        lines = []
        for cameras, words in (("own", "own cameras"), ("intersection", "cameras of the intersection method")):
            body = []
            for method in in_order(rows, "method"):
                shown = []
                for path in paths:
                    row = _row(rows, method, path, cameras)
                    if row is None or "error" in row:
                        shown.append("–" if row is None else "failed")
                        continue
                    angle = "" if row["rotation"] is None else f" {_degrees(row['rotation'])}°"
                    text = f"{error_text(row['e3d'])}{angle}{' ▴' if row['warned'] else ''}"
                    shown.append(f"**{text}**" if row["broken"] else text)
                body.append([method_title(method), *shown])
            if any(cell != "–" for row in body for cell in row[1:]):
                lines += [f"e3D and rotation error with {words}; bold: broken; ▴: warned:", ""]
                lines += table_lines(["method", *paths], body)
        return lines


def _row(rows: Sequence[Row], method: str, path: str, cameras: str) -> Row | None:
    """The row asked for; a method whose own cameras are the intersection method's has one row for both."""
    own = None
    for row in rows:
        if row["method"] == method and row["camera_path"] == path:
            if row["cameras"] == cameras:
                return row
            if row["cameras"] == "own" and not any(r["method"] == method and r["cameras"] == cameras for r in rows):
                own = row
    return own


def _short(value: float) -> str:
    return f"{value:.3f}"[1:] if value < 0.9995 else f"{value:.1f}"


def _degrees(value: float) -> str:
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
