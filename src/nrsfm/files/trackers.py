"""Tracks as point trackers write them: CoTracker, TAPIR (and BootsTAPIR, TAPNext), and TAP-Vid's annotations.

Their arrays differ in three ways, and this module brings each to :class:`~nrsfm.tracks.Tracks`.

=========  ====================================  ==========================================  =====================
tracker    positions                             visibility                                  pixel (i, j) is at
=========  ====================================  ==========================================  =====================
cotracker  ``pred_tracks`` or ``tracks``,        ``pred_visibility`` or ``visibility``,      (j, i)
           (B, T, N, 2), pixels                  (B, T, N): flags, or 0 to 1; times
                                                 ``confidence`` where there is one
tapir      ``tracks`` (B, N, T, 2), pixels of    ``visibles``; or logits ``occluded`` (or    (j + 0.5, i + 0.5)
           the image that the network saw        ``occlusion``) and ``expected_dist``
tapvid     ``points`` (N, T, 2), 0 to 1          ``occluded``, flags                         (j + 0.5, i + 0.5) / size
=========  ====================================  ==========================================  =====================

The batch axis may be missing, and must be 1. From TAPIR's logits a point counts as visible where
(1 − σ(occluded)) · (1 − σ(expected_dist)) exceeds the threshold: Doersch et al., "TAPIR: Tracking Any Point with
per-frame Initialization and temporal Refinement", ICCV 2023. Here a pixel's centre is a whole number, so half a pixel
is taken off the last two. Nothing is unpickled: take the arrays out of a pickle or a ``.pt`` file first.
"""

from __future__ import annotations

import os

import numpy as np

from nrsfm.errors import FileError, InputError, suggest
from nrsfm.files.container import NAMELESS, Entry, listing, open_arrays
from nrsfm.tracks import Tracks

TRACKERS = ("cotracker", "tapir", "tapvid")
"""What ``tracker`` may name."""

_POSITIONS = {"cotracker": ("pred_tracks", "tracks"), "tapir": ("tracks",), "tapvid": ("points", "target_points")}
_FLAGS = {
    "cotracker": ("pred_visibility", "visibility", "visible"),
    "tapir": ("visibles",),
    "tapvid": (),
}
_LOGITS = {"cotracker": (), "tapir": ("occluded", "occlusion"), "tapvid": ("occluded", "target_occluded")}


def load_tracker(
    path: str | os.PathLike[str],
    *,
    tracker: str | None = None,
    order: str | None = None,
    image_size: tuple[float, float] | None = None,
    seen_size: tuple[float, float] | None = None,
    threshold: float = 0.5,
) -> Tracks:
    """Read what a point tracker wrote, as ``.npz``, ``.npy``, ``.mat``, ``.h5`` or ``.json``.

    Parameters
    ----------
    path
        The file.
    tracker
        One of :data:`TRACKERS`; by default told from the names of the arrays. Where they do not tell, it must be
        given, or ``order``.
    order
        ``"frame-first"`` (T, N) or ``"point-first"`` (N, T), against the tracker's habit.
    image_size
        (width, height) of the video in pixels. TAP-Vid's coordinates need it.
    seen_size
        (width, height) of the image that the tracker saw, where it was resized: positions are scaled from it to
        ``image_size``.
    threshold
        Least visibility, where it is not yes or no.

    Raises
    ------
    FileError
        The file holds no tracks of a known tracker, or arrays whose order is not stated.
    InputError
        An argument is out of range.
    """
    _check(tracker, order, threshold)
    size, seen = _pair("image_size", image_size), _pair("seen_size", seen_size)
    if seen is not None and size is None:
        raise InputError("seen_size needs image_size too: positions are scaled from the one to the other")
    entries = open_arrays(path)
    try:
        chosen = tracker or _told(entries, order)
        points, key = _positions(entries, chosen)
        points_first = (order or ("frame-first" if chosen == "cotracker" else "point-first")) == "point-first"
        visible = _visible(entries, chosen, points.shape[:2], threshold)
        if points_first:
            points, visible = points.swapaxes(0, 1), None if visible is None else visible.T
        if chosen == "tapvid":
            if size is None:
                raise InputError("image_size is needed: TAP-Vid's coordinates are relative to the image")
            held = points if visible is None else points[visible]
            if held.size and (np.nanmin(held) < -0.5 or np.nanmax(held) > 1.5):
                raise FileError(
                    f"{key}: coordinates relative to the image, 0 to 1, are needed, received {np.nanmin(held):g} to "
                    f"{np.nanmax(held):g}"
                )
            points = points * size - 0.5
        else:
            centre = 0.5 if chosen == "tapir" else 0.0
            factor = np.ones(2) if seen is None or size is None else size / seen
            # Areas scale about the outer corner of the first pixel, which lies half a pixel before its centre.
            outer = 0.5 - centre
            points = (points + outer) * factor - 0.5
        return Tracks(np.ascontiguousarray(points), visible)
    except (FileError, InputError) as error:
        raise type(error)(f"cannot use '{path}': {error}") from error


def _check(tracker: str | None, order: str | None, threshold: float) -> None:
    if tracker is not None and tracker not in TRACKERS:
        raise InputError(
            f"tracker must be one of {', '.join(TRACKERS)}, received {tracker!r}{suggest(str(tracker), TRACKERS)}"
        )
    if order not in (None, "frame-first", "point-first"):
        raise InputError(f"order must be frame-first or point-first, received {order!r}")
    if not 0 <= threshold <= 1:
        raise InputError(f"threshold must be from 0 to 1, received {threshold!r}")


def _pair(name: str, value: tuple[float, float] | None) -> np.ndarray | None:
    if value is None:
        return None
    pair = np.asarray(value, dtype=np.float64)
    if pair.shape != (2,) or not np.all(np.isfinite(pair) & (pair > 0)):
        raise InputError(f"{name} must be a positive width and height, received {value!r}")
    return pair


def _told(entries: dict[str, Entry], order: str | None) -> str:
    """Which tracker has these names, where only one has."""
    names = set(entries)
    if names & {"pred_tracks", "pred_visibility"} or {"tracks", "visibility"} <= names:
        return "cotracker"
    if "tracks" in names and names & {"visibles", "expected_dist", "occluded", "occlusion"}:
        return "tapir"
    if names & {"points", "target_points"} and names & {"occluded", "target_occluded"}:
        return "tapvid"
    if (names == {NAMELESS} or "tracks" in names) and order is not None:
        return "cotracker"
    if names == {NAMELESS} or "tracks" in names:
        raise FileError(
            "the order of its axes is ambiguous: state it (order= or --order), frame-first for (frames, points, 2), "
            f"point-first for (points, frames, 2), or name the tracker ({', '.join(TRACKERS)})"
        )
    raise FileError(f"it holds no tracks of {', '.join(TRACKERS)}; found {listing(entries)}")


def _plain(entry: Entry, key: str, axes: int) -> np.ndarray:
    """An array without the batch axis, and for flags without a last axis of 1."""
    array = entry.read()
    if array.dtype.kind not in "fiub":
        raise FileError(f"{key or 'the array'}: real numbers are needed, received dtype {array.dtype}")
    if axes == 2 and array.ndim > 2 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim == axes + 1:
        if len(array) != 1:
            raise FileError(f"{key}: one sequence is needed, received a batch of {len(array)} (shape {array.shape})")
        array = array[0]
    if array.ndim != axes:
        raise FileError(f"{key or 'the array'}: {axes} axes after the batch are needed, received shape {array.shape}")
    return array


def _positions(entries: dict[str, Entry], tracker: str) -> tuple[np.ndarray, str]:
    known = _POSITIONS[tracker]
    key = next((n for n in known if n in entries), NAMELESS if set(entries) == {NAMELESS} else None)
    if key is None:
        raise FileError(f"{tracker} needs an array named {' or '.join(known)}; found {listing(entries)}")
    points = _plain(entries[key], key, 3)
    if points.shape[2] != 2 or points.dtype.kind == "b":
        raise FileError(f"{key or 'the array'}: positions (..., 2) are needed, received shape {points.shape}")
    return points.astype(np.float64) if points.dtype not in (np.float32, np.float64) else points, key


def _visible(entries: dict[str, Entry], tracker: str, sizes: tuple[int, ...], threshold: float) -> np.ndarray | None:
    """(n, m) bool in the order of the file, or ``None`` where it says nothing."""

    def read(name: str) -> np.ndarray:
        array = _plain(entries[name], name, 2)
        if array.shape != sizes:
            raise FileError(f"{name}: shape {sizes} is needed, as the positions have, received {array.shape}")
        return array

    flags = [n for n in _FLAGS[tracker] if n in entries]
    hidden = [n for n in _LOGITS[tracker] if n in entries]
    if flags:
        values = read(flags[0])
        if tracker == "cotracker" and "confidence" in entries:
            values = values * read("confidence")
        return _compared(values, flags[0], threshold)
    if not hidden:
        return None
    values = read(hidden[0])
    if values.dtype == np.bool_ or (tracker == "tapvid" and np.all((values == 0) | (values == 1))):
        return values == 0
    if tracker == "tapvid":
        raise FileError(f"{hidden[0]}: true and false, or 1 and 0, are needed, received other values")
    seen = _probability(-values.astype(np.float64))
    if "expected_dist" in entries:
        seen = seen * _probability(-read("expected_dist").astype(np.float64))
    return seen > threshold


def _compared(values: np.ndarray, name: str, threshold: float) -> np.ndarray:
    if values.dtype == np.bool_:
        return values
    if not np.all((values >= 0) & (values <= 1)):
        raise FileError(f"{name}: flags, or visibilities from 0 to 1, are needed, received other values")
    return values > threshold


def _probability(logit: np.ndarray) -> np.ndarray:
    probability: np.ndarray = 0.5 * (1 + np.tanh(0.5 * logit))
    return probability
