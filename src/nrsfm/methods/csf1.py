"""CSF1: column space fitting, the shape as one smooth path of a point in a space of K shapes.

minimise over X   ½‖(I − MM⁺)W‖²_F,   M = R(ΩX ⊗ I₃),   S = (ΩX ⊗ I₃) M⁺W,   Ω (F×d) the first d vectors of the DCT

Source: Gotardo and Martinez, "Computing smooth time-trajectories for camera and deformable shape in structure from
motion with occlusion", PAMI 33(10), 2011. Damped Gauss-Newton over X from X₀ = [I; 0], X made orthonormal in every
step, as theirs. Departures: (1) Kaufman's approximation of the Jacobian: beside the full one it converges in fewer
iterations, and to lower energies where the full one ends in another minimum (pickup, K = 7, d = 36: residual .0120
against .0123 of ‖W‖, error .027 against .457). (2) Normal equations that need no Jacobian
(:mod:`nrsfm.methods.trajectory`). (3) K and d, set by hand there, are chosen where they are not given. (4) Complete
tracks only.
Runs on the exact compression: the objective sees W only through WWᵀ, and S is linear in W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.methods.trajectory import (
    Fit,
    VariableProjection,
    choose,
    clamped,
    dct_basis,
    judge,
    rank_limit,
    try_ranks,
)
from nrsfm.options import option

LARGEST_RANK = 12
LEAST_BASIS = 30


@dataclass(frozen=True)
class Csf1Options:
    """Options of :class:`Csf1`."""

    rank: int | None = option(
        None,
        "Number of basis shapes. Default: of 1 to 12 the one whose shapes, made to reproject exactly, are simplest "
        "(nuclear norm within 3% of the least, then least mean logarithm of the singular values).",
        symbol="K",
        minimum=1,
    )
    basis_size: int | None = option(
        None,
        "Number of cosines that the coefficients of the shapes are made of. Default: a tenth of the frames, at least "
        "30 or all frames.",
        symbol="d",
        minimum=1,
    )
    least_gain: float = option(1e-6, "Stop when an iteration lowers the energy by less than this share.", above=0)
    max_iterations: int = option(100, "Upper bound on iterations, for each K.", minimum=1)


def default_basis_size(frames: int, rank: int | None) -> int:
    """d: a tenth of the frames, at least 30 or all frames, and no less than K."""
    return min(frames, max(-(-frames // 10), LEAST_BASIS, rank or 0))


class Csf1:
    """Smooth shape trajectories."""

    name = "csf1"
    title = "Column space fitting"
    year = 2011
    summary = "the shape moves smoothly through a space of K shapes, by variable projection"
    assumes = "few deformation modes with smooth coefficients; cameras that turn"
    cost = "2F²P once; (dK)³ + F·K²·min(2F, P) per iteration"
    needs = Needs(frame_order=True)
    camera_method = "grown"
    denoise = False
    Options = Csf1Options

    def cells(self, options: Csf1Options, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: Csf1Options, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Damped Gauss-Newton over X, for one K or for all that are compared."""
        rotations, frames = problem.rotations, len(problem.tracks)
        flat = problem.tracks.reshape(2 * frames, -1)
        wanted = options.basis_size or default_basis_size(frames, options.rank)
        size, warnings = clamped(wanted, frames, "basis_size", f"{frames} frames")
        limit, useful = rank_limit(frames, flat.shape[1], size)
        objective = VariableProjection(rotations, flat, dct_basis(frames, size))

        def fit(rank: int) -> Fit:
            return objective.minimise(
                np.eye(size, rank), iterations=options.max_iterations, tolerance=options.least_gain
            )

        if options.rank is not None:
            rank, more = clamped(options.rank, limit, "rank", f"{frames} frames and {size} cosines")
            warnings += more
            best = fit(rank)
        else:
            ranks = list(range(1, min(useful, LARGEST_RANK) + 1))
            best = choose(try_ranks(ranks, lambda k: judge(rotations, flat, fit(k)))).fit
        monitor(1.0)
        return best.solution({"rank": best.rank, "basis_size": size}, warnings)
