"""Expectation-maximisation of the Procrustean normal distribution, from any first shapes, while the noise falls.

The loop of :mod:`nrsfm.methods.em_pnd`, which says what is maximised: posterior of the shapes, then C and σ², then M,
A_i and c_i by Procrustes analysis of the posterior means. The likelihood at the end compares fits that began elsewhere
and ended at the same σ².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.manifolds.procrustes import onto_tangent_space, procrustes_mean
from nrsfm.methods.base import Monitor
from nrsfm.methods.procrustean_normal import ProcrusteanNormal, leading_covariance, posterior

_MEAN_ROUNDS = 3  # Procrustes rounds per iteration; the mean moves little between iterations


@dataclass(frozen=True)
class Schedule:
    """How σ² falls and when to stop. Variances are shares of the mean squared size of a shape.

    At most ``factors`` columns in B, none for variances below ``negligible`` times σ²; ``first_noise``,
    ``last_noise``, and ``cooling``, the least factor by which σ² falls in an iteration; ``first_spread`` is added to
    the first covariance, isotropic. Stops when σ² has settled and the shapes move by less than ``least_change`` of
    their size, or after ``max_iterations``.
    """

    factors: int
    first_noise: float
    last_noise: float
    first_spread: float
    cooling: float = 0.9
    least_change: float = 2e-4
    max_iterations: int = 200
    negligible: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Shapes (F, 3, N) in the frames of their cameras; their alignment A (F, 3, 3); how the run ended.

    ``likelihood`` is log p(tracks) up to a constant that all fits to the same tracks share.
    """

    shapes: np.ndarray
    align: np.ndarray
    model: ProcrusteanNormal
    likelihood: float
    iterations: int
    reason: str
    history: dict[str, list[float]]


def fit(tracks: np.ndarray, cameras: np.ndarray, start: np.ndarray, schedule: Schedule, monitor: Monitor) -> Fit:
    """Fit to tracks (F, 2, N) of unit size, from shapes ``start`` (F, 3, N) in the frame of cameras (F, 3, 3).

    The cameras only place the first shapes: later on the alignment says where each frame is seen from.
    """
    frames, _, count = tracks.shape
    shapes = cameras @ start  # in the frames of the cameras, from here on
    mean, align, sizes = procrustes_mean(shapes, start.mean(axis=0), iterations=30)
    flat = onto_tangent_space(mean, ((align @ shapes) / sizes[:, None, None] - mean).reshape(frames, -1).T)
    first = flat @ flat.T / frames
    first += schedule.first_spread * onto_tangent_space(mean, np.eye(3 * count))
    factors = min(schedule.factors, 3 * count)
    covariance = leading_covariance(first, factors, schedule.negligible * schedule.first_noise)
    model = ProcrusteanNormal(mean, *covariance, schedule.first_noise)

    history: dict[str, list[float]] = {"energy": [], "noise": [], "change": []}
    damping = _Damping(frames)
    likelihood, reason, used = -np.inf, "iteration limit", schedule.max_iterations
    for iteration in range(schedule.max_iterations):
        found = posterior(model, tracks, np.swapaxes(align, 1, 2)[:, :2], sizes)
        moved = sizes[:, None, None] * (np.swapaxes(align, 1, 2) @ (model.mean + found.deviations))
        change = float(np.linalg.norm(moved - shapes) / max(float(np.linalg.norm(moved)), np.finfo(float).tiny))
        aligned, shapes = damping.between(shapes, moved), moved
        likelihood = found.likelihood
        history["energy"].append(-likelihood)
        history["noise"].append(model.noise)
        history["change"].append(change)
        noise = max(found.noise, schedule.cooling * model.noise, schedule.last_noise)
        settled = noise > 0.99 * model.noise
        if not np.isfinite(likelihood):
            reason, used = "not finite", iteration + 1
            break
        if settled and change < schedule.least_change:
            reason, used = "shapes settled", iteration + 1
            break
        basis, spread = leading_covariance(found.second_moment, factors, schedule.negligible * noise)
        mean, align, sizes = procrustes_mean(aligned, model.mean, iterations=_MEAN_ROUNDS)
        model = ProcrusteanNormal(mean, onto_tangent_space(mean, basis), spread, noise)
        monitor(_progress(noise, change, schedule))
    return Fit(shapes, align, model, likelihood, used, reason, history)


def unit_size(tracks: np.ndarray) -> float:
    """Size of a mean shape for tracks (F, 2, N), of which two of three coordinates are seen."""
    return float(np.sqrt(1.5 * np.mean(np.sum(tracks**2, axis=(1, 2))))) or 1.0


class _Damping:
    """Shortens the alignment's steps in frames that overshoot.

    The flat prior makes them Newton steps, which can swing about the answer where a frame's camera is far off. What
    they lead to is the same: only the shape that the next alignment is made with lies between old and new.
    """

    def __init__(self, frames: int) -> None:
        self.share = np.ones(frames)
        self.last: np.ndarray | float = 0.0

    def between(self, old: np.ndarray, new: np.ndarray) -> np.ndarray:
        """Shapes (F, 3, N) to align; the share of a frame is halved when its step turns back, then grows again."""
        step = new - old
        back = np.sum(step * self.last, axis=(1, 2)) < 0
        self.share = np.where(back, np.maximum(self.share / 2.0, 1.0 / 16.0), np.minimum(1.1 * self.share, 1.0))
        self.last = step
        return np.asarray(old + self.share[:, None, None] * step)


def _progress(noise: float, change: float, schedule: Schedule) -> float:
    """Share of the work done: how far the noise has fallen, then how far the steps have."""
    span = np.log(schedule.first_noise / schedule.last_noise) if schedule.first_noise > schedule.last_noise else 0.0
    fallen = float(np.log(schedule.first_noise / noise) / span) if span > 0 and noise > 0 else 1.0
    steps = min(1.0, schedule.least_change / change) if change > 0 else 0.0
    return float(np.clip(0.8 * fallen + 0.2 * steps, 0.0, 1.0))
