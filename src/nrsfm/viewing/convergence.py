"""The picture of a run: energy, gap and rank per iteration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.style import GREY, LINE_COLOURS, WIDTH, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = (
    ("energy", "energy", "what the method minimises"),
    ("gap", "gap", "largest violation of the constraints"),
    ("rank", "rank", "singular values kept"),
)


def _histories(value: Any) -> dict[str, np.ndarray]:
    value = getattr(value, "diagnostics", value)
    if isinstance(value, dict) and isinstance(value.get("history"), dict):
        value = value["history"]
    if not isinstance(value, dict):
        raise InputError(f"history: a dict of lists is needed, received {type(value).__name__}")
    found = {}
    for key, _, _ in _PANELS:
        try:
            series = np.asarray(value.get(key) if value.get(key) is not None else [], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"history: '{key}' must be a list of numbers, received {value[key]!r:.80}") from error
        if series.ndim == 1 and np.isfinite(series).any():
            found[key] = series
    if not found:
        names = ", ".join(key for key, _, _ in _PANELS)
        raise InputError(f"history: one of {names} is needed, received {sorted(value)}")
    return found


def _draw(axes: Axes, key: str, series: np.ndarray, colour: str) -> None:
    from matplotlib.ticker import MaxNLocator

    step = np.arange(1, len(series) + 1)
    known = np.isfinite(series)
    values = series[known]
    if key == "rank":
        axes.step(step[known], values, where="mid", color=colour)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
        axes.set_ylim(0, max(1.0, values.max() * 1.12))
    else:
        axes.plot(step[known], values, color=colour)
        if values.min() > 0 and values.max() > 20 * values.min():
            axes.set_yscale("log")
        else:
            axes.margins(y=0.12)
    axes.plot(step[known][-1], values[-1], "o", color=colour, markersize=5, clip_on=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
    axes.set_xlim(0.5, max(len(series), 2) + 0.5)
    axes.text(
        1.0,
        1.16,
        f"{values[-1]:.3g}",
        transform=axes.transAxes,
        size=10.5,
        weight="bold",
        ha="right",
        color=colour,
    )


def convergence_figure(history: Any, *, title: str = "Convergence") -> Figure:
    """Draw energy, gap and rank per iteration.

    Parameters
    ----------
    history
        ``{"energy": [...], "gap": [...], "rank": [...]}``, diagnostics with such a ``"history"``, or a
        ``Reconstruction``. Any of the lists may be missing.

    Raises
    ------
    InputError
        None of the three is there, or one is not a list of numbers.
    """
    found = _histories(history)
    length = max(len(series) for series in found.values())
    height, header, foot, left, gap = 3.6, 1.3, 0.6, 0.75, 0.75
    width = (WIDTH - left - 0.35 - gap * (len(found) - 1)) / len(found)
    with house_style():
        figure = new_figure(height, title, f"{length} iteration{'s' if length != 1 else ''}")
        shown = [(panel, colour) for panel, colour in zip(_PANELS, LINE_COLOURS, strict=True) if panel[0] in found]
        for i, ((key, name, meaning), colour) in enumerate(shown):
            x = left + i * (width + gap)
            axes = figure.add_axes((x / WIDTH, foot / height, width / WIDTH, (height - header - foot) / height))
            _draw(axes, key, found[key], colour)
            axes.set_xlabel("iteration")
            axes.text(0.0, 1.16, name, transform=axes.transAxes, size=10.5, weight="bold")
            axes.text(0.0, 1.05, meaning, transform=axes.transAxes, size=8.5, color=GREY)
    return figure
