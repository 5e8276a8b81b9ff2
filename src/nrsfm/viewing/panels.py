"""One panel: a shape, seen from one side, drawn into a box of a figure whose place is given in inches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nrsfm.viewing.render import render
from nrsfm.viewing.scene import Scene
from nrsfm.viewing.style import DPI, GREY, INK, PAPER, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SPARSE = 400  # fewer points than this are drawn one by one
_PIXELS_PER_INCH = 1.5 * DPI  # more than the file's, so that edges come out smooth


class Window(NamedTuple):
    """The part of the picture plane that a row of panels shows, in the shapes' unit."""

    centre: tuple[float, float]
    half: tuple[float, float]


def window(clouds: list[np.ndarray], margin: float = 0.07) -> Window:
    """Return the smallest window around all clouds (P, 2 or 3), with a margin; never empty."""
    known = [c[np.isfinite(c).all(axis=1), :2] for c in clouds]
    known = [c for c in known if len(c)]
    if not known:
        return Window((0.0, 0.0), (1.0, 1.0))
    low, high = np.min([c.min(axis=0) for c in known], axis=0), np.max([c.max(axis=0) for c in known], axis=0)
    half = 0.5 * (high - low) * (1.0 + 2 * margin)
    largest = float(half.max()) or 1.0
    half = np.maximum(half, 0.2 * largest)
    middle = 0.5 * (low + high)
    return Window((float(middle[0]), float(middle[1])), (float(half[0]), float(half[1])))


def box(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return bare axes at the given inches from the figure's left and top edge."""
    w, h = figure.get_size_inches()
    axes = figure.add_axes((left / w, 1.0 - (top + height) / h, width / w, height / h))
    axes.set_axis_off()
    return axes


def draw_shape(
    figure: Figure,
    left: float,
    top: float,
    units_per_inch: float,
    view: Window,
    points: np.ndarray,
    colours: np.ndarray,
    scene: Scene,
    *,
    strength: float = 1.0,
    crisp: bool = False,
) -> Axes:
    """Draw points (P, 3), already in view coordinates, with colours (3,) or (P, 3)."""
    (cx, cy), (hx, hy) = view
    axes = box(figure, left, top, 2 * hx / units_per_inch, 2 * hy / units_per_inch)
    axes.set_xlim(cx - hx, cx + hx)
    axes.set_ylim(cy + hy, cy - hy)  # y grows downwards
    if scene.edges is not None or (scene.triangles is None and len(points) < _SPARSE):
        _draw_sparse(axes, points, colours, scene.edges, crisp or strength < 1.0)
        return axes
    picture = render(
        points - (cx, cy, 0.0),
        colours,
        half_size=view.half,
        pixels_per_unit=_PIXELS_PER_INCH / units_per_inch,
        triangles=scene.triangles,
        strength=strength,
        crisp=crisp,
    )
    axes.imshow(
        picture,
        extent=(cx - hx, cx + hx, cy + hy, cy - hy),
        aspect="auto",
        interpolation="antialiased",
        zorder=1,
    )
    if len(points) < _SPARSE:
        axes.scatter(points[:, 0], points[:, 1], s=2.5, color=INK, alpha=0.45, linewidths=0, zorder=2)
    return axes


def _draw_sparse(axes: Axes, points: np.ndarray, colours: np.ndarray, edges: np.ndarray | None, plain: bool) -> None:
    from matplotlib.collections import LineCollection

    known = np.isfinite(points).all(axis=1)
    if not known.any():
        return
    depth = points[:, 2]
    low, high = depth[known].min(), depth[known].max()
    near = 1.0 - (depth - low) / (high - low) if high > low else np.ones(len(points))
    each = np.broadcast_to(np.asarray(colours, dtype=float), (len(points), 3))
    # What lies further away fades into the paper; colours that carry values stay as they are.
    ink = each if plain else each * 0.72
    fade = np.where(known, 0.5 + 0.5 * near, 1.0)[:, None] * (1.0 if not plain else 0.0) + (1.0 if plain else 0.0)
    shown = np.clip(fade * ink + (1.0 - fade) * rgb(PAPER), 0.0, 1.0)
    size = float(np.clip(2600.0 / max(len(points), 1), 5.0, 34.0))
    if edges is not None:
        edges = edges[known[edges].all(axis=1)]
        edges = edges[np.argsort(-depth[edges].mean(axis=1))]
        tone = shown[edges].mean(axis=1)
        lines = points[edges][:, :, :2]
        axes.add_collection(LineCollection(list(lines), colors=tone, linewidths=2.2, capstyle="round", zorder=2))
        size *= 0.5
    order = np.flatnonzero(known)[np.argsort(-depth[known])]
    axes.scatter(points[order, 0], points[order, 1], s=size, c=shown[order], edgecolors=PAPER, linewidths=0.4, zorder=3)


def colour_bar(
    figure: Figure, left: float, top: float, width: float, limit: float, label: str, size: float, unit: str
) -> None:
    """Draw the error scale: the unit below, percent of the object's size above."""
    from nrsfm.viewing.style import ERROR_MAP

    w, h = figure.get_size_inches()
    axes = figure.add_axes((left / w, 1.0 - (top + 0.13) / h, width / w, 0.13 / h))
    axes.imshow(np.linspace(0, 1, 256)[None], extent=(0.0, limit, 0.0, 1.0), aspect="auto", cmap=ERROR_MAP)
    axes.set_yticks([])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=2.5, pad=2)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel(f"{label} ({unit})" if unit else label, labelpad=2)

    def to_percent(x: Any) -> Any:
        return 100.0 * x / size

    def to_unit(x: Any) -> Any:
        return x * size / 100.0

    if size > 0:
        percent = axes.secondary_xaxis("top", functions=(to_percent, to_unit))
        percent.spines["top"].set_visible(False)
        percent.tick_params(length=2.5, pad=1)
        percent.locator_params(axis="x", nbins=5)
        percent.set_xlabel("% of the object's size", labelpad=3)


def colour_of(values: np.ndarray, limit: float) -> np.ndarray:
    """Error colours (P, 3) of values (P,); grey where the value is not known."""
    import matplotlib as mpl

    from nrsfm.viewing.style import ERROR_MAP

    known = np.isfinite(values)
    scaled = np.where(known, values, 0.0) / (limit or 1.0)
    colours = np.asarray(mpl.colormaps[ERROR_MAP](np.clip(scaled, 0.0, 1.0)))[:, :3]
    return np.where(known[:, None], colours, 0.82)


def round_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 4, 5, 6, 8, 10 × a power of ten; 1 for zero."""
    if not np.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s for s in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if s * power >= value * 0.999) * power)


def side_label(figure: Figure, left: float, middle: float, text: str, *, strong: bool = False) -> None:
    """Write a row's name, turned, at the left of the row."""
    w, h = figure.get_size_inches()
    style: dict[str, Any] = {"size": 9.5, "weight": "bold", "color": INK} if strong else {"size": 9, "color": GREY}
    figure.text(left / w, 1.0 - middle / h, text, rotation=90, ha="center", va="center", **style)


def caption(figure: Figure, x: float, top: float, text: str, **style: Any) -> None:
    """Write text centred at x inches, its top at ``top`` inches."""
    w, h = figure.get_size_inches()
    figure.text(x / w, 1.0 - top / h, text, **{"ha": "center", "va": "top", "size": 9, "color": GREY, **style})
