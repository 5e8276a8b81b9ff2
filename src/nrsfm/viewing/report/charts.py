"""Simple charts as SVG inside the page: a line or a few over frames or iterations, in the page's own colours.

Pictures are 480 units wide, small ones 330: about as many pixels as they get on a desktop's screen.

Source: ours.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from nrsfm.viewing.report.markup import Html, el, number

WIDTHS, HEIGHT = {False: 480, True: 330}, 236
_TOP, _BOTTOM, _RIGHT = 14, 190, 14
_LETTER = 7.6  # width of a digit
_MOST = 600  # corners of a line; more are drawn as the lowest and highest of each stretch


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """One line: numbers, NaN where there are none; its name for the legend; ``band`` (2, n): drawn around it."""

    values: np.ndarray
    name: str = ""
    band: np.ndarray | None = None


def line_chart(
    lines: Sequence[Line],
    *,
    label: str,
    x_name: str,
    first: int = 0,
    over_frames: bool = False,
    steps: bool = False,
    from_zero: bool = True,
    small: bool = False,
) -> Html:
    """Return an SVG picture.

    Parameters
    ----------
    label
        What the picture shows, for those who do not see it.
    x_name
        Name of what runs to the right, from ``first`` on in whole steps.
    over_frames
        The player's frame is marked, and a click takes the player to a frame.
    steps
        Values hold until the next one.
    from_zero
        The scale begins at zero, unless it is logarithmic (positive numbers over more than a factor of 30).
    small
        One of several in a row.
    """
    count = max(len(line.values) for line in lines)
    parts = [line.values for line in lines] + [line.band.ravel() for line in lines if line.band is not None]
    known = np.concatenate(parts)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    logarithmic = from_zero and low > 0 and high > 30 * low
    ticks, low, high = _log_ticks(low, high) if logarithmic else _ticks(low, high, zero=from_zero and low >= 0)
    labels = [number(tick, 3) for tick in ticks]
    left, right = 16 + _LETTER * max(map(len, labels)), WIDTHS[small] - _RIGHT
    across = (right - left) / max(count - 1, 1)

    def place(values: np.ndarray) -> np.ndarray:
        scaled = np.log10(np.maximum(values, 1e-300)) if logarithmic else values
        ends = (math.log10(low), math.log10(high)) if logarithmic else (low, high)
        return np.asarray(_BOTTOM - (_BOTTOM - _TOP) * (scaled - ends[0]) / (ends[1] - ends[0]))

    drawn = [el("title", label)]
    for tick, text in zip(ticks, labels, strict=True):
        y = float(place(np.array(tick)))
        drawn.append(el("line", x1=f"{left:.1f}", x2=right, y1=f"{y:.1f}", y2=f"{y:.1f}", class_="grid"))
        drawn.append(el("text", text, x=f"{left - 8:.1f}", y=f"{y + 4:.1f}", text_anchor="end"))
    for step in _whole_ticks(count, first, 4 if small else 6):
        x = left + across * (step - first)
        drawn.append(el("text", f"{step:,}", x=f"{x:.1f}", y=_BOTTOM + 19, text_anchor="middle"))
    drawn.append(el("text", x_name, x=f"{(left + right) / 2:.1f}", y=_BOTTOM + 38, text_anchor="middle", class_="name"))
    for k, line in enumerate(lines):
        if line.band is not None:
            outline = _stretch(place(line.band[0]), left, across), _stretch(place(line.band[1]), left, across)[::-1]
            drawn.append(el("polygon", points=_text([*outline[0], *outline[1]]), class_=f"band c{k}"))
        for run in _runs(line.values):
            ys = place(line.values[run])
            points = _stretch(ys, left + across * run.start, across)
            if steps:
                points = [
                    p for x, y in points for p in ((max(x - across / 2, left), y), (min(x + across / 2, right), y))
                ]
            if len(points) == 1:
                drawn.append(el("circle", cx=f"{points[0][0]:.1f}", cy=f"{points[0][1]:.1f}", r=3, class_=f"dot c{k}"))
            else:
                drawn.append(el("polyline", points=_text(points), class_=f"line c{k}"))
    picture = el(
        "svg",
        drawn,
        viewBox=f"0 0 {WIDTHS[small]} {HEIGHT}",
        role="img",
        aria_label=label,
        class_="chart small" if small else "chart",
        data_frames=count if over_frames else None,
        data_plot=f"{left:.1f} {right} {_TOP} {_BOTTOM}" if over_frames else None,
    )
    named = [(k, line.name) for k, line in enumerate(lines) if line.name]
    if len(named) < 2:
        return picture
    keys = [el("li", el("span", class_=f"key c{k}"), name) for k, name in named]
    return Html(picture + el("ul", keys, class_="legend"))


def _stretch(ys: np.ndarray, left: float, across: float) -> list[tuple[float, float]]:
    """Corners of a line; of very many the lowest and the highest of each stretch."""
    xs = left + across * np.arange(len(ys))
    if len(ys) <= _MOST:
        return list(zip(xs.tolist(), ys.tolist(), strict=True))
    out = []
    for part in np.array_split(np.arange(len(ys)), _MOST // 2):
        ends = sorted({int(part[np.argmin(ys[part])]), int(part[np.argmax(ys[part])])})
        out += [(float(xs[i]), float(ys[i])) for i in ends]
    return out


def _text(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _runs(values: np.ndarray) -> list[slice]:
    """Stretches without gaps."""
    known = np.concatenate([[False], np.isfinite(values), [False]])
    edges = np.flatnonzero(known[1:] != known[:-1])
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _ticks(low: float, high: float, *, zero: bool) -> tuple[list[float], float, float]:
    """Round numbers from below ``low`` to above ``high``, and the ends."""
    if zero:
        low = 0.0
    if high <= low:
        high = low + (abs(low) or 1.0)
    step = 10.0 ** math.floor(math.log10((high - low) / 3))
    step *= next(m for m in (1, 2, 2.5, 5, 10) if (high - low) / (step * m) <= 4.6)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [k * step for k in range(first, last + 1)], first * step, last * step


def _log_ticks(low: float, high: float) -> tuple[list[float], float, float]:
    """Powers of ten, at most about five of them."""
    first, last = math.floor(math.log10(low) + 1e-9), math.ceil(math.log10(high) - 1e-9)
    last = max(last, first + 1)
    every = -(-(last - first) // 5)
    first -= -(last - first) % every  # both ends have a tick
    return [10.0**k for k in range(first, last + 1, every)], 10.0**first, 10.0**last


def _whole_ticks(count: int, first: int, most: int) -> list[int]:
    if count < 2:
        return [first]
    step = 10 ** math.floor(math.log10(max((count - 1) / most, 1)))
    step *= next(m for m in (1, 2, 5, 10) if (count - 1) / (step * m) <= most)
    start = -(-first // step) * step
    return [first] * (start != first and start - first >= step / 2) + list(range(start, first + count, step))
