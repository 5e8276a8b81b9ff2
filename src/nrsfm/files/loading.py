"""What the arrays of a file mean: tracks, true shapes, known cameras. docs/formats.md lists the names."""

from __future__ import annotations

import dataclasses
import logging
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError, suggest
from nrsfm.files.cameras import rotations_from_array
from nrsfm.files.container import NAMELESS, Entry, listing, open_arrays
from nrsfm.streaming.stored import StoredPoints, is_stored
from nrsfm.tracks import LARGE, Tracks, shapes_from_matrix

logger = logging.getLogger(__name__)

ORDERS = ("frame-first", "point-first", "matrix")
"""How an array may be laid out: (F, P, 2), (P, F, 2), or the paper's 2F×P (for shapes 3 in place of 2)."""

# The layout that each name stands for; None: it takes a second array to know.
_TRACKS = {"tracks": "frame-first", "pred_tracks": "frame-first", "W": "matrix", "points": None}
_SHAPES = {"shapes": "frame-first", "S": "matrix", "S_GT": "matrix", "S_gt": "matrix"}
_CAMERAS = ("rotations", "R", "R_GT", "R_gt", "Rs")
_VISIBLE = ("visible", "visibility", "pred_visibility", "visibles", "W_valid")
_OCCLUDED = ("occluded",)
_VALID = ("valid", "S_valid")
# What trackers that write point-first call their flags.
_POINT_FIRST_FLAGS = ("occluded", "visibles")


@dataclasses.dataclass(frozen=True, eq=False)
class Truth:
    """True shapes: ``shapes`` (F, P, 3), and ``valid`` (F, P) bool or ``None`` where all are known."""

    shapes: np.ndarray
    valid: np.ndarray | None = None


def load_tracks(
    path: str | os.PathLike[str],
    *,
    order: str | None = None,
    name: str | None = None,
    image_size: tuple[float, float] | None = None,
    tracker: str | None = None,
    seen_size: tuple[float, float] | None = None,
) -> Tracks:
    """Read tracks from .npz, .npy, .mat (5 and 7.3), .h5, .csv, .tsv, .txt or .json; nothing is unpickled.

    Parameters
    ----------
    path
        The file. Truth and cameras that it may hold besides are left alone.
    order
        How the array is laid out, where its name does not say: ``"frame-first"`` (F, P, 2), ``"point-first"``
        (P, F, 2), or ``"matrix"`` (the paper's W, 2F×P). Flags of visibility have the same order.
    name
        Which array to read, where the file holds several that could be meant, or one under another name.
    image_size
        (width, height) in pixels of coordinates that were stored relative to the image, as TAP-Vid does.
    tracker
        ``"cotracker"``, ``"tapir"`` or ``"tapvid"``: the arrays are as that tracker writes them, with its order of
        axes, its soft visibility or logits, and its half a pixel (:func:`nrsfm.files.trackers.load_tracker`).
    seen_size
        With ``tracker``: (width, height) of the image that it saw, if the video (``image_size``) was resized for it.

    Raises
    ------
    FileError
        The file is not what it claims to be, holds no tracks (what it holds is listed), does not say their
        order, or breaks a rule of :class:`~nrsfm.tracks.Tracks`.
    InputError
        An argument is out of range.
    """
    _check_order(order)
    if tracker is not None:
        from nrsfm.files.trackers import load_tracker

        if order == "matrix" or name is not None:
            what = f"order {order!r}" if name is None else f"name {name!r}"
            raise InputError(
                f"tracker {tracker!r} names the arrays itself and knows no matrix, received {what} beside it"
            )
        return load_tracker(path, tracker=tracker, order=order, image_size=image_size, seen_size=seen_size)
    if seen_size is not None:
        raise InputError("seen_size needs tracker too: only trackers resize")
    entries = open_arrays(path)
    with _in_file(path):
        key = _choose(entries, name, tuple(_TRACKS), "tracks")
        flagged = any(flag in entries for flag in (*_OCCLUDED, *_VISIBLE))
        array = entries[key].read() if flagged or image_size is not None else _large_or_read(entries[key])
        layout = order or _layout(entries, key, _TRACKS, array, 2)
        array = _without_batch(array, 3, key)
        if layout != "matrix" and array.ndim == 3 and array.shape[2] == 2:
            sizes = array.shape[:2]
        else:
            sizes = None
        hidden = _flags(entries, _OCCLUDED, sizes)
        visible = _flags(entries, _VISIBLE, sizes)
        if hidden is not None:
            if visible is not None:
                raise FileError(f"one array of flags is needed, found {listing(entries)}")
            visible = ~hidden
        if image_size is not None:
            array = _to_pixels(array, layout, image_size)
        elif key == "points" and layout == "point-first" and _is_relative(array):
            logger.warning("%s: every coordinate is in [0, 1]: if relative to the image, give its size", path)
        with _under_its_name(key):
            if is_stored(array):
                points: Any = _checked_store(array, layout)
                return Tracks(points)
            if layout == "matrix":
                return Tracks.from_measurement_matrix(array, visible)
            if layout == "point-first":
                return Tracks.from_point_first(array, None if visible is None else ~visible)
            return Tracks(array, visible)


def load_shapes(path: str | os.PathLike[str], *, order: str | None = None, name: str | None = None) -> Truth:
    """Read true shapes (or those of a saved reconstruction) from the same formats as :func:`load_tracks`.

    ``order`` is "frame-first" (F, P, 3), "point-first" (P, F, 3) or "matrix" (the paper's S, 3F×P).
    Without a mask in the file, points whose coordinates are NaN count as not known, and a log message says
    how many; infinite coordinates are refused, as are NaN where a mask says that the point is known.

    Raises
    ------
    FileError
        As :func:`load_tracks`.
    InputError
        An argument is out of range.
    """
    _check_order(order)
    entries = open_arrays(path)
    with _in_file(path):
        key = _choose(entries, name, tuple(_SHAPES), "shapes")
        array = entries[key].read()
        layout = order or _layout(entries, key, _SHAPES, array, 3)
        valid = _flags(entries, _VALID, None)
        if layout == "matrix":
            shapes = shapes_from_matrix(array)
        else:
            shapes = _shapes(_without_batch(array, 3, key))
            if layout == "point-first":
                shapes = shapes.transpose(1, 0, 2)
                valid = None if valid is None else valid.T
        return _truth(path, shapes, valid)


def load_rotations(path: str | os.PathLike[str], *, name: str | None = None) -> np.ndarray:
    """Read known cameras and return them as rotations (F, 3, 3) float64, camera from object.

    The array may be (F, 3, 3) or (F, 2, 3), the same with the frames last, the paper's 2F×3, a block-diagonal
    matrix (3F×3F or 2F×3F, as the dense benchmark's ``R_GT``), or F rows of 9 or 6 numbers. Where only two
    rows of a camera are given, the third is their cross product.

    Raises
    ------
    FileError
        As :func:`load_tracks`; or the matrices are not rotations (to 1e-3).
    """
    entries = open_arrays(path)
    with _in_file(path):
        key = _choose(entries, name, _CAMERAS, "cameras")
        return rotations_from_array(entries[key].read(), key or "cameras")


@contextmanager
def _in_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Name the file in errors about its content."""
    try:
        yield
    except (FileError, InputError) as error:
        text = str(error)
        if text.startswith(f"cannot read '{path}'"):
            raise
        raise FileError(f"cannot use '{path}': {text}") from error


@contextmanager
def _under_its_name(key: str) -> Iterator[None]:
    """Call the array in errors as the file does: ``Tracks`` knows it as points or W."""
    try:
        yield
    except InputError as error:
        name, _, rule = str(error).partition(": ")
        if not key or name not in ("points", "W"):
            raise
        raise InputError(f"{key}: {rule}") from error


def _check_order(order: str | None) -> None:
    if order is not None and order not in ORDERS:
        raise InputError(f"order must be one of {', '.join(ORDERS)}, received {order!r}{suggest(str(order), ORDERS)}")


def _choose(entries: dict[str, Entry], name: str | None, known: tuple[str, ...], what: str) -> str:
    if name is not None:
        if name not in entries:
            raise FileError(f"it has no array '{name}'{suggest(name, entries)}; found {listing(entries)}")
        return name
    found = [n for n in known if n in entries]
    if len(found) > 1:
        raise FileError(f"{' and '.join(found)} could all be the {what}: say which (name= or --array)")
    if found:
        return found[0]
    if NAMELESS in entries:
        return NAMELESS
    raise FileError(f"{what} need an array named {', '.join(known[:-1])} or {known[-1]}; found {listing(entries)}")


def _large_or_read(entry: Entry) -> Any:
    """A large array as it is in its file, a small one read."""
    numbers = entry.dtype.startswith(("float", "int", "uint"))
    if entry.stored is None or not numbers or len(entry.shape) not in (2, 3):
        return entry.read()
    return entry.stored() if math.prod(entry.shape) * np.dtype(entry.dtype).itemsize >= LARGE else entry.read()


def _checked_store(array: Any, layout: str) -> StoredPoints:
    """Points in a file, their shape checked as :class:`~nrsfm.tracks.Tracks` does that of arrays."""
    shape = tuple(array.shape)
    if layout == "matrix" and (len(shape) != 2 or shape[0] % 2):
        raise InputError(f"W: a matrix (2 x frames, points) is needed, received shape {shape}")
    if layout != "matrix" and (len(shape) != 3 or shape[2] != 2):
        raise InputError(f"points: shape (frames, points, 2) is needed, received {shape}")
    return StoredPoints(array, layout)


def _layout(
    entries: dict[str, Entry],
    key: str,
    names: dict[str, str] | dict[str, str | None],
    array: np.ndarray,
    last: int,
) -> str:
    """The order of axes that the name implies, or an error that says how to state it."""
    word = names.get(key)
    flags = [n for n in _POINT_FIRST_FLAGS if n in entries]
    if key == "points" and "occluded" in entries:
        return "point-first"
    if key == "points" and "visible" in entries:
        return "frame-first"
    if word == "frame-first" and last == 2 and flags:
        word = None  # the array of a tracker whose flags are point-first
    if word is not None:
        return word
    if array.ndim == 2:
        return "matrix"
    if array.ndim == 4 and array.shape[0] == 1 and not flags:
        return "frame-first"  # only the trackers that work frame-first write a batch axis
    if array.ndim < 2 or array.ndim > 4 or array.dtype.kind not in "fiu":
        raise FileError(
            f"{key or 'an array without a name'}: real numbers of shape (frames, points, {last}) or ({last} x frames, "
            f"points) are needed, received dtype {array.dtype}, shape {array.shape}"
        )
    raise FileError(
        f"the order of axes of {key or 'an array without a name'} with shape {array.shape} is ambiguous: "
        f"state it (order= or --order): frame-first for (frames, points, {last}), point-first for (points, "
        f"frames, {last}), matrix for ({last} x frames, points)"
        + ("; or which tracker wrote it (tracker= or --tracker)" if last == 2 else "")
    )


def _without_batch(array: np.ndarray, ndim: int, key: str) -> np.ndarray:
    if array.ndim != ndim + 1:
        return array
    if array.shape[0] != 1:
        raise FileError(f"{key}: one sequence is needed, received a batch of {array.shape[0]} (shape {array.shape})")
    first: np.ndarray = array[0]
    return first


def _flags(entries: dict[str, Entry], names: tuple[str, ...], sizes: tuple[int, ...] | None) -> np.ndarray | None:
    """The flags under one of ``names`` as bool, without axes of length 1 that trackers add to ``sizes``."""
    found = [n for n in names if n in entries]
    if not found:
        return None
    if len(found) > 1:
        raise FileError(f"one array of flags is needed, found {' and '.join(found)}")
    key = found[0]
    flags = entries[key].read()
    if sizes is not None and flags.shape in ((1, *sizes), (*sizes, 1), (1, *sizes, 1)):
        flags = flags.reshape(sizes)
    if flags.dtype == np.bool_:
        return flags
    if flags.dtype.kind not in "fiu" or not np.all((flags == 0) | (flags == 1)):
        hint = "" if flags.dtype.kind not in "fiu" else " (for those of a tracker say which: tracker= or --tracker)"
        raise FileError(
            f"{key}: true and false, or 1 and 0, are needed, received other values of dtype {flags.dtype}{hint}"
        )
    return flags == 1


def _to_pixels(array: np.ndarray, layout: str, image_size: tuple[float, float]) -> np.ndarray:
    size = np.asarray(image_size)
    if size.dtype.kind not in "fiu" or size.shape != (2,) or not np.all(np.isfinite(size) & (size > 0)):
        raise InputError(f"image_size must be a positive width and height, received {image_size!r}")
    if array.dtype.kind not in "fiu" or layout == "matrix" or array.shape[-1:] != (2,):
        raise FileError(f"image_size needs an array of (…, 2) real numbers, received {array.dtype} {array.shape}")
    return array * size


def _is_relative(array: np.ndarray) -> bool:
    if array.dtype.kind != "f" or not array.size:
        return False
    return bool(np.nanmin(array) >= 0 and np.nanmax(array) <= 1)


def _shapes(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "fiu":
        raise InputError(f"shapes: real numbers are needed, received dtype {array.dtype}")
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise InputError(f"shapes: shape (frames, points, 3) is needed, received {array.shape}")
    if array.dtype in (np.float32, np.float64):
        return array
    return array.astype(np.float64)


def _truth(path: str | os.PathLike[str], shapes: np.ndarray, valid: np.ndarray | None) -> Truth:
    if valid is not None and valid.shape != shapes.shape[:2]:
        raise InputError(f"valid: shape {shapes.shape[:2]} is needed, as the shapes have, received {valid.shape}")
    unknown = np.zeros(shapes.shape[:2], dtype=bool)
    for f, frame in enumerate(shapes):
        if valid is None and np.isinf(frame).any():
            raise InputError(f"shapes: no coordinate may be infinite, received one in frame {f}")
        unknown[f] = ~np.isfinite(frame).all(axis=1)
    if valid is None:
        if not unknown.any():
            return Truth(shapes)
        count = np.count_nonzero(unknown)
        logger.warning("%s: %d of %d true points are NaN, so not known", path, count, unknown.size)
        return Truth(shapes, ~unknown)
    wrong = unknown & valid
    if wrong.any():
        frame_, point = np.argwhere(wrong)[0]
        raise InputError(
            f"shapes: every valid coordinate must be finite, received {wrong.sum()} points that are not, "
            f"the first at frame {frame_}, point {point}"
        )
    return Truth(shapes, valid)
