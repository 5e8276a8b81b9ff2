"""BMM: the block matrix method, global low rank only.

minimise over S   ½‖W − RS‖²_F + γ‖S♯‖_*   (the paper's eq. for Dai's formulation)

Source: Dai, Li and He, "A simple prior-free method for non-rigid structure-from-motion factorization", IJCV 107, 2014.
The problem is theirs; it is solved here by the multiplier method of the paper's algorithms in place of their
fixed-point continuation, with the same minimum. Noise is first shrunk away in one global factor (see compression).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution, solve_global


@dataclass(frozen=True)
class BmmOptions(LowRankOptions):
    """Options of :class:`Bmm`: those of the global low-rank model."""


class Bmm:
    """Global low rank over frames."""

    name = "bmm"
    title = "Block matrix method"
    year = 2014
    summary = "global low rank of the shapes over frames, by the nuclear norm"
    assumes = "few deformation modes in all; cameras that turn"
    cost = "2F²P once; F²·min(2F, P) per iteration"
    needs = Needs()
    camera_method = "intersection"
    denoise = True
    on_device = True
    Options = BmmOptions

    def cells(self, options: BmmOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: BmmOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Alternate S and S♯ with multipliers until they agree."""
        return solve_global(problem, options, monitor)
