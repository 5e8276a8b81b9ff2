"""The default method: nothing to set. Several beginnings, two likelihoods, the tracks decide. docs/auto.md derives it.

Beginnings, each from another view of the same tracks:

- *low rank*: the reweighted nuclear norm of Algorithms 1 and 2, without their groups;
- *closed form*: coefficients of K basis shapes as a null space (:mod:`nrsfm.methods.linear_coefficients`), K by
  likelihood;
- *trajectories*: most likely cameras and shapes if each point's path over time is a sample of one Gaussian
  (:mod:`nrsfm.methods.gaussian_trajectories`); for dense tracks of up to 200 frames.

From them the shapes are followed to the greatest likelihood under a Gaussian over *frames*, freed from rigid motion
(:mod:`nrsfm.methods.procrustean_fit`), and the most likely result is returned. σ² starts low enough to keep what a
beginning knows, and ends at what the compression has left of the noise. Fewer than ``FEW`` frames say nothing of a
distribution over frames: there the trajectories have the word. Shapes that scatter about no mean are not followed.

Everything runs on the tracks with all cells merged, at most 2F virtual points, but for the trajectories, which know
the cells. On the compression it is exact, as its parts are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.manifolds.procrustes import procrustes_mean
from nrsfm.manifolds.rotations import whole_rotations
from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution, solve_global
from nrsfm.methods.gaussian_trajectories import applies, refine
from nrsfm.methods.linear_coefficients import largest_basis, linear_coefficients, shapes_of_coefficients
from nrsfm.methods.procrustean_fit import Fit, Schedule, fit, unit_size
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

FAR_GAIN = 0.03
"""Gain in log-likelihood per frame and virtual point that a fit needs which forgot its beginning."""

LARGEST_SCATTER = 0.5
"""Deviation of the low-rank shapes from their aligned mean, in sizes of the mean, above which nothing is followed."""

LARGEST_MOVE = 12.0
"""Degrees by which trajectories of few frames may move a camera; where they move one farther they are not believed."""

FACTORS, COOLING, NEGLIGIBLE = 60, 0.8, 0.1
"""Columns of B, fall of σ² per iteration, and the variance, in units of σ², below which a direction gets no column."""


@dataclass(frozen=True)
class AutoOptions:
    """Which parts of the default method take part, for ablations. All else comes from the tracks."""

    closed_form: bool = option(True, "Begin also from the closed-form shapes.")
    trajectories: bool = option(True, "Begin also from the Gaussian over trajectories.")
    follow: bool = option(True, "Follow the beginnings to the most likely shapes under a Gaussian over frames.")


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
        merged, back = problem.merged()
        merged, back = leading(merged, back)
        first = solve_global(merged, LowRankOptions(reweight=REWEIGHT), lambda share: monitor(0.1 * share))
        along, few = None, len(problem.tracks) < FEW
        if options.trajectories and applies(problem) is None:
            along, rows, found = refine(problem, first.shapes @ back, rng)
            monitor(0.4)
            if few and float(found["turned"]) > LARGEST_MOVE:
                along = None
            elif few or not options.follow:
                moved = None if problem.cameras_known else rows
                chosen = {"start": "trajectories", **found}
                history = {"energy": [float(found["cost"])]}
                return Solution(along, None, found["steps"], "converged", history, chosen, rotations=moved)
            if along is not None:
                cameras = whole_rotations(problem.rotations)
                along = np.swapaxes(cameras, 1, 2) @ (whole_rotations(rows) @ along) @ back.T
        scattered = scatter(first.shapes) > LARGEST_SCATTER  # about no mean: no Gaussian freed from rigid motion
        if not options.follow or few or scattered:
            first.shapes = first.shapes @ back
            first.chosen["start"] = "low rank"
            return first
        return self._followed(merged, back, first.shapes, along, options, monitor)

    def _followed(
        self,
        problem: Problem,
        back: np.ndarray,
        low_rank: np.ndarray,
        along: np.ndarray | None,
        options: AutoOptions,
        monitor: Monitor,
    ) -> Solution:
        """The most likely of the fits from all beginnings worth following."""
        unit = unit_size(problem.tracks)
        tracks, cameras = problem.tracks / unit, whole_rotations(problem.rotations)
        floor = misfit_variance(problem, max(problem.residual, LEAST_MISFIT)) / unit**2
        screen = max(misfit_variance(problem, SCREEN) / unit**2, floor)
        found = {"low rank": low_rank / unit}
        if along is not None:
            found["trajectories"] = along / unit
        judged = {name: _judged(tracks, cameras, shapes, screen) for name, shapes in found.items()}
        if options.closed_form:
            closed, by_basis = closed_form(tracks, cameras, screen)
            if closed is not None:
                found["closed form"] = closed
                judged["closed form"] = max(by_basis.values())
        fits: list[tuple[_Start, Fit]] = []
        starts = _worth_following(found, judged, screen, noisy=problem.residual > LEAST_MISFIT)
        for number, start in enumerate(starts):
            noise = max(start.noise, floor)
            schedule = Schedule(FACTORS, noise, floor, noise / 10, COOLING, negligible=NEGLIGIBLE)

            def told(share: float, done: int = number) -> None:
                monitor(0.5 + 0.5 * (done + share) / len(starts))

            fits.append((start, fit(tracks, cameras, start.shapes, schedule, told)))
        start, best = _most_likely(fits, FAR_GAIN * tracks.shape[0] * tracks.shape[2])
        chosen: dict[str, Any] = {
            "start": start.name,
            "first_noise": start.noise,
            "last_noise": best.model.noise,
            "judged": judged,
            "likelihoods": [[s.name, s.noise, f.likelihood, f.iterations] for s, f in fits],
            "factors": best.model.basis.shape[1],
            "directions": tracks.shape[2],
        }
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
    better = [name for name in found if name != "low rank" and judged[name] > judged["low rank"]]
    if better:
        return [_Start("low rank", low_rank, NEAR), *(_Start(name, found[name], screen) for name in better)]
    return [_Start("low rank", low_rank, noise) for noise in (NEAR, MIDDLE, FAR)]


def _most_likely(fits: list[tuple[_Start, Fit]], margin: float) -> tuple[_Start, Fit]:
    """The fit of greatest likelihood; one that began from afar must be more likely than the others by a margin."""
    return max(fits, key=lambda pair: pair[1].likelihood - (margin if pair[0].noise >= FAR else 0.0))


def scatter(shapes: np.ndarray) -> float:
    """Root mean square size of the deviation of aligned shapes (F, 3, N) from their mean of size 1."""
    mean, align, sizes = procrustes_mean(shapes, shapes.mean(axis=0), iterations=30)
    return float(np.sqrt(np.mean(np.sum(((align @ shapes) / sizes[:, None, None] - mean) ** 2, axis=(1, 2)))))


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
    rows = cameras[:, :2]
    best, judged = None, {}
    most = largest_basis(frames, int(np.linalg.matrix_rank(tracks.reshape(2 * frames, count), tol=1e-9)))
    for basis in sorted({k for k in BASES if k <= most} | {most}):
        if basis < 2:
            continue
        shapes = shapes_of_coefficients(linear_coefficients(tracks, rows, basis)[0], tracks, rows)
        judged[basis] = likelihood = _judged(tracks, cameras, shapes, noise)
        if likelihood >= max(judged.values()):
            best = shapes
    return best, judged


def _judged(tracks: np.ndarray, cameras: np.ndarray, shapes: np.ndarray, noise: float) -> float:
    """Likelihood of the distribution that shapes have, after one step from them."""
    schedule = Schedule(FACTORS, noise, noise, noise / 10, max_iterations=2, least_change=0.0, negligible=NEGLIGIBLE)
    return fit(tracks, cameras, shapes, schedule, lambda _: None).likelihood
