"""The default method: nothing to set. Several beginnings, two likelihoods, the tracks decide. docs/auto.md derives it.

Beginnings, each from another view of the same tracks:

- *low rank*: the reweighted nuclear norm of Algorithms 1 and 2, without their groups;
- *closed form*: coefficients of K basis shapes as a null space (:mod:`nrsfm.methods.linear_coefficients`), K by
  likelihood;
- *smooth motion*: what moves least from frame to frame (:mod:`nrsfm.methods.smooth_motion`), if frames have an order;
- *trajectories*: most likely cameras and shapes if each point's path over time is a sample of one Gaussian
  (:mod:`nrsfm.methods.gaussian_trajectories`); for dense tracks of up to 200 frames.

From them the shapes are followed to the greatest likelihood under a Gaussian over *frames*, freed from rigid motion
(:mod:`nrsfm.methods.procrustean_fit`), and the most likely result is returned. σ² starts low enough to keep what a
beginning knows, and ends at what the compression has left of the noise. Fewer than ``FEW`` frames say nothing of a
distribution over frames: there the trajectories have the word. Shapes that scatter about no mean are not followed.

Noise that is left after the compression is first smoothed over time, where the tracks allow it
(:mod:`nrsfm.numerics.smoothing`).

At the end noisy tracks are resected: each point from its own track, in the distribution that these shapes give its
cell (:func:`nrsfm.repair.resect_by_cells`).

Everything else runs on the tracks with all cells merged, at most 2F virtual points, but for the trajectories, which
know the cells. On the compression it is exact, as its parts are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.manifolds.procrustes import procrustes_mean
from nrsfm.manifolds.rotations import whole_rotations
from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution, cut_by, solve_global
from nrsfm.methods.gaussian_trajectories import applies, refine
from nrsfm.methods.linear_coefficients import largest_basis, linear_coefficients, shapes_of_coefficients
from nrsfm.methods.procrustean_fit import Fit, Schedule, fit, unit_size
from nrsfm.methods.smooth_motion import smooth_motion
from nrsfm.numerics.smoothing import smoothed
from nrsfm.options import option

FEW = 30
"""Frames below which a Gaussian over frames is not fitted."""

REWEIGHT = 0.01
"""ε of the reweighted norm, as in Algorithms 1 and 2."""

BASES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 26, 33, 42, 54, 68, 86, 108)
"""Numbers of basis shapes K that the closed form is tried with, beside the largest that the tracks determine."""

SCREEN = 1e-3
"""Misfit of the tracks, rms, at which beginnings are compared before any is followed."""

LEAST_MISFIT = 1e-4
"""Misfit that the fit ends at where the tracks hold no noise."""

NEAR, MIDDLE, FAR = 1e-5, 1e-4, 1e-3
"""First σ², as a share of a shape's squared size: the larger, the less of its beginning a fit remembers."""

TELLING = 0.03
"""Difference in log-likelihood per frame and virtual point below which the likelihood does not tell two fits apart."""

SMOOTHNESS = (0.01, 80.0)
"""λ of the smoothest motion on exact tracks, and per unit of the noise level."""

LARGEST_SCATTER = 0.5
"""Deviation of the low-rank shapes from their aligned mean, in sizes of the mean, above which nothing is followed."""

LARGEST_MOVE = 12.0
"""Degrees by which trajectories of few frames may move a camera; where they move one farther they are not believed."""

LONG, KEY_FRAMES = 1_000, 600
"""Frames above which beginnings are compared and followed on so many key frames before the winner is on all."""

FACTORS, COOLING, NEGLIGIBLE = 60, 0.8, 0.1
"""Columns of B, fall of σ² per iteration, and the variance, in units of σ², below which a direction gets no column."""


_MAYBE_EXACT = ("trajectories", "closed form")
_UNSMOOTHED = 0.99  # share of white noise that is left above which a smoothing is none


@dataclass(frozen=True)
class AutoOptions:
    """Which parts of the default method take part, for ablations. All else comes from the tracks."""

    closed_form: bool = option(True, "Begin also from the closed-form shapes.")
    trajectories: bool = option(True, "Begin also from the Gaussian over trajectories.")
    smooth_motion: bool = option(True, "Begin also from the shapes that move least; needs frames in order.")
    smooth_tracks: bool = option(True, "Smooth noise that is left in the tracks over time; needs frames in order.")
    follow: bool = option(True, "Follow the beginnings to the most likely shapes under a Gaussian over frames.")
    by_cells: bool = option(True, "Resect noisy tracks at the end, point by point in the distribution of its cell.")


@dataclass(frozen=True)
class _Start:
    """Shapes (F, 3, N) to begin from, in the frame of the cameras given, and the first σ²."""

    name: str
    shapes: np.ndarray
    noise: float


class Auto:
    """The default."""

    name = "auto"
    title = "Automatic"
    year = 2026
    summary = "most likely shapes, from closed-form, low-rank and Gaussian-trajectory beginnings; nothing to set"
    assumes = "a camera that turns; shapes that scatter about a mean"
    cost = "2F²P once; then as em-pnd, two or three times, and F³ per step of the trajectories"
    needs = Needs()
    camera_method = "intersection"
    denoise = True
    Options = AutoOptions

    def cells(self, options: AutoOptions, points: int, frames: int) -> int:
        """One per 80 points, at least 2, at most 50."""
        return int(np.clip(round(points / 80), 2, 50))

    def solve(self, problem: Problem, options: AutoOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Begin, compare, follow, choose."""
        few, chosen = len(problem.tracks) < FEW, dict[str, Any]()
        motion = max(SMOOTHNESS[0], SMOOTHNESS[1] * problem.noise)
        if options.smooth_tracks and problem.ordered and not few:
            problem, chosen["smoothing"] = without_noise(problem)
        merged, back = problem.merged()
        merged, back = leading(merged, back)
        chosen["cut"] = cut_by(problem, merged)
        first = solve_global(merged, LowRankOptions(reweight=REWEIGHT), lambda share: monitor(0.1 * share))
        along = None
        if options.trajectories and applies(problem) is None:
            along, rows, found = refine(problem, first.shapes @ back)
            monitor(0.4)
            if few and float(found["turned"]) > LARGEST_MOVE:
                along = None
            elif few or not options.follow:
                moved = None if problem.cameras_known else rows
                chosen |= {"start": "trajectories", **found}
                history = {"energy": [float(found["cost"])]}
                return Solution(along, None, found["steps"], "converged", history, chosen, rotations=moved)
            if along is not None:
                cameras = whole_rotations(problem.rotations)
                along = np.swapaxes(cameras, 1, 2) @ (whole_rotations(rows) @ along) @ back.T
        scattered = scatter(first.shapes) > LARGEST_SCATTER  # about no mean: no Gaussian freed from rigid motion
        if not options.follow or few or scattered:
            first.shapes = first.shapes @ back
            first.chosen |= {"start": "low rank", **chosen}
            return first
        begun = {"low rank": first.shapes}
        if along is not None:
            begun["trajectories"] = along
        elif options.smooth_motion and problem.ordered:
            begun["smooth motion"] = smooth_motion(merged.tracks, merged.rotations, motion)
        solution = self._followed(merged, back, begun, options, monitor)
        solution.chosen |= chosen
        return solution

    def _followed(
        self,
        problem: Problem,
        back: np.ndarray,
        begun: dict[str, np.ndarray],
        options: AutoOptions,
        monitor: Monitor,
    ) -> Solution:
        """The most likely of the fits from all beginnings worth following."""
        unit = unit_size(problem.tracks)
        tracks, cameras = problem.tracks / unit, whole_rotations(problem.rotations)
        floor = misfit_variance(problem, max(problem.residual, LEAST_MISFIT)) / unit**2
        screen = max(misfit_variance(problem, SCREEN) / unit**2, floor)
        found = {name: shapes / unit for name, shapes in begun.items()}
        noisy = problem.residual > LEAST_MISFIT
        # A long sequence is begun, compared and followed on key frames; then the winner is followed on all of them.
        keys = key_frames(len(tracks))
        some, views = tracks[keys], cameras[keys]
        few = {name: shapes[keys] for name, shapes in found.items()}
        judged: dict[str, float] = {}
        basis = 0
        if not (noisy and "trajectories" in few):  # else these are followed, whatever the others are worth
            judged = {name: _judged(some, views, shapes, screen) for name, shapes in few.items()}
        if options.closed_form and judged:
            closed, by_basis = closed_form(some, views, screen)
            if closed is not None:
                few["closed form"] = closed
                basis = max(by_basis, key=lambda k: (by_basis[k], k))
                judged["closed form"] = by_basis[basis]
        fits: list[tuple[_Start, Fit]] = []
        starts = _worth_following(few, judged, screen, noisy=noisy)
        parts = len(starts) + (len(keys) < len(tracks))
        for number, start in enumerate(starts):
            told = _part(monitor, 0.5 + 0.5 * number / parts, 0.5 / parts)
            fits.append((start, fit(some, views, start.shapes, _schedule(start.noise, floor), told)))
        start, best = _most_likely(fits, TELLING * some.shape[0] * some.shape[2], ordered=problem.ordered)
        if len(keys) < len(tracks):
            if start.name == "closed form":
                found["closed form"] = closed_form_of(tracks, cameras, basis)
            told = _part(monitor, 1.0 - 0.5 / parts, 0.5 / parts)
            best = fit(tracks, cameras, found[start.name], _schedule(start.noise, floor), told)
        chosen: dict[str, Any] = {
            "start": start.name,
            "first_noise": start.noise,
            "last_noise": best.model.noise,
            "judged": judged,
            "likelihoods": [[s.name, s.noise, f.likelihood, f.iterations] for s, f in fits],
            "factors": best.model.basis.shape[1],
            "directions": tracks.shape[2],
        }
        if len(keys) < len(tracks):
            chosen["key_frames"] = len(keys)
        shapes = unit * (np.swapaxes(cameras, 1, 2) @ best.shapes) @ back
        return Solution(shapes, None, best.iterations, best.reason, best.history, chosen)


def _worth_following(
    found: dict[str, np.ndarray], judged: dict[str, float], screen: float, *, noisy: bool
) -> list[_Start]:
    """Which beginnings to follow, and from which σ².

    Under noise the Gaussian over trajectories is the best beginning wherever there is one, and σ² starts high enough
    to mend it. Without noise a beginning can be exact, and σ² starts where it was judged. The low-rank beginning
    alone is far from an answer: it is followed from near, from farther, and from so far that it hardly matters.
    """
    low_rank = found["low rank"]
    if noisy and "trajectories" in found:
        return [_Start("trajectories", found["trajectories"], MIDDLE)]
    better = [name for name in found if name in _MAYBE_EXACT and judged[name] > judged["low rank"]]
    if better:
        return [_Start("low rank", low_rank, NEAR), *(_Start(name, found[name], screen) for name in better)]
    starts = [_Start("low rank", low_rank, noise) for noise in (NEAR, MIDDLE, FAR)]
    if "smooth motion" in found:
        starts.append(_Start("smooth motion", found["smooth motion"], MIDDLE))
    return starts


def _most_likely(fits: list[tuple[_Start, Fit]], margin: float, *, ordered: bool) -> tuple[_Start, Fit]:
    """The fit of greatest likelihood; of those within the margin of it, the one that is steadiest over time.

    Beginnings that may be exact decide by likelihood alone. Without an order of frames a fit that forgot its beginning
    must win by the margin.
    """
    if any(start.name in _MAYBE_EXACT for start, _ in fits):
        return max(fits, key=lambda pair: pair[1].likelihood)
    if not ordered:
        return max(fits, key=lambda pair: pair[1].likelihood - (margin if pair[0].noise >= FAR else 0.0))
    least = max(fit.likelihood for _, fit in fits) - margin
    return min((pair for pair in fits if pair[1].likelihood >= least), key=lambda pair: unsteadiness(pair[1]))


def unsteadiness(found: Fit) -> float:
    """Squared change of the aligned shapes from frame to frame, in units of their squared deviation from the mean."""
    aligned = found.align @ found.shapes
    aligned = aligned / np.linalg.norm(aligned, axis=(1, 2), keepdims=True)
    spread = float(np.sum((aligned - aligned.mean(axis=0)) ** 2))
    return float(np.sum(np.diff(aligned, axis=0) ** 2)) / max(spread, np.finfo(float).tiny)


def scatter(shapes: np.ndarray) -> float:
    """Root mean square size of the deviation of aligned shapes (F, 3, N) from their mean of size 1."""
    mean, align, sizes = procrustes_mean(shapes, shapes.mean(axis=0), iterations=30)
    return float(np.sqrt(np.mean(np.sum(((align @ shapes) / sizes[:, None, None] - mean) ** 2, axis=(1, 2)))))


def without_noise(problem: Problem) -> tuple[Problem, dict[str, float] | None]:
    """The problem with its tracks smoothed over time, and how; as it is where more than noise would go.

    Cross-validation alone smooths short or jerky sequences: what is removed may not exceed what is known to be noise.
    And what neighbours in time predict better than the noise level allows has less noise than was thought.
    """
    if problem.residual <= 0.0:
        return problem, None
    frames, _, count = problem.tracks.shape
    curves = smoothed(problem.tracks.reshape(frames, 2 * count))
    per_point = float(np.sqrt(count / problem.points))  # from virtual coordinates to real ones
    removed, predicted = curves.removed * per_point, curves.predicted * per_point
    share = min(1.0, predicted / problem.residual)
    if removed > problem.residual or curves.left > _UNSMOOTHED:
        return replace(problem, noise=problem.noise * share, residual=problem.residual * share), None
    how = {"order": curves.order, "weight": curves.weight, "removed": removed, "left": curves.left}
    tracks, share = curves.values.reshape(problem.tracks.shape), share * curves.left
    return replace(problem, tracks=tracks, noise=problem.noise * share, residual=problem.residual * share), how


def misfit_variance(problem: Problem, level: float) -> float:
    """Variance per coordinate of N virtual points that is a root mean square ``level`` per real coordinate."""
    return level**2 * problem.points / problem.tracks.shape[2]


def leading(problem: Problem, back: np.ndarray) -> tuple[Problem, np.ndarray]:
    """The merged problem without the trailing directions of the tracks that hold next to nothing."""
    frames, _, count = problem.tracks.shape
    size = np.sum(problem.tracks.reshape(2 * frames, count) ** 2, axis=0)  # columns are descending principal directions
    tail = np.cumsum(size[::-1])[::-1]
    level = max(0.1 * problem.residual, 0.1 * LEAST_MISFIT)
    kept = min(count, max(3, int(np.count_nonzero(tail > level**2 * 2 * frames * problem.points))))
    return replace(problem, tracks=np.ascontiguousarray(problem.tracks[:, :, :kept])), back[:kept]


def closed_form(tracks: np.ndarray, cameras: np.ndarray, noise: float) -> tuple[np.ndarray | None, dict[int, float]]:
    """The closed-form shapes whose likelihood is greatest over numbers of basis shapes K, and all likelihoods by K."""
    frames, _, count = tracks.shape
    best, judged = None, {}
    most = largest_basis(frames, int(np.linalg.matrix_rank(tracks.reshape(2 * frames, count), tol=1e-9)))
    for basis in sorted({k for k in BASES if k <= most} | {most}):
        if basis < 2:
            continue
        shapes = closed_form_of(tracks, cameras, basis)
        judged[basis] = likelihood = _judged(tracks, cameras, shapes, noise)
        if likelihood >= max(judged.values()):
            best = shapes
    return best, judged


def closed_form_of(tracks: np.ndarray, cameras: np.ndarray, basis: int) -> np.ndarray:
    """The closed-form shapes (F, 3, N) of ``basis`` basis shapes."""
    rows = cameras[:, :2]
    return shapes_of_coefficients(linear_coefficients(tracks, rows, basis)[0], tracks, rows)


def key_frames(frames: int) -> np.ndarray:
    """All frames, or ``KEY_FRAMES`` of them, evenly spread, where there are more than ``LONG``."""
    if frames <= LONG:
        return np.arange(frames)
    return np.linspace(0, frames - 1, KEY_FRAMES).round().astype(np.int64)


def _schedule(noise: float, floor: float) -> Schedule:
    """From the first σ² of a beginning down to that of the tracks."""
    noise = max(noise, floor)
    return Schedule(FACTORS, noise, floor, noise / 10, COOLING, negligible=NEGLIGIBLE)


def _part(monitor: Monitor, start: float, share: float) -> Monitor:
    return lambda done: monitor(start + share * done)


def _judged(tracks: np.ndarray, cameras: np.ndarray, shapes: np.ndarray, noise: float) -> float:
    """Likelihood of the distribution that shapes have, after one step from them."""
    schedule = Schedule(FACTORS, noise, noise, noise / 10, max_iterations=2, least_change=0.0, negligible=NEGLIGIBLE)
    return fit(tracks, cameras, shapes, schedule, lambda _: None).likelihood
