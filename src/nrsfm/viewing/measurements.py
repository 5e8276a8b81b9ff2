"""A map of the input: which points were seen in which frames, and which measurements were not believed."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.viewing.style import GREY, HAIRLINE, INK, LOST, OUTLIER, SEEN, UNSEEN, rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAP_HEIGHT = 1.55
"""Inches that :func:`draw_measurements` takes."""
_ROWS = 120  # rows of the map; more points than this share rows
_BELIEVED = 0.5  # a seen measurement of less confidence is drawn as an outlier


@dataclasses.dataclass(frozen=True)
class Measurements:
    """What became of each measurement.

    ``seen`` (F, P) bool; ``outlier`` (F, P) bool: seen, but not believed; ``lost`` (P,) bool: no shape came out.
    """

    seen: np.ndarray
    outlier: np.ndarray
    lost: np.ndarray

    @property
    def remarkable(self) -> bool:
        """Whether there is anything to show: complete, clean tracks have none."""
        return bool(not self.seen.all() or self.outlier.any() or self.lost.any())


def measurements_of(reconstruction: Any, tracks: Any) -> Measurements:
    """Return what became of the measurements; ``tracks`` are ``Tracks`` or points (F, P, 2), NaN where not seen.

    Confidence and lost points are the reconstruction's, where it has such. Raises ``InputError`` where the sizes
    differ.
    """
    points = np.asarray(getattr(tracks, "points", tracks))
    visible = getattr(tracks, "visible", None)
    seen = np.isfinite(points).all(axis=2) if visible is None else np.asarray(visible)
    lost = ~np.asarray(getattr(reconstruction, "reconstructed", np.ones(seen.shape[1], dtype=bool)))
    confidence = getattr(reconstruction, "confidence", None)
    if confidence is None:
        outlier = np.zeros(seen.shape, dtype=bool)
    elif confidence.shape != seen.shape:
        raise InputError(f"tracks: shape {(*confidence.shape, 2)} is needed, received {points.shape}")
    else:
        outlier = seen & (confidence < _BELIEVED) & ~lost
    return Measurements(seen, outlier, lost)


def measurement_picture(measurements: Measurements, rows: int = _ROWS) -> np.ndarray:
    """Colours (rows, F, 3), a column a frame: points never hidden on top, those hidden together next, lost ones last.

    Where several points share a row their colours are mixed, but outliers, which are few, show more than they are.
    """
    seen, lost = measurements.seen, measurements.lost
    hidden = ~seen
    order = np.lexsort((_together(hidden, ~lost), hidden.any(axis=0), lost))
    edges = np.linspace(0, len(order), min(rows, len(order)) + 1).round().astype(int)
    sizes = np.diff(edges)[:, None]

    def share(mask: np.ndarray) -> np.ndarray:
        return np.add.reduceat(mask[:, order].T.astype(np.float32), edges[:-1], axis=0) / sizes

    unseen, odd, gone = share(hidden), np.minimum(3.0 * share(measurements.outlier), 1.0), share(seen & lost)
    picture = np.tile(rgb(SEEN), (*unseen.shape, 1))
    for weight, colour in ((gone, LOST), (unseen, UNSEEN), (odd, OUTLIER)):
        picture += weight[..., None] * (rgb(colour) - picture)
    return np.clip(picture, 0.0, 1.0)


def _together(hidden: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """A number (P,) for each point, alike for points that are hidden in the same frames: their first component.

    Small for those that are hidden early, as far as it depends on time.
    """
    pattern = hidden.astype(np.float32)
    pattern -= pattern[:, counted].mean(axis=1, keepdims=True)
    gram = pattern[:, counted] @ pattern[:, counted].T
    leading = np.linalg.eigh(gram.astype(np.float64))[1][:, -1]
    if leading @ (np.arange(len(leading)) - 0.5 * (len(leading) - 1)) < 0:
        leading = -leading
    return np.asarray(leading @ pattern)


def draw_measurements(
    figure: Figure, left: float, top: float, width: float, measurements: Measurements, frames: np.ndarray
) -> None:
    """Draw the map, with its legend above and the drawn frames marked, into ``MAP_HEIGHT`` inches of the figure."""
    from matplotlib.ticker import MaxNLocator

    w, h = figure.get_size_inches()
    tall, head = MAP_HEIGHT - 0.72, 0.3
    figure.text(left / w, 1.0 - top / h, "measurements", va="top", size=9.0, weight="bold", color=INK)
    x = left + 1.25
    for text, colour in _legend(measurements):
        figure.text(x / w, 1.0 - (top + 0.005) / h, "■", va="top", size=9.0, color=colour)
        label = figure.text((x + 0.16) / w, 1.0 - top / h, text, va="top", size=8.5, color=GREY)
        x += 0.42 + label.get_window_extent().width / figure.dpi
    axes = figure.add_axes((left / w, 1.0 - (top + head + tall) / h, width / w, tall / h))
    total, count = measurements.seen.shape
    axes.imshow(
        measurement_picture(measurements),
        extent=(-0.5, total - 0.5, count, 0),
        aspect="auto",
        interpolation="nearest" if total < 400 else "antialiased",
    )
    axes.grid(False)
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(HAIRLINE)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=10))
    axes.tick_params(length=2.5, pad=2)
    axes.set_ylabel(f"{count:,} points", size=8.5, labelpad=4)
    axes.set_xlabel("frame", size=8.5, labelpad=1)
    axes.plot(frames, np.zeros(len(frames)), "v", color=INK, markersize=4.5, clip_on=False, zorder=5)


def _legend(measurements: Measurements) -> list[tuple[str, str]]:
    seen, outlier, lost = measurements.seen, measurements.outlier, measurements.lost
    used = seen & ~outlier & ~lost
    parts = [(f"used {_percent(used)}", SEEN)]
    if not seen.all():
        parts.append((f"not seen {_percent(~seen)}", UNSEEN))
    if outlier.any():
        parts.append((f"outliers {_percent(outlier)}", OUTLIER))
    if lost.any():
        number = int(lost.sum())
        parts.append((f"{number:,} point{'s' if number > 1 else ''} not reconstructed", LOST))
    return parts


def _percent(mask: np.ndarray) -> str:
    share = 100.0 * float(mask.mean())
    return "< 0.1 %" if 0 < share < 0.05 else f"{share:.1f} %"
