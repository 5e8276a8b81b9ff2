"""Pictures of a report: the shape from several sides, the tracks, what became of the measurements.

Surfaces and dense points are rendered (:mod:`nrsfm.viewing.render`) without a background, so that they lie on light and
dark pages alike; sparse points and lines are drawn as SVG in the page's own colours.

Source: ours.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from typing import Any

import numpy as np

from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.measurements import Measurements, measurement_picture
from nrsfm.viewing.render import render
from nrsfm.viewing.report.markup import Html, el
from nrsfm.viewing.scene import choose_frames, turned
from nrsfm.viewing.style import ERROR_MAP, ESTIMATE, PAPER, rgb
from nrsfm.viewing.tracks import spread_points
from nrsfm.viewing.viewer.geometry import upright

SIDES = (
    ("from the front", 0.0, 0.0),
    ("from the left", -60.0, 0.0),
    ("from the right", 60.0, 0.0),
    ("from above", 0.0, 42.0),
)
"""Names, turns to the side and tilts in degrees, from the average view."""
POSTER = (-24.06, -9.17)  # where the player begins: 0.42 and 0.16 radians
_SPARSE = 400  # fewer points than this are drawn as dots
_PIXELS = 300  # of the longer side of a picture from one side
_LARGE = 420
_POSTER = 720
_FINER = 2
_TRAIL = 12
_TRACKS = 150
_JUMP = 80.0  # of a picture 400 wide: lines to outliers would hide the others


@dataclasses.dataclass(frozen=True, eq=False)
class SideView:
    """A picture of one frame from one side."""

    frame: int
    side: str
    picture: Html


def _views(result: Reconstruction) -> np.ndarray:
    """(3, 3) the average camera from object: x right, y down, z away from the viewer."""
    return np.asarray(np.diag([1.0, -1.0, -1.0]) @ upright(result.rotations))


def _tilted(degrees: float) -> np.ndarray:
    """Turn (3, 3) about the picture's horizontal axis that shows more of the top."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def side_views(
    result: Reconstruction, faces: np.ndarray | None, edges: np.ndarray | None, *, count: int = 3
) -> list[SideView]:
    """Return pictures of up to ``count`` frames, those most unlike each other, from all ``SIDES``; frame by frame."""
    frames, middle = choose_frames(result.shapes, count), _views(result)
    cameras = [_tilted(tilt) @ turned(middle, turn) for _, turn, tilt in SIDES]
    clouds = [[_centred(result, int(f)) @ camera.T for camera in cameras] for f in frames]
    half = _half([view for views in clouds for view in views])
    out = []
    for f, views in zip(frames.tolist(), clouds, strict=True):
        for (side, _, _), view in zip(SIDES, views, strict=True):
            alternative = f"The shape in frame {f}, {side}"
            out.append(SideView(f, side, _picture(view, faces, edges, half, alternative, _PIXELS)))
    return out


def poster(result: Reconstruction, faces: np.ndarray | None, edges: np.ndarray | None, frame: int = 0) -> str:
    """Return the picture that stands in for the player, as a ``data:`` address."""
    view = _centred(result, frame) @ (_tilted(POSTER[1]) @ turned(_views(result), POSTER[0])).T
    half = _half([view])
    if _sparse(view, faces, edges):
        # Apart from the page: without its style sheet, so with colours that are readable on either background.
        drawn = str(_dots(view, edges, half, "")).replace('class="side"', 'xmlns="http://www.w3.org/2000/svg"')
        drawn = drawn.replace('class="bone"', 'stroke="#7f93a8"').replace('class="joint"', 'fill="#4d86bd"')
        return "data:image/svg+xml;base64," + base64.b64encode(drawn.encode()).decode("ascii")
    return _encoded(_rendered(view, faces, half, _POSTER))


def coloured_view(
    result: Reconstruction,
    values: np.ndarray,
    high: float,
    faces: np.ndarray | None,
    edges: np.ndarray | None,
    label: str,
) -> Html:
    """Return the middle frame from the front, its points coloured by values (P,), 0 to ``high``; grey: not known."""
    import matplotlib as mpl

    known = np.isfinite(values)
    colours = np.asarray(mpl.colormaps[ERROR_MAP](np.clip(np.where(known, values, 0.0) / high, 0.0, 1.0)))[:, :3]
    colours[~known] = 0.62
    view = _centred(result, result.n_frames // 2) @ _views(result).T
    return _picture(view, faces, edges, _half([view]), label, _LARGE, colours)


def _centred(result: Reconstruction, frame: int) -> np.ndarray:
    shape = np.asarray(result.shapes[frame], dtype=np.float64)
    return np.asarray(shape - np.nanmean(shape, axis=0))


def _half(views: list[np.ndarray]) -> tuple[float, float]:
    """Half the width and height that hold nearly all points of all views, about 0."""
    both = np.max([np.nanpercentile(np.abs(view[:, :2]), 99.8, axis=0) for view in views], axis=0)
    room = 1.07 * np.maximum(both, 1e-9 + 0.05 * both.max())
    return float(room[0]), float(room[1])


def _sparse(view: np.ndarray, faces: np.ndarray | None, edges: np.ndarray | None) -> bool:
    return faces is None and (edges is not None or int(np.count_nonzero(np.isfinite(view[:, 0]))) < _SPARSE)


def _picture(
    view: np.ndarray,
    faces: np.ndarray | None,
    edges: np.ndarray | None,
    half: tuple[float, float],
    alternative: str,
    pixels: int,
    colours: np.ndarray | None = None,
) -> Html:
    if _sparse(view, faces, edges):
        return _dots(view, edges, half, alternative, colours)
    image = _rendered(view, faces, half, pixels, colours)
    height, width = image.shape[:2]
    kind = None if colours is None else "shot"
    return el("img", src=_encoded(image), alt=alternative, width=width, height=height, decoding="async", class_=kind)


def _rendered(
    view: np.ndarray,
    faces: np.ndarray | None,
    half: tuple[float, float],
    pixels: int,
    colours: np.ndarray | None = None,
) -> np.ndarray:
    """(h, w, 4) uint8; what is not covered is transparent."""
    scale, paint = _FINER * pixels / (2 * max(half)), rgb(ESTIMATE) if colours is None else colours
    strength = 1.0 if colours is None else 0.45  # light must not change what colours say
    image = render(view, paint, half_size=half, pixels_per_unit=scale, triangles=faces, strength=strength)
    image = image[: image.shape[0] // _FINER * _FINER, : image.shape[1] // _FINER * _FINER]
    paper = (rgb(PAPER).astype(np.float32) * 255.0 + 0.5).astype(np.uint8)
    covered = (image != paper).any(axis=2)
    blocks = image.reshape(image.shape[0] // _FINER, _FINER, -1, _FINER, 3).astype(np.float64)
    cover = covered.reshape(blocks.shape[:4]).astype(np.float64)
    share = cover.sum(axis=(1, 3))
    colour = np.einsum("aibjc,aibj->abc", blocks, cover) / np.maximum(share, 1.0)[..., None]
    alpha = 255.0 * share / _FINER**2
    return np.rint(np.concatenate([colour, alpha[..., None]], axis=2)).astype(np.uint8)


def _encoded(image: np.ndarray) -> str:
    """A picture (h, w, 3 or 4) as a ``data:`` address."""
    from PIL import Image, features

    stream = io.BytesIO()
    picture = Image.fromarray(image)
    if features.check("webp"):
        picture.save(stream, "WEBP", quality=82, method=4)
        kind = "webp"
    else:
        picture.save(stream, "PNG", optimize=True)
        kind = "png"
    return f"data:image/{kind};base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _dots(
    view: np.ndarray,
    edges: np.ndarray | None,
    half: tuple[float, float],
    alternative: str,
    colours: np.ndarray | None = None,
) -> Html:
    """Points and the lines between them, far ones first and paler."""
    scale = 100.0 / max(half)
    xy = view[:, :2] * scale + np.array(half) * scale
    known = np.isfinite(view).all(axis=1)
    deep = view[:, 2]
    low, high = (float(np.min(deep[known])), float(np.max(deep[known]))) if known.any() else (0.0, 1.0)
    near = np.where(known, 1.0 - (deep - low) / ((high - low) or 1.0), 0.0)
    drawn: list[tuple[float, Html]] = []
    if edges is not None:
        for a, b in np.asarray(edges)[known[np.asarray(edges)].all(axis=1)].tolist():
            level = float(near[a] + near[b]) / 2
            line = el(
                "line",
                x1=f"{xy[a, 0]:.1f}",
                y1=f"{xy[a, 1]:.1f}",
                x2=f"{xy[b, 0]:.1f}",
                y2=f"{xy[b, 1]:.1f}",
                class_="bone",
                stroke_width="1.4",
                opacity=f"{0.35 + 0.65 * level:.2f}",
            )
            drawn.append((level, line))
    radius = 2.1 if np.count_nonzero(known) < 150 else 1.5
    for i in np.flatnonzero(known).tolist():
        level = float(near[i])
        dot = el(
            "circle",
            cx=f"{xy[i, 0]:.1f}",
            cy=f"{xy[i, 1]:.1f}",
            r=f"{radius * (0.75 + 0.35 * level):.2f}",
            class_="joint" if colours is None else None,
            fill=None if colours is None else "#" + "".join(f"{round(255 * c):02x}" for c in colours[i]),
            opacity=f"{0.4 + 0.6 * level:.2f}" if colours is None else None,
        )
        drawn.append((level + 1e-3, dot))
    drawn.sort(key=lambda pair: pair[0])
    return el(
        "svg",
        [part for _, part in drawn],
        viewBox=f"0 0 {2 * half[0] * scale:.1f} {2 * half[1] * scale:.1f}",
        role="img",
        aria_label=alternative,
        class_="side",
    )


def tracks_picture(tracks: Any, frame: int, doubted: np.ndarray) -> Html:
    """Return some tracks in a frame, with their way over the last frames, as SVG; ``doubted`` (P,) ones in red."""
    points = np.asarray(tracks.points)

    def seen(f: int, which: Any = slice(None)) -> np.ndarray:
        at = np.asarray(points[f, which], dtype=np.float64)
        return at if tracks.visible is None else np.where(np.asarray(tracks.visible[f])[which, None], at, np.nan)

    shown = spread_points(seen(frame), _TRACKS)
    frames = range(max(0, frame - _TRAIL), frame + 1)
    way = np.stack([seen(f, shown) for f in frames])
    now = way[-1]
    # The window is of the points now; outliers on the way must not stretch it.
    low, high = (np.nanpercentile(now, q, axis=0) for q in (2, 98))
    room = 0.14 * float(max((high - low).max(), 1e-9))
    low, high = low - room, high + room
    scale = 400.0 / float((high - low).max())
    way = (way - low) * scale
    inside = (way[-1] >= 0).all(axis=1) & (way[-1] <= (high - low) * scale).all(axis=1)
    drawn = []
    for i in np.flatnonzero(inside).tolist():
        path = way[np.isfinite(way[:, i, 0]), i]
        jump = np.linalg.norm(np.diff(path, axis=0), axis=1).max() if len(path) > 1 else np.inf
        if jump < _JUMP and not doubted[shown[i]]:
            drawn.append(el("polyline", points=" ".join(f"{x:.1f},{y:.1f}" for x, y in path), class_="way"))
    for (x, y), odd in zip(way[-1][inside], doubted[shown][inside], strict=True):
        drawn.append(el("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r="2.6", class_="odd" if odd else "joint"))
    size = (high - low) * scale
    return el(
        "svg",
        drawn,
        viewBox=f"0 0 {size[0]:.0f} {size[1]:.0f}",
        role="img",
        aria_label=f"{len(drawn)} marks: tracks in frame {frame} and their way over the frames before",
        class_="side",
    )


def measurement_map(found: Measurements) -> Html:
    """Return the map of which points were seen in which frames, a column a frame."""
    picture = (measurement_picture(found) * 255.0 + 0.5).astype(np.uint8)
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "PNG", optimize=True)
    address = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
    return el("img", src=address, alt="Map of the measurements: frames to the right, points downwards", class_="map")
