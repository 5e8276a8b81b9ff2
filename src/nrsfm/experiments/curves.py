"""Figures of curves in the house style: panels in rows, every curve named where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nrsfm.viewing.style import GREY, HAIRLINE, PAPER, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (
    *("#2f6ea8", "#c8553d", "#3d8b6e", "#8a5a9e", "#b07d1e", "#4a5568", "#b8487f", "#3a9aa8", "#7b8f2f", "#8c5a3c"),
    *("#6f7fd6", "#5f9f3f", "#a06fc0", "#d0809a", "#1f2328"),
)
_ORDER = "geometry-aware grassmann bmm pta mp ds dv smsr csf1 em-pnd csf2 ksta rbmm organic auto"
_METHODS = {name: i for i, name in enumerate(_ORDER.split())}

_LEFT, _RIGHT, _FOOT = 0.72, 0.3, 0.58
_GAP, _LABELS = 0.42, 0.98  # inches between panels; more where curves are named
_HEADER, _BETWEEN, _NAMED_AXIS = 1.38, 0.82, 0.3
_LINE = 0.155  # inches between two names


@dataclass(frozen=True)
class Curve:
    """One line: ``ring`` marks points of it; ``quiet`` draws it thin and dotted (published numbers, yardsticks).

    ``strong`` draws it thicker than the others, with its name in bold; ``spread`` is a band of so much above and below.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    colour: str
    dashed: bool = False
    quiet: bool = False
    ring: Sequence[float] = ()
    name_at_end: bool = False
    strong: bool = False
    spread: Sequence[float] = ()


@dataclass(frozen=True)
class Panel:
    """One set of axes.

    ``band``: a range of x and its meaning. ``uprights``, ``level``: lines at these x, this y. ``named``: curves are
    named at their ends.
    """

    title: str
    curves: Sequence[Curve]
    note: str = ""
    x_label: str = ""
    y_label: str = ""
    band: tuple[float, float, str] | None = None
    ticks: Sequence[tuple[float, str]] = ()
    log_x: bool = False
    log_y: bool = False
    named: bool = False
    limits: tuple[float, float] | None = None
    x_limits: tuple[float, float] | None = None
    uprights: Sequence[float] = ()
    level: float | None = None


def method_colour(name: str) -> str:
    """The colour that stands for a method in every figure."""
    return COLOURS[_METHODS.get(name, sum(map(ord, name)) % len(COLOURS))]


def curve_figure(
    title: str,
    subtitle: str,
    rows: Sequence[Sequence[Panel]],
    *,
    tall: float = 2.15,
    share: str = "row",
    names: float = _LABELS,
) -> Figure:
    """Draw panels in rows; ``share`` is whose range of y is common: "row", "all" or "none".

    ``tall``: inches of a panel; ``names``: inches for the names of curves.
    """
    columns = max(len(row) for row in rows)
    after = [
        max((names if row[j].named else 0.0) for row in rows if j < len(row)) + (_GAP if j < columns - 1 else _RIGHT)
        for j in range(columns)
    ]
    if any(panel.y_label for row in rows for panel in row[1:]):
        after = [gap + (0.34 if j < columns - 1 else 0.0) for j, gap in enumerate(after)]
    width = (WIDTH - _LEFT - sum(after)) / columns
    between = _BETWEEN + (_NAMED_AXIS if any(panel.x_label for row in rows[:-1] for panel in row) else 0.0)
    height = _HEADER + len(rows) * tall + (len(rows) - 1) * between + _FOOT
    every = [panel for row in rows for panel in row]
    with house_style():
        figure = new_figure(height, title, subtitle)
        for i, row in enumerate(rows):
            top = _HEADER + i * (tall + between)
            left = _LEFT
            for j, panel in enumerate(row):
                axes = figure.add_axes(
                    (left / WIDTH, 1 - (top + tall) / height, width / WIDTH, tall / height),
                )
                peers = {"row": list(row), "all": every}.get(share, [panel])
                _draw(axes, panel, _range(panel, peers), tall)
                left += width + after[j]
    return figure


def _range(panel: Panel, peers: Sequence[Panel]) -> tuple[float, float]:
    if panel.limits is not None:
        return panel.limits
    values = np.array([v for p in peers for c in p.curves for v in c.y if v is not None and np.isfinite(v)])
    if not len(values):
        return 0.0, 1.0
    if panel.log_y:
        positive = values[values > 0]
        low, high = (positive.min(), positive.max()) if len(positive) else (0.1, 1.0)
        return float(low / 1.3), float(max(high, low * 3) * 1.3)
    low, high = float(values.min()), float(values.max())
    return (0.0 if low >= 0 else low - 0.08 * (high - low)), high + 0.13 * (high - min(low, 0.0)) + 1e-12


def _draw(axes: Axes, panel: Panel, limits: tuple[float, float], tall: float) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

    if panel.log_x:
        axes.set_xscale("log")
    if panel.log_y:
        axes.set_yscale("log")
    axes.set_ylim(*limits)
    if panel.x_limits is not None:
        axes.set_xlim(*panel.x_limits)
    if panel.band is not None:
        low, high, text = panel.band
        axes.axvspan(low, high, color=HAIRLINE, alpha=0.55, zorder=0, linewidth=0)
        middle = np.sqrt(low * high) if panel.log_x else 0.5 * (low + high)
        place = axes.get_xaxis_transform()
        axes.text(middle, 0.97, text, transform=place, ha="center", va="top", size=7.8, color=GREY)
    for x in panel.uprights:
        axes.axvline(x, color=GREY, linewidth=0.9, linestyle=(0, (3, 3)), zorder=1)
    if panel.level is not None:
        axes.axhline(panel.level, color=GREY, linewidth=0.9, zorder=1)
    for curve in panel.curves:
        _line(axes, curve)
    if panel.ticks:
        words = any(not text[:1].isdigit() for _, text in panel.ticks)
        axes.set_xticks([place for place, _ in panel.ticks], [text for _, text in panel.ticks])
        axes.tick_params(axis="x", labelsize=7.8 if words else 8.5)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.minorticks_off()
    elif not panel.log_x:
        axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10], integer=_whole(panel)))
        axes.xaxis.set_major_formatter(FuncFormatter(_short))
    if panel.log_y:
        ratio = limits[1] / limits[0]
        subs = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0) if ratio < 12 else (1.0, 2.0, 5.0) if ratio < 500 else (1.0,)
        axes.yaxis.set_major_locator(LogLocator(subs=subs))
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_formatter(FuncFormatter(_short))
    axes.tick_params(length=2.5)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.text(0.0, 1.135, panel.title, transform=axes.transAxes, size=10, weight="bold", va="baseline")
    if panel.note:
        axes.text(0.0, 1.035, panel.note, transform=axes.transAxes, size=8.2, color=GREY, va="baseline")
    if panel.named:
        _name(axes, panel.curves, tall)


def _whole(panel: Panel) -> bool:
    return all(float(x).is_integer() for curve in panel.curves for x in curve.x)


def _short(value: float, _: object = None) -> str:
    """.05 for 0.05: errors are written so throughout; powers of ten below a thousandth."""
    power = np.log10(value) if value > 0 else 0.0
    if power < -3.5 and abs(power - round(power)) < 1e-6:
        return f"10{str(round(power)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    text = f"{value:.4g}"
    return text[1:] if text.startswith("0.") else text.replace("-0.", "−.").replace("-", "−")


def _line(axes: Axes, curve: Curve) -> None:
    x = np.asarray(curve.x, dtype=np.float64)
    y = np.array([np.nan if v is None else v for v in curve.y], dtype=np.float64)
    if curve.quiet:
        axes.plot(x, y, color=curve.colour, linewidth=1.2, linestyle=(0, (1, 1.6)), zorder=2)
        if curve.label:
            at, sides = (-1, ("right", "top")) if curve.name_at_end else (0, ("left", "bottom"))
            shift = (0, -4) if curve.name_at_end else (3, 3)
            axes.annotate(
                curve.label,
                (x[at], y[at]),
                shift,
                textcoords="offset points",
                size=7.8,
                color=GREY,
                ha=sides[0],
                va=sides[1],
            )
        return
    style = (0, (3.2, 1.8)) if curve.dashed else "-"
    if len(curve.spread):
        spread = np.asarray(curve.spread, dtype=np.float64)
        axes.fill_between(x, y - spread, y + spread, color=curve.colour, alpha=0.13, linewidth=0, zorder=1)
    top = 2 if curve.strong else 0
    axes.plot(x, y, color=curve.colour, linestyle=style, linewidth=2.8 if curve.strong else 1.7, zorder=3 + top)
    if len(x) <= 24:
        size = 4.6 if curve.strong else 2.9
        axes.plot(x, y, "o", color=curve.colour, markersize=size, zorder=4 + top, markeredgewidth=0)
    for place in curve.ring:
        here = x == place
        axes.plot(
            x[here],
            y[here],
            "o",
            markersize=7.5,
            markerfacecolor=PAPER,
            markeredgecolor=curve.colour,
            markeredgewidth=1.7,
            zorder=5,
            clip_on=False,
        )


def _name(axes: Axes, curves: Sequence[Curve], tall: float) -> None:
    """Write the curves' names right of the axes, apart from each other, joined to their ends."""
    ends = []
    for curve in curves:
        known = [(x, y) for x, y in zip(curve.x, curve.y, strict=True) if y is not None and np.isfinite(y)]
        if known and curve.label and not curve.quiet:
            x, y = known[-1]
            across, up = axes.transAxes.inverted().transform(axes.transData.transform((x, y)))
            ends.append((float(np.clip(up, 0.0, 1.0)), float(across), curve))
    ends.sort(key=lambda end: end[0])
    places = spread_out([end[0] for end in ends], _LINE / tall)
    for place, (up, across, curve) in zip(places, ends, strict=True):
        axes.annotate(
            curve.label,
            xy=(min(across, 1.0), up),
            xytext=(1.055, place),
            xycoords="axes fraction",
            textcoords="axes fraction",
            size=8.3,
            color=GREY if curve.quiet else curve.colour,
            weight="bold" if curve.strong else "normal",
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": curve.colour,
                "linewidth": 0.7,
                "alpha": 0.55,
                "shrinkA": 1.5,
                "shrinkB": 1.0,
                "relpos": (0.0, 0.5),
            },
        )


def spread_out(places: Sequence[float], gap: float) -> list[float]:
    """The ascending places moved as little as needed so that neighbours are ``gap`` apart, around their own middle."""
    # Blocks of touching names: a block is where its members would be on average.
    blocks: list[tuple[float, int]] = []
    for place in places:
        blocks.append((place, 1))
        while len(blocks) > 1:
            (first, n), (second, m) = blocks[-2:]
            if second - first >= gap * (n + m) / 2:
                break
            blocks[-2:] = [((first * n + second * m) / (n + m), n + m)]
    return [middle + gap * (i - (count - 1) / 2) for middle, count in blocks for i in range(count)]
