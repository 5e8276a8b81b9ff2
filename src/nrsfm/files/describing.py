"""What a file holds, as a dict for people and programs."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError
from nrsfm.files.container import NAMELESS, DamagedFileError, Entry, open_arrays
from nrsfm.files.loading import load_rotations, load_shapes, load_tracks
from nrsfm.files.reconstructions import ABOUT, ARRAYS
from nrsfm.reconstruction import Reconstruction, load_reconstruction

_AXES = "xyz"
_SAMPLE = 2_000_000  # numbers that are enough for a median


def describe(
    path: str | os.PathLike[str],
    *,
    order: str | None = None,
    name: str | None = None,
    tracker: str | None = None,
    image_size: tuple[float, float] | None = None,
    seen_size: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return what a file holds; every value is plain, so that the dict goes into JSON.

    Keys: ``path``, ``format`` (extension), ``bytes``, ``kind`` ("tracks", "shapes", "cameras",
    "reconstruction" or "unknown"), ``arrays`` (a list of ``name``, ``shape``, ``dtype``), ``holds`` (which of
    tracks, shapes and cameras can be read), and ``problem``, why the file is not usable as tracks, or
    ``None``. For tracks and shapes also ``frames``, ``points``, ``dtype``, ``missing`` (entries),
    ``missing_share`` (0 to 1), and ``range`` (per axis the least and greatest known coordinate, in the file's
    unit). For a reconstruction also ``method``, ``options``, ``diagnostics``, ``groups`` (how many, or ``None``),
    ``not_reconstructed`` (points), ``missing`` (measurements of confidence 0), and ``depth_deviation`` (its
    ``median`` and the value that 95 % stay below, ``percentile_95``, or ``None``). The arguments are those
    of :func:`~nrsfm.files.load_tracks`.

    Raises
    ------
    FileError
        The file cannot be read at all, holds nothing, or an array that was looked at is damaged.
    """
    entries = open_arrays(path)
    if not entries:
        raise FileError(f"cannot use '{path}': it holds no arrays")
    result: dict[str, Any] = {
        "path": str(path),
        "format": Path(path).suffix.lower().lstrip("."),
        "bytes": os.path.getsize(path),
        "kind": "unknown",
        "arrays": [_array(name, entry) for name, entry in entries.items()],
        "holds": [],
        "problem": None,
    }
    if all(name in entries for name in (*ARRAYS, ABOUT)):
        return {**result, "kind": "reconstruction", "holds": ["shapes", "cameras"], **_of_result(path)}
    problems: list[str] = []
    reading: dict[str, Any] = {"order": order, "name": name, "tracker": tracker}
    reading |= {"image_size": image_size, "seen_size": seen_size}
    tracks = _attempt(lambda: load_tracks(path, **reading), problems)
    truth_or_none = cameras = None
    nameless = NAMELESS in entries
    if tracks is None or not nameless:  # one array without a name is one thing only
        truth_or_none = _attempt(lambda: load_shapes(path, order=order if nameless else None), problems)
        cameras = _attempt(lambda: load_rotations(path), problems)
    found = {"tracks": tracks, "shapes": truth_or_none, "cameras": cameras}
    result["holds"] = [what for what, value in found.items() if value is not None]
    result["kind"] = result["holds"][0] if result["holds"] else "unknown"
    if tracks is not None:
        result.update(_summary(tracks.points, tracks.visible))
        return result
    result["problem"] = problems[0]
    if truth_or_none is not None:
        result.update(_summary(truth_or_none.shapes, truth_or_none.valid))
    elif cameras is not None:
        result["frames"] = len(cameras)
    return result


def _attempt(load: Callable[[], Any], problems: list[str]) -> Any:
    try:
        return load()
    except DamagedFileError:  # what the file lacks is an answer, what it has lost is not
        raise
    except FileError as error:
        problems.append(str(error))
        return None


def _array(name: str, entry: Entry) -> dict[str, Any]:
    return {"name": name, "shape": list(entry.shape), "dtype": entry.dtype}


def _of_result(path: str | os.PathLike[str]) -> dict[str, Any]:
    result = load_reconstruction(path)
    known = result.reconstructed
    unseen = 0 if result.confidence is None else result.confidence.size - int(np.count_nonzero(result.confidence))
    return {
        **_summary(result.shapes, np.broadcast_to(known, result.shapes.shape[:2])),
        "missing": unseen,
        "missing_share": unseen / (result.n_frames * result.n_points),
        "not_reconstructed": result.n_missing,
        "depth_deviation": _deviation(result, known),
        "method": result.method,
        "options": result.options,
        "groups": None if result.groups is None else len(np.unique(result.groups[known])),
        "diagnostics": result.diagnostics,
    }


def _deviation(result: Reconstruction, known: np.ndarray) -> dict[str, float] | None:
    if result.depth_deviation is None:
        return None
    step = max(1, result.depth_deviation.size // _SAMPLE)
    middle, high = np.percentile(result.depth_deviation[:, known][:, ::step], [50, 95])
    return {"median": float(middle), "percentile_95": float(high)}


def _summary(points: np.ndarray, known: np.ndarray | None) -> dict[str, Any]:
    frames, count, axes = points.shape
    low, high = np.full(axes, np.inf), np.full(axes, -np.inf)
    for f, frame in enumerate(points):
        part = frame if known is None else frame[known[f]]
        if len(part):
            low, high = np.minimum(low, part.min(axis=0)), np.maximum(high, part.max(axis=0))
    missing = 0 if known is None else known.size - int(np.count_nonzero(known))
    ranges = {a: [float(x), float(y)] for a, x, y in zip(_AXES, low, high, strict=False) if x <= y}
    return {
        "frames": frames,
        "points": count,
        "dtype": str(points.dtype),
        "missing": missing,
        "missing_share": missing / (frames * count),
        "range": ranges,
    }
