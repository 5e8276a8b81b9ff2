"""EM-PND: a Gaussian over shapes without their rigid motions, fitted to the tracks by expectation-maximisation.

maximise over M, C, σ² and the alignment (A_i, c_i)   Σ_i log p(w_i),   w_i = c_i R_i (M + v_i) + n_i,
v_i ~ N(0, C) on the tangent space at M, n_i ~ N(0, σ² I), R_i the upper rows of A_iᵀ

A_i and c_i are no free cameras: they align the shape of frame i with the mean as in Procrustes analysis, so what a
rotation or a change of size explains is never called deformation, and neither a rank nor a basis is to be chosen.
Each iteration takes the posterior of the shapes (with a flat prior along the Procrustes directions: the alignment
corrects itself), then C and σ² from it, then M, A_i and c_i by Procrustes analysis of the posterior means.

Source: Lee, Cho, Choi and Oh, "Procrustean normal distribution for non-rigid structure from motion", CVPR 2013; Lee,
Cho and Oh, the same title, TPAMI 39(7), 2017. Where this departs from them:

- C = BBᵀ + κI with at most ``factors`` columns in B, in place of an unrestricted 3P×3P matrix: F small systems per
  iteration in place of F of size 3P. With ``factors`` of 3N or more it is unrestricted (procrustean_normal.py).
- σ² starts at a thousandth of the mean squared size of a shape and falls by at most the factor ``cooling`` per
  iteration, not below what the tracks leave unexplained; the published programme starts at a ten-thousandth and
  never lets it fall. The slow fall is what finds the better optimum.
- M is the Procrustes mean of the posterior shapes; the journal version descends the gradient of its cost along M.
- The first cameras come from the metric upgrade of :mod:`nrsfm.cameras.intersection`: the equations of the published
  start, which grows the rank by three as well, with another solver.
- Dense tracks (P > 2F) lose the directions in which they hold nothing but noise. F frames in 2N > F dimensions have
  a likelihood without maximum, and noise would be taken for deformation.

On the compression: the covariance that is most likely is zero for what is orthogonal to all tracks, and the noise
is taken as isotropic among the N virtual points; everything else is inner products over points. So the run on
virtual points is that on all points with C confined to the span of the tracks. As published, the prior for the rest
only shrinks from its first guess, never seeing data, and takes no part in M, A_i or c_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.manifolds.rotations import whole_rotations
from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.methods.procrustean_fit import Schedule, fit, unit_size
from nrsfm.options import option

FACTORS = 60
FIRST_SPREAD = 1e-4  # isotropic part of the first covariance (as published), in shares of a shape's squared size


@dataclass(frozen=True)
class EmPndOptions:
    """Options of :class:`EmPnd`. Variances are shares of the mean squared size of a shape, ‖X‖² ≈ 3P."""

    factors: int | None = option(
        None,
        "Columns of B in C = BBᵀ + κI: not a rank of the shapes, whose covariance keeps full rank through κ. "
        f"Default: {FACTORS}, or 3N − 4 where that is less, which leaves C unrestricted.",
        symbol="q",
        minimum=1,
    )
    first_noise: float = option(1e-3, "First noise variance σ².", symbol="σ₀²", above=0, maximum=1)
    last_noise: float = option(
        1e-8, "Noise variance that the schedule stops at; the tracks can keep it higher.", minimum=1e-16, maximum=1
    )
    cooling: float = option(
        0.9, "Least factor by which σ² falls in an iteration. Nearer to 1 is slower and better.", minimum=0.1, maximum=1
    )
    least_change: float = option(
        2e-4,
        "Stop when σ² has settled and an iteration moves the shapes by less than this share of their size.",
        above=0,
    )
    max_iterations: int = option(200, "Upper bound on iterations.", minimum=1)


class EmPnd:
    """Procrustean normal distribution, fitted by expectation-maximisation."""

    name = "em-pnd"
    title = "EM for the Procrustean normal distribution"
    year = 2013
    summary = "a Gaussian over shapes freed from rigid motion; no rank to choose"
    assumes = "shapes scatter about a mean like a Gaussian; cameras that turn"
    cost = "2F²P once; with N ≤ min(2F, P) virtual points, q ≤ 60: F(q³ + 9q²) + 81qN² + 27N³ per iteration"
    needs = Needs()
    camera_method = "intersection"
    denoise = False
    Options = EmPndOptions

    def cells(self, options: EmPndOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: EmPndOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Alternate posterior, covariance, noise and alignment while the noise falls, then until nothing moves."""
        kept = above_noise(problem)
        tracks = problem.tracks if kept is None else problem.tracks @ kept.T
        unit = unit_size(tracks)
        cameras = whole_rotations(problem.rotations)
        schedule = Schedule(
            factors=options.factors or FACTORS,
            first_noise=options.first_noise,
            last_noise=options.last_noise,
            first_spread=FIRST_SPREAD,
            cooling=options.cooling,
            least_change=options.least_change,
            max_iterations=options.max_iterations,
        )
        tracks = tracks / unit
        found = fit(tracks, cameras, initial_shapes(tracks, cameras), schedule, monitor)
        model = found.model
        chosen = {"factors": model.basis.shape[1], "directions": tracks.shape[2], "last_noise": model.noise}
        solution = Solution(found.shapes, None, found.iterations, found.reason, found.history, chosen)
        turned = np.swapaxes(cameras, 1, 2) if problem.cameras_known else found.align
        solution.shapes = unit * (turned @ (found.shapes if kept is None else found.shapes @ kept))
        if not problem.cameras_known:
            solution.rotations = np.ascontiguousarray(np.swapaxes(found.align, 1, 2)[:, :2])
        return solution


def above_noise(problem: Problem) -> np.ndarray | None:
    """Orthonormal rows (N′, N): directions of the points in which dense tracks hold more than noise; None for all.

    Noise alone has singular values up to σ(√P + √2F). With P ≤ 2F its level is poorly known and nothing is cut.
    """
    frames, count = len(problem.tracks), problem.tracks.shape[2]
    if problem.noise <= 0 or problem.points <= 2 * frames:
        return None
    _, values, right = np.linalg.svd(problem.tracks.reshape(2 * frames, count), full_matrices=False)
    live = values > problem.noise * (np.sqrt(problem.points) + np.sqrt(2 * frames))
    live[:3] = True
    return None if live.all() else np.asarray(right[live])


def initial_shapes(tracks: np.ndarray, cameras: np.ndarray) -> np.ndarray:
    """Shapes (F, 3, N) that show the tracks (F, 2, N) and scatter least about their mean: the published start.

    Frame i is R_iᵀw_i + d_i d_iᵀM with d_i its viewing direction: Σ‖X_i − M‖² is least over depths where these depths
    are the mean's, and over M where M is the mean, (I − mean of d_i d_iᵀ) M = mean of R_iᵀw_i. Directions in which
    the camera hardly turns are given no depth.
    """
    rows, views = cameras[:, :2], cameras[:, 2]
    seen = np.swapaxes(rows, 1, 2) @ tracks
    normal = np.eye(3) - views.T @ views / len(views)
    mean = np.linalg.lstsq(normal, seen.mean(axis=0), rcond=1e-6)[0]
    return np.asarray(seen + views[:, :, None] * (views @ mean)[:, None, :])
