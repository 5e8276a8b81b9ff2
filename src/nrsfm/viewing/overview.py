"""One picture that tells the whole story: tracks in, shapes out, how good, and how grouped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.figures import check_groups, side_views
from nrsfm.viewing.panels import (
    Window,
    box,
    caption,
    colour_bar,
    colour_of,
    draw_shape,
    round_up,
    side_label,
    window,
)
from nrsfm.viewing.scene import SceneOptions, make_scene, mean_shape
from nrsfm.viewing.style import ESTIMATE, INK, TRUTH, WIDTH, group_colours, house_style, new_figure, rgb
from nrsfm.viewing.tracks import (
    draw_tracks,
    place_colours,
    set_window,
    spread_points,
    track_array,
    widest_frame,
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

    Columns whose data are missing are left out: truth and error without ``truth``, groups without labels.
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
    limit = 1.0
    if scene.truth is not None:
        gaps = scene.point_errors()
        known = gaps[np.isfinite(gaps)]
        limit = round_up(float(np.percentile(known, 98))) if known.size else 1.0
        beside = [s @ v.T for s, v in zip(scene.truth, sides, strict=True)]
        looks.append(("truth", beside, [rgb(TRUTH)] * len(front), 1.0, False))
        looks.append(("error", aside, [colour_of(g, limit) for g in gaps], 0.45, False))
    if groups is not None or getattr(reconstruction, "groups", None) is not None:
        labels = check_groups(reconstruction, groups, number)
        names, palette = group_colours(labels, mean_shape(scene.shapes))
        colours = palette[np.searchsorted(names, labels)]
        straight = [s @ scene.middle.T for s in scene.shapes]
        looks.append((f"{len(names)} groups", straight, [colours] * len(front), 0.6, True))

    middle = widest_frame(points)
    shown = spread_points(middle)
    tints = place_colours(np.asarray(middle[shown], dtype=np.float64))
    paths = [np.asarray(points[max(0, f - _TRAIL) : f + 1, shown], dtype=np.float64) for f in scene.frames]
    seen = window([p.reshape(-1, 2) for p in paths])
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
    with house_style():
        figure = new_figure(_HEADER + row * len(scene.frames) + 0.12, title, subtitle)
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
            draw_tracks(axes, points, int(frame), shown, tints, _TRAIL)
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
        if scene.truth is not None:
            colour_bar(figure, WIDTH - 2.8, 0.48, 2.5, limit, "error", scene.size, unit)
    return figure
