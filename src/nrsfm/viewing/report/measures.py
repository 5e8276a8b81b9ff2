"""Numbers of a report over frames: how well the tracks fit, how large the errors are, how the shape deforms.

All go frame by frame: nothing of the size of the input is made.

Source: ours; the errors are those of :mod:`nrsfm.metrics`.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np

from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.panels import round_up
from nrsfm.viewing.viewer.colours import STEPS, UNKNOWN, Scale

BELIEVED = 0.5  # measurements of less confidence do not count
_OTHER_UNIT = 0.7  # a scale per frame that takes away this share of the error: truth in another unit
_CHUNK = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """Distances of the tracks from what the cameras see, in the tracks' unit, over frames.

    ``rms`` (F,), ``median`` (F,) and ``most`` (F,), the 95th percentile; the last two are ``None`` where the camera is
    a perspective one. NaN in frames without measurements. ``overall`` is the root mean square of all ``entries``.
    """

    rms: np.ndarray
    median: np.ndarray | None
    most: np.ndarray | None
    overall: float
    entries: int
    left_out: int
    perspective: bool


def fit_over_frames(result: Reconstruction, tracks: Any) -> Fit:
    """Return how the reconstruction fits the ``Tracks`` that it was made from; outliers do not count."""
    report = result.diagnostics.get("perspective")
    matrix = report.get("intrinsics") if isinstance(report, dict) and report.get("undone") else None
    frames, kept = result.n_frames, result.reconstructed
    rms, median, most = (np.full(frames, np.nan) for _ in range(3))
    total, entries, left_out = 0.0, 0, 0
    for f in range(frames):
        seen = np.isfinite(tracks.points[f]).all(axis=1)
        if tracks.visible is not None:
            seen &= np.asarray(tracks.visible[f])
        good = seen & kept
        if result.confidence is not None:
            good &= result.confidence[f] >= BELIEVED
        left_out += int(np.count_nonzero(seen & ~good))
        count = int(np.count_nonzero(good))
        if not count:
            continue
        points = np.asarray(tracks.points[f], dtype=np.float64)
        if matrix is None:
            shape = np.asarray(result.shapes[f], dtype=np.float64)[good]
            shown = result.scales[f] * (shape @ result.rotations[f, :2].T) + result.translations[f]
            squares = np.sum((shown - points[good]) ** 2, axis=1)
            rms[f] = np.sqrt(squares.mean())
            median[f], most[f] = np.sqrt(np.percentile(squares, [50, 95]))
        else:
            rms[f] = _through_perspective(result, f, np.where(good[:, None], points, np.nan)[kept], kept, matrix)
        total += count * rms[f] ** 2
        entries += count
    return Fit(
        rms,
        None if matrix is not None else median,
        None if matrix is not None else most,
        float(np.sqrt(total / entries)) if entries else float("nan"),
        entries,
        left_out,
        matrix is not None,
    )


def _through_perspective(
    result: Reconstruction, frame: int, points: np.ndarray, kept: np.ndarray, matrix: Any
) -> float:
    from nrsfm.perspective.geometry import perspective_error

    one = SimpleNamespace(
        shapes=result.shapes[frame : frame + 1, kept],
        rotations=result.rotations[frame : frame + 1],
        scales=result.scales[frame : frame + 1],
    )
    return float(perspective_error(points[None], one, np.asarray(matrix))[0])


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """Relative error e3D of each frame (F,), and the alignment it is measured under."""

    values: np.ndarray
    align: str


def errors_over_frames(result: Reconstruction, truth: np.ndarray, valid: np.ndarray | None) -> Errors:
    """Return the error of each frame against true shapes (F, P, 3): aligned, and scaled where units differ."""
    from nrsfm.metrics import frame_errors

    found = {align: frame_errors(result, truth, align, valid=valid) for align in ("per-frame", "similarity")}
    scaled = float(np.nanmean(found["similarity"])) < _OTHER_UNIT * float(np.nanmean(found["per-frame"]))
    align = "similarity" if scaled else "per-frame"
    return Errors(found[align], align)


def deviation_over_frames(result: Reconstruction) -> np.ndarray | None:
    """Return the 5th, 50th and 95th percentile (3, F) of the depths' standard deviation, or ``None``."""
    if result.depth_deviation is None:
        return None
    kept = result.reconstructed
    return np.stack([np.percentile(row[kept], [5, 50, 95]) for row in result.depth_deviation], axis=1)


def mean_of_points(scale: Scale, kept: np.ndarray, points: int) -> tuple[np.ndarray, float]:
    """Return the mean over frames (P,) of the numbers of a scale, NaN where there are none, and where to end colours.

    The largest numbers are cut where the scale ends. ``kept`` (N,) are the points that the scale is of.
    """
    known = scale.steps != UNKNOWN
    count = known.sum(axis=0)
    total = np.where(known, scale.steps, 0).sum(axis=0, dtype=np.float64)
    means = np.full(points, np.nan)
    means[kept[count > 0]] = scale.low + (scale.high - scale.low) / STEPS * total[count > 0] / count[count > 0]
    some = means[np.isfinite(means)]
    return means, round_up(float(np.percentile(some, 98.0))) if some.size else 1.0


@dataclasses.dataclass(frozen=True)
class Deformation:
    """How much the shape deforms: root mean square over the object's root mean square radius, and in how many ways.

    ``modes`` are the numbers of shape directions that hold 90, 99 and 99.9 % of the deformation's mean square.
    """

    relative: float
    size: float
    modes: tuple[int, int, int]


def deformation(result: Reconstruction) -> Deformation:
    """Return how the shapes deform about their mean, each frame centred."""
    frames, kept = result.n_frames, np.flatnonzero(result.reconstructed)
    gram, mean_square = np.zeros((frames, frames)), 0.0
    centres = np.stack([shape[kept].mean(axis=0, dtype=np.float64) for shape in result.shapes])
    step = max(1, _CHUNK // (3 * frames))
    for start in range(0, len(kept), step):
        block = np.asarray(result.shapes[:, kept[start : start + step]], dtype=np.float64) - centres[:, None]
        flat = block.reshape(frames, -1)
        mean_square += float(np.sum(flat * flat))
        flat -= flat.mean(axis=0)
        gram += flat @ flat.T
    values = np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0)
    total = float(values.sum())
    size = float(np.sqrt(mean_square / (frames * len(kept))))
    if total <= 1e-12 * mean_square:
        return Deformation(0.0, size, (0, 0, 0))
    shares = np.cumsum(values) / total
    modes = [int(np.argmax(shares >= share - 1e-12)) + 1 for share in (0.9, 0.99, 0.999)]
    return Deformation(float(np.sqrt(total / mean_square)), size, (modes[0], modes[1], modes[2]))
