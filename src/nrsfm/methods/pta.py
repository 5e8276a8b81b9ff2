"""PTA: point trajectory approach, every point's 3D path a sum of few cosines of time.

minimise over A   ½‖W − R(Θ ⊗ I₃)A‖²_F,   S = (Θ ⊗ I₃)A,   Θ (F×K) the first K vectors of the DCT

so A = (R(Θ ⊗ I₃))⁺W: one linear least-squares problem, no iteration.

Source: Akhter, Sheikh, Khan and Kanade, "Nonrigid structure from motion in trajectory space", NIPS 2008; PAMI 33(7),
2011.
Departures: K, which they set by hand, is chosen here where it is not given: for K = 1, 2, ... the shapes are made to
reproject exactly and the K of the simplest ones is kept (:func:`nrsfm.methods.trajectory.sharpness`). The cameras are
those of :mod:`nrsfm.cameras.trajectory`, or any others. Known to fail where the camera turns slowly beside the
motion: M = R(Θ ⊗ I₃) is then nearly singular for large K, and that is the method.
Runs on the exact compression: A is linear in W, column by column.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.methods.trajectory import (
    Fit,
    choose,
    clamped,
    dct_basis,
    judge,
    project,
    rank_limit,
    shapes_from,
    try_ranks,
)
from nrsfm.options import option

LARGEST_RANK = 30


@dataclass(frozen=True)
class PtaOptions:
    """Options of :class:`Pta`."""

    rank: int | None = option(
        None,
        "Number of cosines per trajectory. Default: of 1 to 30 the one whose shapes, made to reproject exactly, are "
        "simplest (nuclear norm within 3% of the least, then least mean logarithm of the singular values).",
        symbol="K",
        minimum=1,
    )


class Pta:
    """Trajectories in a cosine basis."""

    name = "pta"
    title = "Point trajectory approach"
    year = 2008
    summary = "every point's path is a sum of K cosines of time, by linear least squares"
    assumes = "slow, smooth motion and a camera that turns faster"
    cost = "2F²P once; F·K²·min(2F, P) per K"
    needs = Needs(frame_order=True)
    camera_method = "trajectory"
    denoise = False
    Options = PtaOptions

    def cells(self, options: PtaOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: PtaOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """A = (R(Θ ⊗ I₃))⁺W, for one K or for all that are compared."""
        rotations, frames = problem.rotations, len(problem.tracks)
        flat = problem.tracks.reshape(2 * frames, -1)
        limit, _ = rank_limit(frames, flat.shape[1], frames)

        def fit(rank: int) -> Fit:
            basis = dct_basis(frames, rank)
            bases, residual = project(rotations, basis, flat)
            energy = 0.5 * float(np.sum(residual * residual))
            return Fit(rank, shapes_from(basis, bases), np.eye(rank), [energy], "solved")

        if options.rank is not None:
            rank, warnings = clamped(options.rank, limit, "rank", f"{frames} frames")
            best = fit(rank)
        else:
            ranks, warnings = list(range(1, min(limit, LARGEST_RANK) + 1)), []
            best = choose(try_ranks(ranks, lambda k: judge(rotations, flat, fit(k)))).fit
        monitor(1.0)
        history = {"energy": best.energies}
        return Solution(best.shapes, None, 1, best.reason, history, {"rank": best.rank}, warnings)
