"""Tables of numbers as coloured fields, for numbers that have a meaning of their own, not only beside others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nrsfm.viewing.style import GREY, INK, PAPER, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES, _EDGE, _GAP, _HEADER, _FOOT, _TALL = 1.2, 0.3, 0.26, 1.78, 0.55, 0.3


@dataclass(frozen=True)
class Spot:
    """One field: its colour goes by ``value``, ``None`` is grey; ``outlined`` draws a frame around it."""

    value: float | None
    text: str
    outlined: bool = False


@dataclass(frozen=True)
class Block:
    """Fields (rows × columns) under one title."""

    title: str
    fields: Sequence[Sequence[Spot]]


def fields_figure(
    title: str,
    subtitle: str,
    blocks: Sequence[Block],
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    bounds: tuple[float, float],
    foot: str,
) -> Figure:
    """Draw blocks side by side; colours go by the logarithm of the value. Names of columns may have two lines."""
    room = (WIDTH - 2 * _EDGE - _NAMES - _GAP * (len(blocks) - 1)) / len(blocks)
    wide = room / len(columns)
    height = _HEADER + _TALL * len(rows) + _FOOT
    with house_style():
        figure = new_figure(height, title, subtitle)
        for b, block in enumerate(blocks):
            left = _EDGE + _NAMES + b * (room + _GAP)
            axes = figure.add_axes((left / WIDTH, _FOOT / height, room / WIDTH, _TALL * len(rows) / height))
            axes.set_axis_off()
            axes.set_xlim(0, len(columns))
            axes.set_ylim(len(rows), 0)
            words = {"size": 10, "weight": "bold", "va": "bottom"}
            figure.text((left + 0.02) / WIDTH, 1.0 - (_HEADER - 0.5) / height, block.title, **words)  # type: ignore[arg-type]
            for j, words_of_column in enumerate(columns):
                for k, word in enumerate(reversed(words_of_column.split("\n"))):
                    axes.text(j + 0.5, -0.25 - 0.45 * k, word, size=7.6, ha="center", va="baseline", color=GREY)
            for i, row in enumerate(block.fields):
                if b == 0:
                    axes.text(-0.14, i + 0.52, rows[i], size=9, ha="right", va="center")
                for j, spot in enumerate(row):
                    _draw(axes, i, j, spot, bounds, 8.0 if wide > 0.44 else 7.0)
        figure.text(_EDGE / WIDTH, 0.2 / height, foot, size=8.5, color=GREY, va="bottom")
    return figure


def _draw(axes: Axes, i: int, j: int, spot: Spot, bounds: tuple[float, float], size: float) -> None:
    import matplotlib as mpl
    from matplotlib.patches import Rectangle

    face, ink = "#f1eeea", GREY
    if spot.value is not None:
        low, high = np.log(bounds[0]), np.log(bounds[1])
        share = float(np.clip((np.log(max(spot.value, 1e-12)) - low) / (high - low), 0.0, 1.0))
        face = mpl.colors.to_hex(mpl.colormaps["YlOrBr"](0.03 + 0.82 * share))
        ink = INK if share < 0.66 else PAPER
    edge = {"edgecolor": INK, "linewidth": 1.2} if spot.outlined else {"linewidth": 0.0}
    axes.add_patch(Rectangle((j + 0.04, i + 0.06), 0.92, 0.88, facecolor=face, **edge))
    axes.text(j + 0.5, i + 0.52, spot.text, ha="center", va="center", size=size, color=ink)
