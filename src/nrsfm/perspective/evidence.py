"""How much perspective is in the tracks, and which of the two mirror images it proves.

The likelihood of :mod:`nrsfm.perspective.model` is computed over the strength ε of perspective (rms of the image
coordinates over the focal length) for several ranks, everything else refitted at each ε, on a sample of frames and
points. Its mean over ranks, per coordinate, peaks at the true ε; the sign belongs to the mirror image that the model
was started with. Comparing whole refitted models is what tells the mirror: the residual of an affine fit does not,
because flexible shapes take up what perspective leaves.

Two stages, so that tracks without perspective cost little: three strengths on a small sample, whose parabola must
promise a gain; then a grid on a larger one, refined by the parabola about its best. With a known camera matrix only ε
and −ε are compared. The principal point may be unknown: to first order a wrong one only turns the cameras.

Where the gain stays below ``LEAST_GAIN`` nothing is decided. Few points that drift alike can look like perspective:
outliers are to be removed before. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nrsfm.numerics.threads import single_thread
from nrsfm.perspective import model as low_rank
from nrsfm.perspective.geometry import centred_points, checked_intrinsics, intrinsics_of
from nrsfm.perspective.model import LowRankModel

LEAST_GAIN = 0.004
"""Log-likelihood per coordinate over its rival (affine, or the other mirror). Orthographic sequences reach .001."""

LEAST_STRENGTH = 0.012
LARGEST_STRENGTH = 0.3
FIRST_STRENGTH = 0.05
LEAST_FRAMES = 8
LEAST_POINTS = 12
RANKS = (1, 2, 3, 5)

_SMALL, _LARGE = (50, 50), (100, 100)  # frames and points of the two samples
_AFFINE, _STEPS = 10, 10  # iterations at ε = 0, then at each ε
_GRID = (0.05, 0.1, 0.15, 0.2, 0.3)


@dataclass(frozen=True)
class PerspectiveFinding:
    """What the tracks say of perspective.

    Attributes
    ----------
    strength
        ε ≥ 0; 0 where none is found.
    intrinsics
        The camera matrix (3, 3), given or estimated, or ``None``.
    flip
        Whether the mirror image of the judged reconstruction is the right one.
    decided
        Whether the tracks tell.
    by
        ``"intrinsics"`` (the given camera matrix decided), ``"perspective"`` (estimated), or ``"convention"`` (no
        evidence: ``flip`` is false).
    gain
        Mean log-likelihood per coordinate above the rival: the affine model, or the other mirror image where the
        camera matrix is given.
    gains
        Every compared strength (negative: of the mirror image) with its gain over the first one compared.
    reason
        Why nothing was decided, in words; empty otherwise.
    """

    strength: float
    intrinsics: np.ndarray | None
    flip: bool
    decided: bool
    by: str
    gain: float
    gains: dict[str, float] = field(default_factory=dict)
    reason: str = ""


@dataclass(frozen=True)
class _Sample:
    """tracks (F′, 2, N) in units of their rms about the principal point, and the reconstruction in that unit."""

    tracks: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    shapes: np.ndarray
    unit: float
    centre: np.ndarray


def sample(
    points: np.ndarray, result: Any, intrinsics: np.ndarray | None, visible: np.ndarray | None, size: tuple[int, int]
) -> _Sample:
    """Evenly spread frames and points; of the points, those seen in the most frames."""
    frames, count = points.shape[:2]
    rows = np.unique(np.linspace(0, frames - 1, min(frames, size[0])).round().astype(np.int64))
    candidates = np.arange(count)
    if visible is not None:
        seen = np.count_nonzero(visible, axis=0)
        candidates = np.flatnonzero(seen >= np.sort(seen)[::-1][min(count, size[1]) - 1])
    columns = candidates[np.unique(np.linspace(0, len(candidates) - 1, min(count, size[1])).round().astype(np.int64))]
    chosen = points[rows[:, None], columns].astype(np.float64)
    if intrinsics is None:
        centre = np.asarray(chosen.mean(axis=(0, 1)))
        chosen -= centre
    else:
        centre = intrinsics[:2, 2]
        chosen = centred_points(chosen, intrinsics)
    unit = float(np.sqrt(np.mean((chosen - chosen.mean(axis=1, keepdims=True)) ** 2))) or 1.0
    scales = np.asarray(result.scales, dtype=np.float64)[rows]
    shapes = np.asarray(result.shapes)[rows[:, None], columns].astype(np.float64) * (float(scales.mean()) / unit)
    return _Sample(
        np.ascontiguousarray((chosen / unit).transpose(0, 2, 1)),
        np.asarray(result.rotations, dtype=np.float64)[rows],
        scales / scales.mean(),
        np.ascontiguousarray(shapes.transpose(0, 2, 1)),
        unit,
        centre,
    )


def _affine_models(part: _Sample) -> list[LowRankModel]:
    frames = len(part.tracks)
    ranks = [rank for rank in RANKS if rank <= 3 or frames >= 20]
    starts = [low_rank.start(part.tracks, part.rotations, part.scales, part.shapes, rank) for rank in ranks]
    return [low_rank.fit(model, part.tracks, 0.0, _AFFINE) for model in starts]


def _likelihoods(part: _Sample, models: list[LowRankModel], strength: float) -> np.ndarray:
    """Log-likelihood per coordinate of every rank, refitted at one strength."""
    return np.array([low_rank.fit(model, part.tracks, strength, _STEPS).likelihood for model in models])


def _peak(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Place and height of the parabola through three points, kept between the outer ones."""
    square, slope, level = np.polyfit(x - x[1], y, 2)
    if square >= 0:
        best = int(np.argmax(y))
        return float(x[best]), float(y[best])
    place = float(np.clip(-slope / (2.0 * square), x[0] - x[1], x[2] - x[1]))
    return place + float(x[1]), float(level + slope * place + square * place**2)


def find_perspective(
    points: np.ndarray, result: Any, intrinsics: np.ndarray | None = None, visible: np.ndarray | None = None
) -> PerspectiveFinding:
    """Strength of perspective and the right mirror image, by likelihood.

    Parameters
    ----------
    points
        (F, P, 2), complete (missing entries filled in), image unit.
    result
        An affine reconstruction of them: ``shapes`` (F, P, 3), ``rotations`` (F, 3, 3), ``scales`` (F,).
    intrinsics
        (3, 3) where known.
    visible
        (F, P) bool: which points were seen; those seen most are judged.
    """
    matrix = None if intrinsics is None else checked_intrinsics(intrinsics)
    if points.shape[0] < LEAST_FRAMES or points.shape[1] < LEAST_POINTS:
        reason = f"fewer than {LEAST_FRAMES} frames or {LEAST_POINTS} points"
        return PerspectiveFinding(0.0, matrix, False, False, "convention", 0.0, reason=reason)
    # Small systems: a BLAS with several threads would be slower than one.
    with single_thread(), np.errstate(all="ignore"):
        return _calibrate(points, result, visible) if matrix is None else _judge(points, result, matrix, visible)


def _judge(points: np.ndarray, result: Any, intrinsics: np.ndarray, visible: np.ndarray | None) -> PerspectiveFinding:
    """The mirror image, where ε is known."""
    part = sample(points, result, intrinsics, visible, _LARGE)
    strength = part.unit / float(intrinsics[0, 0])
    models = _affine_models(part)
    here, there = _likelihoods(part, models, strength), _likelihoods(part, models, -strength)
    gain = float(np.mean(here - there))
    gains = {f"{strength:.4f}": 0.0, f"{-strength:.4f}": -gain}
    if not abs(gain) >= LEAST_GAIN:  # also where it is not a number
        reason = "both mirror images explain the tracks alike"
        return PerspectiveFinding(strength, intrinsics, False, False, "convention", 0.0, gains, reason)
    return PerspectiveFinding(strength, intrinsics, gain < 0, True, "intrinsics", abs(gain), gains)


def _calibrate(points: np.ndarray, result: Any, visible: np.ndarray | None) -> PerspectiveFinding:
    """Strength and mirror image together."""
    gains: dict[float, np.ndarray] = {}
    for size in (_SMALL, _LARGE):
        part = sample(points, result, None, visible, size)
        models = _affine_models(part)
        level = _likelihoods(part, models, 0.0)
        gains = {0.0: np.zeros(len(models))}
        for strength in (-FIRST_STRENGTH, FIRST_STRENGTH):
            gains[strength] = _likelihoods(part, models, strength) - level
        place, gain = _best(gains)
        if not gain >= LEAST_GAIN / 2:
            return _nothing(gains, "the affine model explains the tracks as well")
    side = 1.0 if place > 0 else -1.0
    for strength in _GRID:
        if side * strength not in gains:
            gains[side * strength] = _likelihoods(part, models, side * strength) - level
        if strength - abs(_best(gains)[0]) > 0.04:
            break  # past the peak
    place, gain = _best(gains)
    if not (gain >= LEAST_GAIN and abs(place) >= LEAST_STRENGTH):
        return _nothing(gains, "the affine model explains the tracks as well")
    nearest = min((s for s in gains if s * place > 0), key=lambda s: abs(s - place))
    if -nearest not in gains:
        gains[-nearest] = _likelihoods(part, models, -nearest) - level
    advantage = gains[nearest] - gains[-nearest]
    if not np.mean(advantage) >= LEAST_GAIN:  # as for flat shapes, for which the affine models settle badly
        return _nothing(gains, "both mirror images explain the tracks alike")
    if 2 * np.count_nonzero(advantage > 0) <= len(models):
        return _nothing(gains, "the ranks do not agree")
    matrix = intrinsics_of(part.unit / abs(place), part.centre)
    return PerspectiveFinding(abs(place), matrix, place < 0, True, "perspective", gain, _plain(gains))


def _best(gains: dict[float, np.ndarray]) -> tuple[float, float]:
    """Strength and gain at the peak of the mean over ranks."""
    x = np.array(sorted(gains))
    y = np.array([float(np.mean(gains[s])) for s in x])
    y = np.where(np.isfinite(y), y, -1e3)
    middle = int(np.clip(np.argmax(y), 1, len(x) - 2))
    return _peak(x[middle - 1 : middle + 2], y[middle - 1 : middle + 2])


def _plain(gains: dict[float, np.ndarray]) -> dict[str, float]:
    return {f"{s:g}": float(np.mean(gains[s])) for s in sorted(gains)}


def _nothing(gains: dict[float, np.ndarray], reason: str) -> PerspectiveFinding:
    return PerspectiveFinding(0.0, None, False, False, "convention", 0.0, _plain(gains), reason)


def mirror_evidence(finding: PerspectiveFinding) -> dict[str, Any]:
    """The finding as the diagnostics have it: ``decided``, ``by``, ``flip``, ``strength``."""
    return {
        "decided": finding.decided,
        "by": finding.by,
        "flip": finding.flip,
        "strength": finding.gain,
    }
