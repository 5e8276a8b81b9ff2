"""From records to rows, and what is said of rows: trends, numbers as text, tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from nrsfm.experiments.base import Cell, Record, Row

METHOD_NAMES = {
    "grassmann": "Algorithm 1",
    "geometry-aware": "Algorithm 2",
    "bmm": "BMM",
    "pta": "PTA",
    "csf1": "CSF1",
    "csf2": "CSF2",
    "ksta": "KSTA",
    "mp": "MP",
    "dv": "DV",
    "ds": "DS",
    "smsr": "SMSR",
    "rbmm": "R-BMM",
    "organic": "Organic priors",
    "em-pnd": "EM-PND",
}
_SEQUENCE_NAMES = {
    **{f"face-seq{i}": f"face {i}" for i in range(1, 5)},
    **{f"original-face{i}": f"face {i} (original)" for i in range(1, 5)},
    **{f"built-in-face{i}": f"face {i} (built in)" for i in range(1, 5)},
    "built-in-sheet": "sheet (built in)",
    "ict-rom99": "ict",
    "ict-rom346": "ict, 346 frames",
    "back_real126": "back",
    "mat1500_persp": "mat",
    "flag250_persp": "flag",
    "hulk_persp": "hulk",
    "mesh_horse_gallop": "horse",
    "face1": "face markers",
    "original-actor1": "actor 1",
    "original-actor2": "actor 2",
    "original-paper": "paper",
    "original-tshirt": "T-shirt",
}


def method_title(name: str) -> str:
    """The name of a method in tables and figures."""
    return METHOD_NAMES.get(name, name)


def sequence_title(name: str) -> str:
    """The name of a sequence in tables and figures."""
    return _SEQUENCE_NAMES.get(name, name)


def face_number(name: str) -> int | None:
    """1 to 4 for the dense faces in any of their forms, else ``None``."""
    kinds = ("face-seq", "original-face", "built-in-face")
    return int(name[-1]) if any(name == f"{kind}{name[-1]}" for kind in kinds) and name[-1] in "1234" else None


def noises(rows: Iterable[Row]) -> list[float]:
    """The noise ratios in the rows, ascending."""
    return sorted({float(row["noise"]) for row in rows})


def in_order(rows: Iterable[Row], name: str) -> list[Any]:
    """The values of one column, each once, in the order in which they come."""
    return list(dict.fromkeys(row[name] for row in rows if row.get(name) is not None))


def noise_title(noise: float) -> str:
    """The noise in words: 3% noise."""
    return f"{100 * noise:g}% noise" if noise else "no noise"


def collect(
    cells: Sequence[Cell],
    records: Mapping[str, Record],
    take: Callable[[Cell, Record], Iterable[Row]],
) -> list[Row]:
    """Rows of the cells that are computed: what was asked, then what ``take`` makes of the record.

    A failed cell becomes one row with ``error``. Options that are not set in one cell but in others are left out of
    its rows.
    """
    rows: list[Row] = []
    for cell in cells:
        record = records.get(cell.key)
        if record is None:
            continue
        data = cell.data
        row: Row = {"sequence": data.sequence, "noise": data.noise, "method": cell.method, "cameras": cell.cameras}
        if data.camera_path is not None:
            row["camera_path"] = data.camera_path
        row |= dict(cell.options)
        if "error" in record:
            rows.append(row | {"error": str(record["error"])})
        else:
            rows += [row | more for more in take(cell, record)]
    return rows


def e3d(record: Record, align: str = "per-frame") -> float | None:
    """The error under an alignment; the nearest that has a meaning where this one has none."""
    found = record.get("errors") or {}
    value = found.get(align)
    return found.get("similarity") if value is None else value


def usable(rows: Iterable[Row], *names: str, **wanted: Any) -> list[Row]:
    """Rows that did not fail, hold finite numbers under ``names`` and have the wanted values."""
    return [
        row
        for row in rows
        if "error" not in row
        and all(isinstance(row.get(n), int | float) and np.isfinite(row[n]) for n in names)
        and all(row.get(key) == value for key, value in wanted.items())
    ]


def pearson(x: Sequence[float], y: Sequence[float]) -> float:
    """Correlation, 0 where one of the two does not vary."""
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 1e-15 else 0.0


def spearman(x: Sequence[float], y: Sequence[float]) -> float:
    """Correlation of ranks; equal values share their mean rank."""

    def ranks(values: Sequence[float]) -> np.ndarray:
        _, inverse, counts = np.unique(np.asarray(values, dtype=np.float64), return_inverse=True, return_counts=True)
        return np.asarray((np.cumsum(counts) - 0.5 * (counts - 1))[inverse])

    return pearson(list(ranks(x)), list(ranks(y)))


def enough(x: Sequence[float], y: Sequence[float], slack: float = 0.05) -> float:
    """The least x from which on y stays within ``slack`` of its least value."""
    limit = (1.0 + slack) * min(y)
    found = x[-1]
    for value, error in zip(reversed(x), reversed(y), strict=True):
        if error > limit:
            break
        found = value
    return found


def error_text(value: float | None) -> str:
    """A relative error as the field writes it: .0623."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.4f}".removeprefix("0") if value < 1 else f"{value:.2f}"


def percent(value: float) -> str:
    """A change with its sign: +12%, −3%."""
    rounded = round(100 * value)
    return f"{'−' if rounded < 0 else '+' if rounded > 0 else '±'}{abs(rounded)}%"


def listed(words: Sequence[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else list(words))


def some_of(words: Sequence[str], most: int = 4) -> str:
    """The first few of a list, and how many more there are in the table."""
    if len(words) <= most:
        return "; ".join(words)
    return "; ".join([*words[:most], f"{len(words) - most} more in the table"])


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table with an empty line after it."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return [*lines, ""]
