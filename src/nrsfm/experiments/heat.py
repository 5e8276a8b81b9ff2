"""A table of numbers as a picture: methods down, sequences across, colour by how far from the best of the column."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nrsfm.viewing.style import GREY, HAIRLINE, INK, PAPER, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES, _EDGE, _HEADER, _FOOT = 1.18, 0.28, 1.62, 0.62
_TALL = 0.265
_SPLIT = 0.1  # inches between groups of columns
_LETTER = 0.06  # inches: names that are wider than their columns are written at an angle
_WORST = 8.0  # times the best: the end of the colours


@dataclass(frozen=True)
class Field:
    """One number, or the few letters that stand where there is none."""

    value: float | None
    text: str


@dataclass(frozen=True)
class Column:
    """One sequence; ``group`` is written once above neighbours that share it."""

    name: str
    group: str


def heat_figure(
    title: str,
    subtitle: str,
    rows: Sequence[str],
    columns: Sequence[Column],
    fields: Sequence[Sequence[Field]],
    *,
    strong: Sequence[bool],
    foot: str = "",
) -> Figure:
    """Draw ``fields`` (rows × columns); the best of each column is outlined, ``strong`` rows have bold names."""
    breaks = sum(a.group != b.group for a, b in itertools.pairwise(columns))
    wide = (WIDTH - _NAMES - _EDGE - _SPLIT * breaks) / max(len(columns), 5)
    header = _HEADER if _steep(columns, wide) else _HEADER - 0.2
    height = header + _TALL * len(rows) + _FOOT
    size = 7.6 if wide > 0.46 else 6.6 if wide > 0.36 else 5.7
    with house_style():
        figure = new_figure(height, title, subtitle)
        axes = figure.add_axes((_NAMES / WIDTH, _FOOT / height, 1 - _NAMES / WIDTH, _TALL * len(rows) / height))
        axes.set_axis_off()
        axes.set_xlim(0, WIDTH - _NAMES)
        axes.set_ylim(len(rows), 0)
        known = [[v for r in fields if (v := r[j].value) is not None] for j in range(len(columns))]
        best = [min(values, default=None) for values in known]
        leaders = [{r[j].text for r in fields if r[j].value == best[j]} for j in range(len(columns))]
        places = [j * wide + _SPLIT * _groups_before(columns, j) for j in range(len(columns))]
        for i, row in enumerate(fields):
            for j, field in enumerate(row):
                box = (places[j] + 0.015, i + 0.04, wide - 0.03, 0.92)
                _draw(axes, box, field, best[j], size, leads=field.text in leaders[j])  # what reads the same is as good
            axes.text(
                -0.1,
                i + 0.52,
                rows[i],
                ha="right",
                va="center",
                size=8.6,
                weight="bold" if strong[i] else "normal",
                color=INK,
            )
        _head(axes, columns, places, wide)
        if foot:
            figure.text(_EDGE / WIDTH, 0.36 / height, foot, size=8, color=GREY, va="center")
        _scale(figure, height)
    return figure


def _shade(share: float | np.ndarray) -> np.ndarray:
    """Colours for shares of the way from the best to the worst."""
    import matplotlib as mpl

    return np.asarray(mpl.colormaps["YlOrBr"](0.02 + 0.86 * np.asarray(share)))


def _groups_before(columns: Sequence[Column], j: int) -> int:
    return sum(columns[k].group != columns[k + 1].group for k in range(j))


def _steep(columns: Sequence[Column], wide: float) -> bool:
    return max((len(column.name) for column in columns), default=0) * _LETTER > wide


def _draw(
    axes: Axes, box: tuple[float, float, float, float], field: Field, best: float | None, size: float, *, leads: bool
) -> None:
    from matplotlib.patches import Rectangle

    left, top, wide, tall = box
    x, y = left + wide / 2, top + tall / 2 + 0.02
    if field.value is None or best is None:
        axes.add_patch(Rectangle((left, top), wide, tall, facecolor="#f2efea", linewidth=0))
        axes.text(x, y, field.text, ha="center", va="center", size=size - 0.4, color=GREY, style="italic")
        return
    ratio = max(field.value, 1e-12) / max(best, 1e-12)
    share = float(np.clip(np.log(ratio) / np.log(_WORST), 0.0, 1.0))
    outline = {"edgecolor": INK, "linewidth": 1.1} if leads else {"linewidth": 0.0}
    axes.add_patch(Rectangle((left, top), wide, tall, facecolor=tuple(_shade(share)), **outline))
    colour, weight = INK if share < 0.62 else PAPER, "bold" if leads else "normal"
    axes.text(x, y, field.text, ha="center", va="center", size=size, color=colour, weight=weight)


def _head(axes: Axes, columns: Sequence[Column], places: Sequence[float], wide: float) -> None:
    for column, place in zip(columns, places, strict=True):
        steep = _steep(columns, wide)
        axes.text(
            place + wide / 2 - (0.06 if steep else 0),
            -0.18,
            column.name,
            rotation=38 if steep else 0,
            rotation_mode="anchor",
            ha="left" if steep else "center",
            va="bottom",
            size=7.8,
            color=INK,
        )
    for group in dict.fromkeys(column.group for column in columns):
        own = [place for column, place in zip(columns, places, strict=True) if column.group == group]
        left, right = own[0] + 0.02, own[-1] + wide - 0.02
        level = -2.05 if _steep(columns, wide) else -0.95
        axes.plot([left, right], [level, level], color=HAIRLINE, linewidth=1.2, clip_on=False)
        axes.text(left, level - 0.12, group, size=7.8, color=GREY, ha="left", va="bottom")


def _scale(figure: Figure, height: float) -> None:
    """The meaning of the colours, at the bottom right."""
    wide, tall = 2.3, 0.1
    axes = figure.add_axes(((WIDTH - _EDGE - wide - 0.12) / WIDTH, 0.33 / height, wide / WIDTH, tall / height))
    axes.imshow(_shade(np.linspace(0, 1, 200))[None, :, :3], aspect="auto", extent=(0, 1, 0, 1))
    axes.set_yticks([])
    ticks = [1, 2, 4, int(_WORST)]
    axes.set_xticks([np.log(t) / np.log(_WORST) for t in ticks], [f"{t}×" for t in ticks[:-1]] + [f"≥ {ticks[-1]}×"])
    axes.tick_params(length=0, labelsize=7.5, pad=2)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.text(-0.03, 0.5, "times the best of the column", ha="right", va="center", size=7.8, color=GREY)
