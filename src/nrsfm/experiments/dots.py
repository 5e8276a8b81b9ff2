"""Figures of dots on one logarithmic line for each name, in the house style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nrsfm.viewing.style import GREY, HAIRLINE, INK, PAPER, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HEADER, _FOOT, _LINE, _LEFT = 1.15, 0.62, 0.29, 1.35


@dataclass(frozen=True)
class Dot:
    """A number; ``hollow`` and ``crossed`` are two ways to set it apart."""

    value: float
    hollow: bool = False
    crossed: bool = False


def dots_figure(
    title: str,
    subtitle: str,
    lines: Sequence[tuple[str, str, Sequence[Dot]]],
    label: str,
    band: tuple[float, float, str],
) -> Figure:
    """Draw (name, colour, dots) lines below one another; ``band`` is a range of values and its meaning."""
    height = _HEADER + _FOOT + _LINE * len(lines)
    low, high, meaning = band
    with house_style():
        figure = new_figure(height, title, subtitle)
        place = (_LEFT / WIDTH, _FOOT / height, (WIDTH - _LEFT - 0.4) / WIDTH, _LINE * len(lines) / height)
        axes = figure.add_axes(place)
        axes.set_xscale("log")
        axes.set_ylim(len(lines) - 0.4, -0.6)
        axes.axvspan(low, high, color=HAIRLINE, alpha=0.6, linewidth=0, zorder=0)
        for i, (_, colour, dots) in enumerate(lines):
            values = [max(dot.value, 1.0) for dot in dots]
            axes.plot([min(values), max(values)], [i, i], color=colour, linewidth=1.2, alpha=0.4, zorder=1)
            for value, dot in zip(values, dots, strict=True):
                axes.plot(
                    value,
                    i,
                    "x" if dot.crossed else "o",
                    color=colour,
                    markerfacecolor=PAPER if dot.hollow else colour,
                    markersize=6,
                    markeredgewidth=1.3,
                    zorder=3,
                )
        axes.set_yticks(range(len(lines)), [name for name, _, _ in lines])
        axes.tick_params(axis="y", length=0, labelcolor=INK, labelsize=9)
        axes.grid(axis="y", visible=False)
        largest = max(dot.value for _, _, dots in lines for dot in dots)
        axes.set_xlim(0.8, max(2.7 * high, 1.5 * largest))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_xlabel(label)
        above = axes.get_xaxis_transform()
        middle = np.sqrt(low * high)
        axes.text(middle, 1.02, meaning, transform=above, ha="center", va="bottom", size=8, color=GREY)
    return figure
