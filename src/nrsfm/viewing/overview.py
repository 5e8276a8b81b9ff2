"""One picture that tells the whole story: tracks in, shapes out, how good, and how grouped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.figures import check_groups, colours_of_groups, scale_end, side_views
from nrsfm.viewing.measurements import MAP_HEIGHT, draw_measurements, measurements_of
from nrsfm.viewing.panels import (
    Window,
    box,
    caption,
    colour_bar,
    colour_of,
    draw_shape,
    side_label,
    window,
)
from nrsfm.viewing.scene import Scene, SceneOptions, make_scene, mean_shape
from nrsfm.viewing.style import ESTIMATE, INK, TRUTH, WIDTH, house_style, new_figure, rgb
from nrsfm.viewing.tracks import (
    draw_tracks,
    place_colours,
    reference_positions,
    set_window,
    spread_points,
    track_array,
    track_window,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEADER = 1.4
_LEFT = 0.5
_TRAIL = 6


def overview_figure(
    reconstruction: Any,
    tracks: Any,
    truth: Any = None,
    *,
    groups: Any = None,
    unit: str = "px",
    title: str = "2D tracks in, 3D shapes out",
    subtitle: str | None = None,
    **options: Unpack[SceneOptions],
) -> Figure:
    """Draw, for a few frames: the tracks, the shape as the camera sees it and from the side, errors, groups.

    Columns whose data are missing are left out: truth and error without ``truth``, groups without labels. Where
    there is no truth, the standard deviation of the depth takes the place of the error. A map of the measurements
    is drawn below where some are missing or were not believed, or a point has no shape.
    ``tracks`` are ``Tracks`` or points (F, P, 2); the other parameters and errors are those of
    :func:`~nrsfm.viewing.shapes_figure`, :func:`~nrsfm.viewing.error_figure` and
    :func:`~nrsfm.viewing.groups_figure`. By default two frames are drawn.
    """
    scene = make_scene(reconstruction, truth, **SceneOptions(**{"count": 2, **options}))
    points = track_array(tracks)
    total, number = np.shape(getattr(reconstruction, "shapes", reconstruction))[:2]
    if points.shape[:2] != (total, number):
        raise InputError(f"tracks: shape ({total}, {number}, 2) is needed, received {points.shape}")
    sides = side_views(scene)
    front = [s @ v.T for s, v in zip(scene.shapes, scene.views, strict=True)]
    aside = [s @ v.T for s, v in zip(scene.shapes, sides, strict=True)]
    looks: list[tuple[str, list[np.ndarray], list[np.ndarray], float, bool]] = []
    plain = [rgb(ESTIMATE)] * len(front)
    looks.append(("3D shape", front, plain, 1.0, False))
    looks.append(("from the side", aside, plain, 1.0, False))
    values, label = _values(scene, getattr(reconstruction, "depth_deviation", None))
    limit = 1.0 if values is None else scale_end(values)
    if scene.truth is not None:
        beside = [s @ v.T for s, v in zip(scene.truth, sides, strict=True)]
        looks.append(("truth", beside, [rgb(TRUTH)] * len(front), 1.0, False))
    if values is not None:
        looks.append((label, aside, [colour_of(each, limit) for each in values], 0.45, False))
    if groups is not None or getattr(reconstruction, "groups", None) is not None:
        labels = check_groups(reconstruction, groups, number)
        colours, sizes = colours_of_groups(labels, mean_shape(scene.shapes))
        straight = [s @ scene.middle.T for s in scene.shapes]
        looks.append((f"{len(sizes)} groups", straight, [colours] * len(front), 0.6, True))

    measured = measurements_of(reconstruction, tracks)
    middle = reference_positions(points, measured.outlier)
    shown = spread_points(middle)
    tints = place_colours(np.asarray(middle[shown], dtype=np.float64))
    seen = track_window(points, measured.outlier, scene.frames, shown, _TRAIL)
    windows = [window(clouds) for _, clouds, _, _, _ in looks]
    both = Window((0, 0), (max(v.half[0] for v in windows), max(v.half[1] for v in windows)))
    column = (WIDTH - _LEFT - 0.2) / (1 + len(looks))
    units = max(2 * both.half[0] / (0.95 * column), 2 * both.half[1] / 2.7)
    row = 2 * both.half[1] / units + 0.08
    track_units = max(2 * seen.half[0] / (0.96 * column), 2 * seen.half[1] / (row - 0.08))
    if subtitle is None:
        subtitle = f"{number:,} points in {total:,} frames"
        if getattr(reconstruction, "method", ""):
            subtitle += f" · method {reconstruction.method}"
        if scene.errors is not None and np.isfinite(scene.errors).any():
            subtitle += f" · e3D of these frames {np.nanmean(scene.errors):.3f}"
    below = MAP_HEIGHT + 0.1 if measured.remarkable else 0.0
    with house_style():
        figure = new_figure(_HEADER + row * len(scene.frames) + 0.12 + below, title, subtitle)
        heading = {"weight": "bold", "color": INK, "size": 9.0}
        caption(figure, _LEFT + 0.5 * column, _HEADER - 0.24, "tracks", **heading)
        for j, (name, *_) in enumerate(looks):
            caption(figure, _LEFT + (j + 1.5) * column, _HEADER - 0.24, name, **heading)
        for i, frame in enumerate(scene.frames):
            top = _HEADER + i * row
            side_label(figure, 0.3, top + row / 2, f"frame {frame}")
            wide, tall = 2 * seen.half[0] / track_units, 2 * seen.half[1] / track_units
            axes = box(figure, _LEFT + 0.5 * column - wide / 2, top + (row - tall) / 2, wide, tall)
            set_window(axes, seen)
            draw_tracks(axes, points, int(frame), shown, tints, _TRAIL, measured.outlier)
            for j, (look, view) in enumerate(zip(looks, windows, strict=True)):
                _, clouds, colours_of, strength, crisp = look
                left = _LEFT + (j + 1.5) * column - view.half[0] / units
                above = top + row / 2 - view.half[1] / units
                draw_shape(
                    figure,
                    left,
                    above,
                    units,
                    view,
                    clouds[i],
                    colours_of[i],
                    scene,
                    strength=strength,
                    crisp=crisp,
                )
        if measured.remarkable:
            above = _HEADER + row * len(scene.frames) + 0.15
            draw_measurements(figure, _LEFT, above, WIDTH - _LEFT - 0.3, measured, scene.frames)
        if values is not None:
            colour_bar(figure, WIDTH - 2.8, 0.48, 2.5, limit, label, scene.size, unit)
    return figure


def _values(scene: Scene, deviation: np.ndarray | None) -> tuple[np.ndarray | None, str]:
    """What the shapes are coloured by, (n, P), and its name: errors where there is a truth, else deviations."""
    if scene.truth is not None:
        return scene.point_errors(), "error"
    if deviation is not None:
        return np.asarray(deviation[scene.frames], dtype=np.float64), "depth deviation"
    return None, ""
