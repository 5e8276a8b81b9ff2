"""One look for every picture: colours, type, paper, and how a figure becomes a file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import FileError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER = "#fcfbf9"
INK = "#20262e"
GREY = "#68717d"
HAIRLINE = "#d9d6d0"
TRUTH = "#dccbba"
ESTIMATE = "#a4bfdb"
SEEN, UNSEEN, OUTLIER, LOST = "#86a7c8", "#e3ded5", "#c8553d", "#b5aea3"
"""What became of a measurement: used, never made, not believed, made of a point that has no shape."""
LINE_COLOURS = ("#2f6ea8", "#c8553d", "#3d8b6e")

WIDTH = 10.0
"""Inches across every figure."""
DPI = 160
ERROR_MAP = "viridis"

_RC: dict[str, Any] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: pictures look the same everywhere
    "font.size": 9.0,
    "text.color": INK,
    "figure.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "axes.edgecolor": HAIRLINE,
    "axes.labelcolor": GREY,
    "axes.labelsize": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ebe8e2",
    "grid.linewidth": 0.8,
    "xtick.color": HAIRLINE,
    "ytick.color": HAIRLINE,
    "xtick.labelcolor": GREY,
    "ytick.labelcolor": GREY,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.8,
    "lines.solid_capstyle": "round",
    "axes.unicode_minus": True,
    "path.simplify": True,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Apply the look inside a ``with`` block; matplotlib's own settings are as before afterwards."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()  # a user's matplotlibrc must not change the pictures
        mpl.rcParams.update(_RC)  # type: ignore[arg-type]  # the stubs want a literal for each key
        yield


def new_figure(height: float, title: str, subtitle: str = "") -> Figure:
    """Return an empty figure of the house's width and ``height`` inches with its title at the top left."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    FigureCanvasAgg(figure)
    figure.text(0.3 / WIDTH, 1 - 0.26 / height, title, size=14, weight="bold", va="top", color=INK)
    if subtitle:
        figure.text(0.3 / WIDTH, 1 - 0.56 / height, subtitle, size=9.5, va="top", color=GREY)
    return figure


def save_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: int = DPI) -> Path:
    """Write the figure; the file appears whole or not at all. The suffix gives the format (.png, .pdf, .svg).

    Raises ``FileError`` when the format is unknown or the file cannot be written.
    """
    from nrsfm.files.atomic import atomic_file

    path = Path(path)
    kind = path.suffix[1:].lower()
    known = sorted(figure.canvas.get_supported_filetypes())
    if kind not in known:
        raise FileError(f"{path}: the suffix must be one of .{', .'.join(known)}, received '{path.suffix}'")
    with house_style(), atomic_file(path) as stream:
        figure.savefig(stream, format=kind, dpi=dpi, facecolor=PAPER)
    return path


def rgb(colour: str) -> np.ndarray:
    """Red, green and blue of ``"#rrggbb"``, 0 to 1."""
    return np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])


def oklab_to_srgb(lab: np.ndarray) -> np.ndarray:
    """sRGB, outside 0…1 where a screen cannot show it. Source: Ottosson, "A perceptual color space"."""
    to_lms = np.array(
        [
            [1.0, 0.3963377774, 0.2158037573],
            [1.0, -0.1055613458, -0.0638541728],
            [1.0, -0.0894841775, -1.2914855480],
        ]
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = ((lab @ to_lms.T) ** 3) @ to_rgb.T
    curved = 1.055 * np.abs(linear) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curved)


@lru_cache(maxsize=8)
def _palette(count: int) -> tuple[np.ndarray, np.ndarray]:
    """``count`` colours far apart to the eye, the most distinct first: (count, 3) sRGB, (count, 3) OKLab."""
    lightness, chroma, hue = np.meshgrid(
        np.linspace(0.62, 0.90, 7), np.linspace(0.06, 0.16, 6), np.arange(0.0, 360.0, 7.5), indexing="ij"
    )
    angle = np.radians(hue)
    lab = np.stack([lightness, chroma * np.cos(angle), chroma * np.sin(angle)], axis=-1).reshape(-1, 3)
    shown = oklab_to_srgb(lab)
    lab = lab[((shown >= 0) & (shown <= 1)).all(axis=1)]
    # Lightness is also what shading changes, so it counts less towards telling colours apart.
    space = lab * (0.7, 1.0, 1.0)
    start = int(np.argmin(np.linalg.norm(lab - (0.66, -0.04, -0.1), axis=1)))
    chosen = [start]
    nearest = np.linalg.norm(space - space[start], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(space - space[chosen[-1]], axis=1))
        if len(chosen) == len(space):
            break
    repeated = np.resize(chosen, count)
    return np.clip(oklab_to_srgb(lab[repeated]), 0.0, 1.0), lab[repeated]


def group_colours(groups: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the labels (K,) in use and a colour (K, 3) for each, unlike those of the groups around it.

    ``positions`` (P, 3) is where the points lie; neighbouring groups get the most different colours.
    """
    labels, index = np.unique(groups, return_inverse=True)
    count = len(labels)
    colours, lab = _palette(count)
    sizes = np.bincount(index, minlength=count)
    known = np.isfinite(positions).all(axis=1)
    centres = (
        np.stack(
            [np.bincount(index[known], positions[known, k], minlength=count) for k in range(positions.shape[1])],
            axis=1,
        )
        / np.maximum(np.bincount(index[known], minlength=count), 1)[:, None]
    )
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    reach = np.median(np.sort(gaps, axis=1)[:, min(2, count - 1)]) + 1e-12
    unlike = np.linalg.norm((lab[:, None] - lab[None]) * (0.7, 1.0, 1.0), axis=2)
    given = np.full(count, -1)
    free = np.ones(count, dtype=bool)
    for group in np.argsort(-sizes, kind="stable"):
        done = np.flatnonzero(given >= 0)
        cost = (np.exp(-gaps[group, done] / reach) / (unlike[:, given[done]] + 0.02)).sum(axis=1)
        given[group] = int(np.argmin(np.where(free, cost, np.inf)))
        free[given[group]] = False
    return labels, colours[given]
