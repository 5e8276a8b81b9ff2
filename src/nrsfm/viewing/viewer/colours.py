"""What the points may be coloured by: fixed colours, or a number per point and frame on a scale.

A scale has 255 steps; step 255 itself stands for "not known", which the page draws grey. Depth is not sent at all: the
page has the points and the cameras. Errors are distances from the truth after the alignment of each frame (Procrustes,
reflection allowed; with a scale where that takes away much of the error, as truths in another unit need it):

    min over Q orthogonal (and a > 0) of ‖a A Q − B‖,  A, B the centred points of a frame that both sides know.

Source: Schönemann, "A generalized solution of the orthogonal Procrustes problem", Psychometrika 1966.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.panels import round_up
from nrsfm.viewing.style import ERROR_MAP, OUTLIER, SEEN, rgb

UNKNOWN = 255
STEPS = 254
_OTHER_UNIT = 0.7  # a scale per frame that takes away this share of the error: truth in another unit
_SAMPLE = 2_000  # points per frame that are enough to find where a scale ends
_TOP = 98.0  # percentile at which scales end: few points must not take all the colours


@dataclasses.dataclass(frozen=True, eq=False)
class Scale:
    """Numbers of all points in all frames as steps of a scale.

    ``steps`` (F, N) uint8, ``UNKNOWN`` where there is no number; ``low`` and ``high`` are the values of step 0 and
    ``STEPS``. ``summary`` says, in words, what the numbers are of; ``per_frame`` (F,) is one number for each frame, or
    ``None``.
    """

    steps: np.ndarray
    low: float
    high: float
    summary: str = ""
    per_frame: np.ndarray | None = None

    @property
    def unknown(self) -> bool:
        """Whether some number is not known."""
        return any(bool((row == UNKNOWN).any()) for row in self.steps)


def to_steps(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Steps, uint8, of values of any shape."""
    known = np.isfinite(values)
    share = (np.where(known, values, low) - low) / ((high - low) or 1.0)
    return np.where(known, np.rint(np.clip(share, 0.0, 1.0) * STEPS), UNKNOWN).astype(np.uint8)


def confidence_scale(result: Reconstruction, kept: np.ndarray) -> Scale | None:
    """Confidence of the points ``kept`` (N,), from 0 to 1."""
    if result.confidence is None:
        return None
    steps = np.stack([to_steps(row[kept], 0.0, 1.0) for row in result.confidence])
    return Scale(steps, 0.0, 1.0, "1: the measurement was used fully; 0: an outlier, or not seen")


def deviation_scale(result: Reconstruction, kept: np.ndarray) -> Scale | None:
    """Standard deviation of the depth of the points ``kept`` (N,), in the unit of the shapes."""
    if result.depth_deviation is None:
        return None
    high = _end(np.stack([row[_some(kept)] for row in result.depth_deviation]))
    steps = np.stack([to_steps(row[kept], 0.0, high) for row in result.depth_deviation])
    return Scale(steps, 0.0, high, "standard deviation along the camera's axis")


def error_scale(result: Reconstruction, truth: Any, valid: Any, kept: np.ndarray) -> Scale:
    """Distance from the truth, shapes (F, P, 3) with ``valid`` (F, P) bool or ``None``, of the points ``kept`` (N,).

    Raises ``InputError`` where the truth is of another size.
    """
    true = np.asarray(truth)
    if true.shape != result.shapes.shape:
        raise InputError(
            f"truth: {result.n_frames} frames of {result.n_points} points are needed, as the reconstruction has, "
            f"received shapes {true.shape}"
        )
    errors = {scaled: _errors(result, true, valid, kept, scaled) for scaled in (False, True)}
    mean = {scaled: _mean(relative) for scaled, (_, relative) in errors.items()}
    scaled = bool(mean[True] < _OTHER_UNIT * mean[False])
    gaps, relative = errors[scaled]
    known = gaps[np.isfinite(gaps)]
    high = _end(gaps[:, :: max(1, gaps.shape[1] // _SAMPLE)])
    words = "aligned and scaled in each frame" if scaled else "aligned in each frame"
    if known.size:
        words += f"; median {np.median(known):.3g}, e3D {mean[scaled]:.4f}"
    return Scale(np.stack([to_steps(row, 0.0, high) for row in gaps]), 0.0, high, words, relative)


def _errors(
    result: Reconstruction, true: np.ndarray, valid: Any, kept: np.ndarray, scaled: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (F, N) float32 and relative errors (F,); NaN where nothing is known."""
    gaps = np.full((result.n_frames, len(kept)), np.nan, dtype=np.float32)
    relative = np.full(result.n_frames, np.nan)
    for f in range(result.n_frames):
        a = np.asarray(result.shapes[f], dtype=np.float64)[kept]
        b = np.asarray(true[f], dtype=np.float64)[kept]
        known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
        if valid is not None:
            known &= np.asarray(valid[f])[kept]
        if not known.any():
            continue
        a, b = a[known] - a[known].mean(axis=0), b[known] - b[known].mean(axis=0)
        u, _, vt = np.linalg.svd(a.T @ b)
        a = a @ (u @ vt)
        size = float(np.sum(a * a))
        if scaled and size > 0:
            a = a * (float(np.sum(a * b)) / size)
        gap = np.linalg.norm(a - b, axis=1)
        gaps[f, known] = gap
        norm = float(np.linalg.norm(b))
        relative[f] = float(np.linalg.norm(gap)) / norm if norm > 0 else np.nan
    return gaps, relative


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _some(kept: np.ndarray) -> np.ndarray:
    return kept[:: max(1, len(kept) // _SAMPLE)]


def _end(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return round_up(float(np.percentile(known, _TOP))) if known.size else 1.0


def colour_maps() -> dict[str, list[int]]:
    """255 × 3 numbers from 0 to 255 for each map that the page uses."""
    import matplotlib as mpl

    share = np.linspace(0.0, 1.0, STEPS + 1)
    middle = np.array([0.93, 0.88, 0.80])
    half = np.minimum(share * 2.0, 1.0)[:, None], np.maximum(share * 2.0 - 1.0, 0.0)[:, None]
    trust = rgb(OUTLIER) * (1 - half[0]) + middle * (half[0] - half[1]) + 0.82 * rgb(SEEN) * half[1]
    maps = {
        "error": np.asarray(mpl.colormaps[ERROR_MAP](share))[:, :3],
        "depth": np.asarray(mpl.colormaps["cividis"](1.0 - 0.9 * share))[:, :3],  # what is near is bright
        "trust": trust,
    }
    return {name: np.rint(255 * np.clip(colours, 0, 1)).astype(int).ravel().tolist() for name, colours in maps.items()}
