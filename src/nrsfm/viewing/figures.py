"""Pictures of shapes: beside the truth, with their errors, with their subspace groups."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.panels import (
    Window,
    caption,
    colour_bar,
    colour_of,
    draw_shape,
    round_up,
    side_label,
    window,
)
from nrsfm.viewing.scene import Scene, SceneOptions, make_scene, mean_shape, turned
from nrsfm.viewing.style import ESTIMATE, TRUTH, WIDTH, group_colours, house_style, new_figure, rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEADER = 1.25
_GUTTER = 0.72
_EDGE = 0.25
SIDE_DEGREES = -55.0
_TALLEST = 2.6  # inches of one panel


def side_views(scene: Scene) -> np.ndarray:
    """Views (n, 3, 3) from the side.

    A surface is turned from the average view, so that its back is not shown and frames can be compared; lines
    between points are turned from what the camera saw.
    """
    if scene.edges is None:
        return np.tile(turned(scene.middle, SIDE_DEGREES), (len(scene.frames), 1, 1))
    return np.stack([turned(view, SIDE_DEGREES) for view in scene.views])


def _views(shapes: np.ndarray, rotations: np.ndarray) -> list[np.ndarray]:
    return [s @ r.T for s, r in zip(shapes, rotations, strict=True)]


def _scale(view: Window, columns: int, room: float, tallest: float = _TALLEST) -> tuple[float, float]:
    """Units per inch, and the column width in inches, so that ``columns`` panels fit into ``room`` inches."""
    column = room / columns
    return max(2 * view.half[0] / (0.96 * column), 2 * view.half[1] / tallest), column


def shapes_figure(
    reconstruction: Any,
    truth: Any = None,
    *,
    title: str = "Reconstruction",
    **options: Unpack[SceneOptions],
) -> Figure:
    """Draw truth and reconstruction in several frames: from the camera's view, and turned to the side.

    Parameters
    ----------
    reconstruction
        A ``Reconstruction``, or shapes (F, P, 3); without ``rotations`` these are seen along their z axis.
    truth
        True shapes (F, P, 3), NaN where unknown, or ``None``.
    options
        Faces, cameras, frames, alignment: see :class:`~nrsfm.viewing.scene.SceneOptions`.

    Raises
    ------
    InputError
        Arrays that do not fit together.
    """
    scene = make_scene(reconstruction, truth, **options)
    side = side_views(scene)
    rows: list[tuple[str, str, list[np.ndarray], str]] = []
    for place, views in (("as the camera sees it", scene.views), ("from the side", side)):
        if scene.truth is not None:
            rows.append((place, "truth", _views(scene.truth, views), TRUTH))
        rows.append((place, "reconstruction", _views(scene.shapes, views), ESTIMATE))
    per_place = len(rows) // 2
    windows = [window([c for r in rows[i * per_place : (i + 1) * per_place] for c in r[2]]) for i in range(2)]
    columns = len(scene.frames)
    room = WIDTH - _GUTTER - _EDGE
    widest = max(windows, key=lambda v: v.half[0])
    tallest = max(windows, key=lambda v: v.half[1])
    units, column = _scale(Window((0, 0), (widest.half[0], tallest.half[1])), columns, room)
    gap, split = 0.06, 0.3
    heights = [2 * windows[i // per_place].half[1] / units for i in range(len(rows))]
    height = _HEADER + sum(heights) + gap * len(rows) + split + 0.3
    subtitle = f"{len(scene.shapes[0]):,} points"
    if scene.errors is not None:
        subtitle += f" · reconstruction {scene.alignment}; e3D of each frame below"
    with house_style():
        figure = new_figure(height, title, subtitle)
        top = _HEADER
        for i, (place, name, clouds, colour) in enumerate(rows):
            view = windows[i // per_place]
            if i == per_place:
                top += split
            if i % per_place == 0:
                first = top
            side_label(figure, 0.58, top + heights[i] / 2, name)
            if i % per_place == per_place - 1:
                side_label(figure, 0.32, (first + top + heights[i]) / 2, place, strong=True)
            for j, cloud in enumerate(clouds):
                centre = _GUTTER + (j + 0.5) * column
                draw_shape(figure, centre - view.half[0] / units, top, units, view, cloud, rgb(colour), scene)
                if i == 0:
                    caption(figure, centre, _HEADER - 0.17, f"frame {scene.frames[j]}")
                if scene.errors is not None and i == per_place - 1:
                    caption(figure, centre, top + heights[i] + 0.05, f"e3D {scene.errors[j]:.3f}")
            top += heights[i] + gap
    return figure


def error_figure(
    reconstruction: Any,
    truth: Any,
    *,
    unit: str = "px",
    title: str = "Error of each point",
    **options: Unpack[SceneOptions],
) -> Figure:
    """Draw the distance of every point from the truth as colour, in several frames, from front and side.

    ``unit`` names the truth's unit. The scale ends at the 98th percentile of the errors shown. The percent
    scale is relative to the RMS distance of the true points from their centre: a frame's RMS percentage is
    its e3D. Other parameters and errors as in :func:`shapes_figure`.
    """
    if truth is None:
        raise InputError("truth: true shapes are needed to draw errors, received none")
    scene = make_scene(reconstruction, truth, **options)
    gaps = scene.point_errors()
    known = gaps[np.isfinite(gaps)]
    median = float(np.median(known)) if known.size else float("nan")
    subtitle = f"{scene.alignment} · median {median:.3g} {unit}".rstrip()
    return _coloured_figure(scene, gaps, title, subtitle, "distance from the truth", unit)


def uncertainty_figure(
    reconstruction: Any,
    *,
    unit: str = "px",
    title: str = "Uncertainty of the depth",
    **options: Unpack[SceneOptions],
) -> Figure:
    """Draw the standard deviation of the depth of every point as colour, in several frames, from front and side.

    ``reconstruction`` is a ``Reconstruction`` with ``depth_deviation``, ``unit`` names its unit. The scale ends at
    the 98th percentile of what is shown; its upper side is relative to the RMS distance of the points from their
    centre. Other parameters as in :func:`shapes_figure`. Raises ``InputError`` where there is no deviation.
    """
    deviation = getattr(reconstruction, "depth_deviation", None)
    if deviation is None:
        raise InputError("depth_deviation: it is needed to draw the uncertainty, received none")
    scene = make_scene(reconstruction, **options)
    values = np.asarray(deviation[scene.frames], dtype=np.float64)
    known = values[np.isfinite(values)]
    subtitle = f"standard deviation along the camera's axis · median {np.median(known):.3g} {unit}".rstrip()
    return _coloured_figure(scene, values, title, subtitle, "depth deviation", unit)


def scale_end(values: np.ndarray) -> float:
    """The round number at which a colour scale of these values ends; 1 where none is known."""
    known = values[np.isfinite(values)]
    return round_up(float(np.percentile(known, 98))) if known.size else 1.0


def _coloured_figure(scene: Scene, values: np.ndarray, title: str, subtitle: str, label: str, unit: str) -> Figure:
    """The shapes of the scene from front and side, coloured by values (n, P), with a colour bar."""
    limit = scale_end(values)
    front = scene.views if scene.edges is not None else np.tile(scene.middle, (len(values), 1, 1))
    rows = [_views(scene.shapes, rotations) for rotations in (front, side_views(scene))]
    windows = [window(r) for r in rows]
    columns, room = len(scene.frames), WIDTH - _GUTTER - _EDGE
    both = Window((0, 0), (max(v.half[0] for v in windows), max(v.half[1] for v in windows)))
    units, column = _scale(both, columns, room)
    heights = [2 * v.half[1] / units for v in windows]
    height = _HEADER + sum(heights) + 0.1 + 0.35
    with house_style():
        figure = new_figure(height, title, subtitle)
        top = _HEADER
        for i, (clouds, view) in enumerate(zip(rows, windows, strict=True)):
            side_label(figure, 0.5, top + heights[i] / 2, ("front", "side")[i])
            for j, cloud in enumerate(clouds):
                centre = _GUTTER + (j + 0.5) * column
                left = centre - view.half[0] / units
                colours = colour_of(values[j], limit)
                draw_shape(figure, left, top, units, view, cloud, colours, scene, strength=0.45)
                if i == 0:
                    caption(figure, centre, _HEADER - 0.17, f"frame {scene.frames[j]}")
                elif scene.errors is not None:
                    caption(figure, centre, top + heights[i] + 0.05, f"e3D {scene.errors[j]:.3f}")
            top += heights[i] + 0.1
        colour_bar(figure, WIDTH - 3.2 - _EDGE, 0.48, 3.0, limit, label, scene.size, unit)
    return figure


def groups_figure(
    reconstruction: Any,
    *,
    groups: Any = None,
    title: str = "Subspace groups",
    **options: Unpack[SceneOptions],
) -> Figure:
    """Draw the subspace group of every point as colour on the mean shape, from three sides.

    ``groups`` (P,) defaults to the reconstruction's own. Raises ``InputError`` where there are none; other
    parameters as in :func:`shapes_figure`.
    """
    scene = make_scene(reconstruction, **SceneOptions(**{"count": 24, **options}))
    labels = check_groups(reconstruction, groups, scene.shapes.shape[1])
    mean = mean_shape(scene.shapes)
    colours, sizes = colours_of_groups(labels, mean)
    clouds = [mean @ turned(scene.middle, angle).T for angle in (50.0, 0.0, -50.0)]
    view = window(clouds)
    units, column = _scale(view, 3, WIDTH - 2 * _EDGE, 4.2)
    tall = 2 * view.half[1] / units
    column = min(column, 2 * view.half[0] / units * 1.2)
    start = (WIDTH - 3 * column) / 2
    subtitle = f"{len(sizes)} groups of {sizes.min():,} to {sizes.max():,} points, on the mean shape"
    with house_style():
        figure = new_figure(_HEADER + tall + 0.05, title, subtitle)
        for j, cloud in enumerate(clouds):
            left = start + (j + 0.5) * column - view.half[0] / units
            draw_shape(figure, left, _HEADER - 0.2, units, view, cloud, colours, scene, strength=0.6, crisp=True)
    return figure


def colours_of_groups(labels: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours (P, 3) of the points, and the sizes (K,) of the groups; points without a mean shape are in none."""
    known = np.isfinite(mean).all(axis=1)
    colours = np.ones((len(labels), 3))
    if not known.any():
        return colours, np.zeros(1, dtype=int)
    names, palette = group_colours(labels[known], mean[known])
    index = np.searchsorted(names, labels[known])
    colours[known] = palette[index]
    return colours, np.bincount(index)


def check_groups(reconstruction: Any, groups: Any, points: int) -> np.ndarray:
    """Return the labels (P,), given or the reconstruction's; raises ``InputError`` where none fit."""
    value = getattr(reconstruction, "groups", None) if groups is None else groups
    if value is None:
        raise InputError("groups: labels are needed to draw groups, received none")
    labels = np.asarray(value)
    if labels.shape != (points,) or labels.dtype.kind not in "iu":
        raise InputError(f"groups: {points} integers are needed, received {labels.dtype} {labels.shape}")
    return labels
