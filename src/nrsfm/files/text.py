"""Text files (.csv, .tsv, .txt): long form, a row per frame and point, and wide form, the matrix itself."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.container import NAMELESS, Entry, brief

_DELIMITERS = (",", ";", "\t")
# Rows that are absent are points not seen; a file this sparse has its numbering wrong, and would fill the
# memory.
_SPARSEST, _LARGE = 0.001, 10**8


def read(path: Path) -> dict[str, Entry]:
    """Return ``tracks`` and ``visible`` (or ``shapes`` and ``valid``) of the long form, or a matrix."""
    skip, line = _first_line(path)
    delimiter = next((d for d in _DELIMITERS if d in line), None)
    fields = [f.strip().strip('"') for f in (line.split(delimiter) if delimiter else line.split())]
    if all(_is_number(f) for f in fields):
        matrix = _numbers(path, skip, delimiter, None)
        return {NAMELESS: Entry(matrix.shape, str(matrix.dtype), lambda: matrix)}
    return _long(path, skip, delimiter, [f.lower() for f in fields])


def _first_line(path: Path) -> tuple[int, str]:
    """The number of lines before the first that is neither blank nor a comment, and that line."""
    with path.open(encoding="utf-8-sig") as stream:
        for number, line in enumerate(stream):
            if "\0" in line:
                raise FileError("it is not a text file")
            text = re.sub("#.*", "", line).strip()
            if text:
                return number, text
    raise FileError("it holds no numbers")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(path: Path, skip: int, delimiter: str | None, columns: list[int] | None) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "no data": said better below
            array: np.ndarray = np.loadtxt(
                path, delimiter=delimiter, skiprows=skip, usecols=columns, ndmin=2, encoding="utf-8-sig"
            )
    except ValueError as error:
        raise FileError(brief(error).partition("; use `usecols`")[0]) from error  # an option of NumPy, not ours
    if array.size == 0:
        raise FileError("it holds no numbers")
    return array


def _long(path: Path, skip: int, delimiter: str | None, names: list[str]) -> dict[str, Entry]:
    coordinates = ["x", "y", "z"] if "z" in names else ["x", "y"]
    needed = ["frame", "point", *coordinates]
    absent = [n for n in needed if n not in names]
    if absent:
        raise FileError(
            "a header needs the columns frame, point, x, y (and z for shapes, visible where known), "
            f"{', '.join(absent)} missing, found {', '.join(names)}"
        )
    wanted = needed + (["visible"] if "visible" in names else [])
    table = _numbers(path, skip + 1, delimiter, [names.index(n) for n in wanted])
    frames, points = _numbering(path, table[:, 0], "frame"), _numbering(path, table[:, 1], "point")
    shape = (int(frames.max()) + 1, int(points.max()) + 1)
    total = shape[0] * shape[1]
    if total > _LARGE and len(table) < _SPARSEST * total:
        raise FileError(f"{len(table)} rows for {shape[0]} frames of {shape[1]} points")
    seen = np.zeros(shape, dtype=bool)
    seen[frames, points] = True
    if np.count_nonzero(seen) != len(table):
        keys, counts = np.unique(frames * shape[1] + points, return_counts=True)
        frame, point = divmod(int(keys[np.argmax(counts > 1)]), shape[1])
        raise FileError(
            f"one row per frame and point is needed, received several of frame {frame}, point {point} (counted from 0)"
        )
    values = np.full((*shape, len(coordinates)), np.nan)
    values[frames, points] = table[:, 2 : 2 + len(coordinates)]
    if "visible" in names:
        flags = table[:, -1]
        wrong = ~np.isin(flags, (0.0, 1.0))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise FileError(f"visible must be 0 or 1, received {flags[row]:g} in row {row + 1}")
        seen[frames, points] = flags == 1
    one, two = ("shapes", "valid") if "z" in names else ("tracks", "visible")
    entries = {one: Entry(values.shape, str(values.dtype), lambda: values)}
    if not seen.all():
        entries[two] = Entry(seen.shape, "bool", lambda: seen)
    return entries


def _numbering(path: Path, column: np.ndarray, name: str) -> np.ndarray:
    """The column counted from 0; a gap would silently change times or drop points: there may be none."""
    wrong = ~((column >= 0) & (column < 2**31) & (column == np.floor(column)))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise FileError(f"{name} must be a whole number from 0, received {column[row]:g} in row {row + 1}")
    used = np.unique(column)
    gaps = np.flatnonzero(np.diff(used) != 1)
    if used[0] > 1 or len(gaps):
        missing = f"{name} {used[gaps[0]] + 1:g} is missing" if len(gaps) else f"the first is {used[0]:g}"
        raise FileError(
            f"{name}s must be numbered without gaps from 0 or 1, {missing} (for one that was never seen, "
            "write a row with visible 0)"
        )
    result: np.ndarray = (column - used[0]).astype(np.int64)
    return result
