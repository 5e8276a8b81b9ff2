"""Pictures of the input: where the points are seen, and where they came from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.measurements import MAP_HEIGHT, draw_measurements, measurements_of
from nrsfm.viewing.panels import Window, box, caption, window
from nrsfm.viewing.scene import mean_shape
from nrsfm.viewing.style import OUTLIER, WIDTH, house_style, new_figure, oklab_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN = 900  # points drawn; more would hide the trails
_HEADER = 1.0


def track_array(tracks: Any) -> np.ndarray:
    """Return points (F, P, 2) with NaN where not visible, of ``Tracks`` or an array.

    Raises ``InputError`` for another shape or type. The points are not copied unless some are not visible.
    """
    points = np.asarray(getattr(tracks, "points", tracks))
    if points.ndim != 3 or points.shape[2] != 2 or points.size == 0 or points.dtype.kind not in "fiu":
        raise InputError(f"tracks: real points (frames, points, 2) are needed, received {points.dtype} {points.shape}")
    visible = getattr(tracks, "visible", None)
    return points if visible is None else np.where(visible[..., None], points, np.nan)


def spread_points(positions: np.ndarray, count: int = _SHOWN) -> np.ndarray:
    """Numbers of up to ``count`` points spread evenly over the positions (P, 2)."""
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if len(known) <= count:
        return known
    known = known[:: max(1, len(known) // 30_000)]
    xy = np.asarray(positions[known], dtype=np.float32)
    chosen = np.zeros(count, dtype=np.int64)
    nearest = np.full(len(xy), np.inf, dtype=np.float32)
    for i in range(1, count):  # each new point is the one furthest from those already chosen
        away = xy - xy[chosen[i - 1]]
        np.minimum(nearest, away[:, 0] ** 2 + away[:, 1] ** 2, out=nearest)
        chosen[i] = np.argmax(nearest)
    return known[np.unique(chosen)]


def widest_frame(points: np.ndarray) -> np.ndarray:
    """Positions (P, 2) in the frame, of up to 50 looked at, in which the points cover the largest area."""
    frames = np.unique(np.linspace(0, len(points) - 1, 50).astype(int))
    areas = []
    for f in frames:
        known = points[f][np.isfinite(points[f]).all(axis=1)]
        areas.append(np.linalg.det(np.cov(known.T.astype(np.float64))) if len(known) > 2 else -1.0)
    return np.asarray(points[frames[int(np.argmax(areas))]])


def reference_positions(points: np.ndarray, outlier: np.ndarray) -> np.ndarray:
    """One position (P, 2) for every point: in the widest frame, or else its mean over the frames it is seen in."""
    if outlier.any():
        points = np.where(outlier[..., None], np.nan, points)
    widest = widest_frame(points)
    known = np.isfinite(widest).all(axis=1)
    return widest if known.all() else np.where(known[:, None], widest, mean_shape(points))


def track_window(points: np.ndarray, outlier: np.ndarray, frames: np.ndarray, shown: np.ndarray, trail: int) -> Window:
    """The window around what :func:`draw_tracks` draws in the frames (n,), but not around outliers and strays."""
    parts = []
    for f in frames:
        span = slice(max(0, f - trail), f + 1)
        path = points[span, shown]
        parts.append(path[np.isfinite(path).all(axis=2) & ~outlier[span, shown]])
    known = np.concatenate(parts)
    if not len(known):
        return window([])
    low, high = np.percentile(known, [2, 98], axis=0)
    reach = 0.4 * np.maximum(high - low, 0.05 * (high - low).max())
    return window([np.clip(known, low - reach, high + reach)])


def place_colours(positions: np.ndarray) -> np.ndarray:
    """A colour (P, 3) for every position (P, 2), smooth over the object, so that points can be followed."""
    known = np.isfinite(positions).all(axis=1)
    if not known.any():
        return np.full((len(positions), 3), 0.5)
    low, high = np.percentile(positions[known], [1, 99], axis=0)  # strays must not take all the colours
    place = (np.where(known[:, None], positions, low) - low) / np.maximum(high - low, 1e-12) * 2.0 - 1.0
    place = np.clip(place, -1.1, 1.1)
    lab = np.stack([0.60 + 0.06 * place[:, 1], 0.13 * place[:, 0], -0.13 * place[:, 1]], axis=1)
    return np.clip(oklab_to_srgb(lab), 0.0, 1.0)


def draw_tracks(
    axes: Axes,
    points: np.ndarray,
    frame: int,
    shown: np.ndarray,
    colours: np.ndarray,
    trail: int,
    outlier: np.ndarray | None = None,
) -> None:
    """Draw the shown points (n,) of one frame and their way during the ``trail`` frames before it.

    Measurements marked in ``outlier`` (F, P) have no trail; those of the frame itself are crosses of their own colour.
    """
    from matplotlib.collections import LineCollection

    first = max(0, frame - trail)
    path = np.asarray(points[first : frame + 1, shown], dtype=np.float64)
    if outlier is not None:
        odd = outlier[first : frame + 1, shown]
        wrong = path[-1, odd[-1]]
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        wrong = wrong[(wrong > (left, top)).all(axis=1) & (wrong < (right, bottom)).all(axis=1)]  # no halves at an edge
        path = np.where(odd[..., None], np.nan, path)
        axes.scatter(wrong[:, 0], wrong[:, 1], s=14.0, c=OUTLIER, marker="x", linewidths=0.9, zorder=3, clip_on=False)
    for i in range(len(path) - 1):
        age = (i + 1) / len(path)  # older parts are fainter
        lines = np.stack([path[i], path[i + 1]], axis=1)
        known = np.isfinite(lines).all(axis=(1, 2))
        axes.add_collection(
            LineCollection(
                list(lines[known]),
                colors=colours[known],
                alpha=0.55 * age**1.5,
                linewidths=0.5 + 0.5 * age,
                zorder=1,
            )
        )
    size = float(np.clip(5000.0 / max(len(shown), 1), 3.0, 22.0))
    axes.scatter(path[-1, :, 0], path[-1, :, 1], s=size, c=colours, linewidths=0, zorder=2)


def set_window(axes: Axes, view: Window) -> None:
    """Show the window with y growing downwards."""
    (cx, cy), (hx, hy) = view
    axes.set_xlim(cx - hx, cx + hx)
    axes.set_ylim(cy + hy, cy - hy)


def tracks_figure(
    tracks: Any,
    reconstruction: Any = None,
    *,
    frames: Any = None,
    count: int = 4,
    trail: int = 8,
    title: str = "Input tracks",
) -> Figure:
    """Draw the tracks in several frames, each point with its trail; a point keeps its colour.

    Where some measurements are missing, or were not believed, a map below shows which.

    Parameters
    ----------
    tracks
        ``Tracks``, or points (F, P, 2), x right and y down. Points that are not visible are left out.
    reconstruction
        Its ``confidence`` tells which measurements were not believed, its shapes which points were lost.
    frames, count
        Frames to draw, or how many to spread over the sequence.
    trail
        Length of the trails in frames, at least 0.

    Raises
    ------
    InputError
        ``tracks`` or ``frames`` are not what they should be.
    """
    points = track_array(tracks)
    total = len(points)
    if frames is None:
        chosen = np.unique(np.linspace(min(trail, total - 1), total - 1, count).round().astype(int))
    else:
        chosen = np.atleast_1d(np.asarray(frames))
        if chosen.ndim != 1 or not chosen.size or chosen.dtype.kind not in "iu":
            raise InputError(f"frames: a list of frame numbers is needed, received {frames!r}")
        if chosen.min() < 0 or chosen.max() >= total:
            raise InputError(f"frames: numbers from 0 to {total - 1} are needed, received {chosen.tolist()}")
    measured = measurements_of(reconstruction, tracks)
    middle = reference_positions(points, measured.outlier)
    shown = spread_points(middle)
    colours = place_colours(np.asarray(middle[shown], dtype=np.float64))
    view = track_window(points, measured.outlier, chosen, shown, trail)
    column = (WIDTH - 0.5) / len(chosen)
    units = max(2 * view.half[0] / (0.96 * column), 2 * view.half[1] / 3.4)
    tall = 2 * view.half[1] / units
    part = f", {len(shown):,} of them drawn" if len(shown) < points.shape[1] else ""
    subtitle = f"{points.shape[1]:,} points in {total:,} frames{part}, with their way over the last {trail} frames"
    below = MAP_HEIGHT + 0.1 if measured.remarkable else 0.0
    with house_style():
        figure = new_figure(_HEADER + tall + 0.15 + below, title, subtitle)
        for j, frame in enumerate(chosen):
            centre = 0.25 + (j + 0.5) * column
            axes = box(figure, centre - view.half[0] / units, _HEADER, 2 * view.half[0] / units, tall)
            set_window(axes, view)
            draw_tracks(axes, points, int(frame), shown, colours, trail, measured.outlier)
            caption(figure, centre, _HEADER - 0.15, f"frame {frame}")
        if measured.remarkable:
            draw_measurements(figure, 0.5, _HEADER + tall + 0.2, WIDTH - 0.8, measured, chosen)
    return figure
