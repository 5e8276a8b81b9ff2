"""R-BMM: the block matrix method with a reweighted nuclear norm.

    minimise over S   ½‖W − RS‖²_F + γ Σ_i θ_i σ_i(S♯),   θ_i = ξ/(σ_i(S♯) + ξ)

Large singular values are hardly shrunk, small ones by γ. At a solution the weights belong to its own singular values:
it is a stationary point of ½‖W − RS‖² + γ Σ ξ log(1 + σ_i/ξ). The proximal step is the limit of reweighting from above,

    σ ← (σ − ξ + √((σ + ξ)² − 4τξ))/2  where that is real and positive, else 0   (Gu et al., IJCV 121, 2017).

Source: Kumar, "Non-rigid structure from motion: prior-free factorization method revisited", WACV 2020 (arXiv
1902.10274); cameras: of all K column triplets the smoothest (:mod:`nrsfm.cameras.smoothest`).

Departures. Only the paper's abstract was at hand. Its weights ξ/(σ_i + γ) have two constants that depend on the data's
unit; here they are one, ξ = ε σ₁(R⁺W), the other being a matter of γ, and both are relative. γ follows the noise. The
multiplier method's penalty starts where the threshold leaves nothing, and stops as in ``bmm``.

On the exact compression: the penalty knows S by its singular values only, as the nuclear norm does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution
from nrsfm.methods.weighted import Penalty, initial_values, solve_weighted
from nrsfm.options import option

LEAST_GAMMA, GAMMA_PER_NOISE = 0.003, 1.5
"""The noise's largest singular value in S♯ is about √2 × the noise level × √P; tuned on face-seq1 and face-seq3."""


@dataclass(frozen=True)
class RbmmOptions(LowRankOptions):
    """Options of :class:`Rbmm`: those of the global low-rank model, with weights always."""

    gamma: float | None = option(
        None,
        "Weight of the smallest singular values, in units of (rms of the tracks)·√P. Default: the larger of 0.003 and "
        "1.5 × the noise level.",
        symbol="γ",
        above=0,
    )
    reweight: float = option(
        0.02,
        "Where the weights ξ/(σ + ξ) begin to fall: ξ = ε times the largest singular value of R⁺W over frames.",
        symbol="ε",
        above=0,
    )


class Rbmm:
    """Global low rank over frames by a reweighted norm."""

    name = "rbmm"
    title = "Block matrix method revisited"
    year = 2020
    summary = "global low rank of the shapes over frames, by a reweighted nuclear norm"
    assumes = "few deformation modes in all; cameras that turn, smoothly"
    cost = "2F²P once; F²·min(2F, P) per iteration"
    needs = Needs(frame_order=True)
    camera_method = "smoothest"
    denoise = False
    Options = RbmmOptions

    def cells(self, options: RbmmOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: RbmmOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Alternate S and S♯ with multipliers until they agree."""
        gamma = options.gamma if options.gamma is not None else max(LEAST_GAMMA, GAMMA_PER_NOISE * problem.noise)
        penalty = logarithmic_penalty(float(initial_values(problem)[0]), options.reweight)
        return solve_weighted(problem, options, gamma, penalty, monitor)


def logarithmic_penalty(largest: float, epsilon: float) -> Penalty:
    """φ(σ) = ξ log(1 + σ/ξ), ξ = ε × ``largest``: its slope is the weight ξ/(σ + ξ)."""
    xi = max(epsilon * largest, np.finfo(float).tiny)

    def proximal(values: np.ndarray, threshold: float) -> np.ndarray:
        inside = (values + xi) ** 2 - 4.0 * threshold * xi
        root = 0.5 * (values - xi + np.sqrt(np.maximum(inside, 0.0)))
        return np.where(inside > 0, np.maximum(root, 0.0), 0.0)

    first = largest if largest <= xi else (largest + xi) ** 2 / (4.0 * xi)
    return Penalty(proximal, lambda values: float(xi * np.sum(np.log1p(values / xi))), first)
