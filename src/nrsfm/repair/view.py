"""Tracks with gaps as the repair sees them: around each frame's median, in one unit, read by columns.

Also the questions that come before any computation: which points were seen often enough, and whether the pattern of
what was seen ties all frames together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nrsfm.compression import in_range, out_of_range
from nrsfm.errors import InputError
from nrsfm.tracks import Tracks

LEAST_IN_FRAME = 4  # points: fewer do not fix a frame's translation and camera
_SAMPLE = 2_000
_CHUNK = 400_000  # entries of a chunk


@dataclass(frozen=True)
class View:
    """``points`` (F, P, 2) and ``visible`` (F, P) or ``None`` are the caller's; ``offset`` (F, 2); ``unit``."""

    points: np.ndarray
    visible: np.ndarray | None
    offset: np.ndarray
    unit: float

    @property
    def frames(self) -> int:
        """F."""
        return self.points.shape[0]

    @property
    def count(self) -> int:
        """P."""
        return self.points.shape[1]

    def columns(self, which: slice | np.ndarray) -> np.ndarray:
        """Tracks (F, 2, n) of some points as a new float64 array, zero where not seen."""
        part = np.moveaxis(self.points[:, which], 2, 1).astype(np.float64, order="C")
        part -= self.offset[:, :, None]
        part /= self.unit
        if self.visible is not None:
            part *= 1.0  # NaN may stand where nothing was seen
            np.copyto(part, 0.0, where=~self.visible[:, None, which])
        return part

    def seen(self, which: slice | np.ndarray) -> np.ndarray:
        """(F, n) bool of some points."""
        if self.visible is None:
            size = len(which) if isinstance(which, np.ndarray) else len(range(*which.indices(self.count)))
            return np.ones((self.frames, size), dtype=bool)
        return np.array(self.visible[:, which])

    def chunks(self, members: np.ndarray) -> Iterator[np.ndarray]:
        """The given points in chunks small enough for float64 working copies."""
        step = max(1, _CHUNK // self.frames)
        for start in range(0, len(members), step):
            yield members[start : start + step]


def masked_median(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Lower median along the last axis of the values where the mask is true; 0 where it never is.

    Both have the same shape. Unlike ``numpy.nanmedian`` it is quick, and silent where there is nothing.
    """
    counts = np.count_nonzero(mask, axis=-1)
    ordered = np.sort(np.where(mask, values, np.inf), axis=-1)
    middle = np.maximum((counts - 1) // 2, 0)
    found = np.take_along_axis(ordered, middle[..., None], axis=-1)[..., 0]
    return np.where(counts > 0, found, 0.0)


def view_of(tracks: Tracks, rng: np.random.Generator) -> View:
    """The view of tracks: medians and unit from a sample of points, so that outliers and their number do not matter."""
    points, visible = tracks.points, None if tracks.complete else tracks.visible
    frames, count = points.shape[:2]
    chosen = np.arange(count)
    if count > _SAMPLE:
        chosen = np.sort(rng.choice(count, size=_SAMPLE, replace=False))
        if visible is not None and visible[:, chosen].sum(axis=1).min() < LEAST_IN_FRAME:
            chosen = np.arange(count)  # some frame shows few points: the sample would miss them
    part = np.array(points[:, chosen], dtype=np.float64)
    if visible is None:
        offset = np.median(part, axis=1)
        gap = np.abs(part - offset[:, None])
        middle = float(np.median(gap))
    else:
        mask = np.broadcast_to(visible[:, None, chosen], (frames, 2, len(chosen)))
        offset = masked_median(part.transpose(0, 2, 1), mask)
        gap = np.where(mask, np.abs(part.transpose(0, 2, 1) - offset[:, :, None]), np.nan)
        middle = float(np.nanmedian(gap))
        gap = gap[mask]
    gap = np.minimum(gap, 6.0 * middle if middle > 0 else np.inf)
    largest = float(gap.max()) or 1.0  # squares of the coordinates themselves may be beyond floating-point numbers
    unit = largest * float(np.sqrt(np.mean((gap / largest) ** 2)))
    unit = unit if unit > 0 else 1.0
    if not in_range(unit):
        raise out_of_range(unit)
    return View(points, visible, offset, unit)


def require_tied(visible: np.ndarray) -> None:
    """Refuse visibility (F, P) that leaves a frame empty or falls into parts that share too few points.

    Two frames are tied when at least four points are seen in both; all frames must hang together through such ties.
    """
    counts = visible.sum(axis=1)
    least = int(np.argmin(counts))
    if counts[least] < LEAST_IN_FRAME:
        raise InputError(
            f"tracks: at least {LEAST_IN_FRAME} points must be seen in every frame, received {int(counts[least])} "
            f"in frame {least}"
        )
    frames = len(visible)
    shared = np.zeros((frames, frames), dtype=np.float32)
    for start in range(0, visible.shape[1], 8192):
        part = visible[:, start : start + 8192].astype(np.float32)
        shared += part @ part.T
    tied = shared >= LEAST_IN_FRAME
    reached = np.zeros(frames, dtype=bool)
    reached[0] = True
    while True:
        more = tied[reached].any(axis=0) | reached
        if more.sum() == reached.sum():
            break
        reached = more
    if not reached.all():
        first = int(np.flatnonzero(~reached)[0])
        raise InputError(
            f"tracks: all frames must be tied together by at least {LEAST_IN_FRAME} points seen in both of two "
            f"frames, received {int(reached.sum())} frames that share fewer with the other "
            f"{int((~reached).sum())} (the first of these is frame {first})"
        )
