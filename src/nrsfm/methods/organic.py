"""Organic priors: what the factorisation holds anyway, the spectrum of R⁺W and K rotations per frame, put to use.

    minimise over S   ½‖W − RS‖²_F + γ Σ_{i>n} θ_i σ_i(S♯),   θ_i = ξ/(σ_i⁰ + ξ)

σ_i⁰: singular values of S♯ for the first shapes S = R⁺W. The n leading ones are kept (a partial sum of singular values;
n = 1: the mean shape), the others are weighted once and for all. With θ increasing, the proximal step is the soft
threshold σ_i − τθ_i in the order of the values (Gu et al., IJCV 121, 2017; Oh et al., PAMI 38, 2016).

Source: Kumar and Van Gool, "Organic priors in non-rigid structure from motion", ECCV 2022; cameras: average of K
rotations per frame (:mod:`nrsfm.cameras.averaged`).

Departures. Only the abstract and the authors' summary were at hand: that the weights are those of the 2020 method taken
at R⁺W, and n = 1, are our reading. ξ = ε σ₁⁰ and γ are relative to the data, γ follows the noise, and the multiplier
method's penalty starts where the threshold leaves only what is kept. Singular values that are nearly equal share their
weights: with weights by order alone the proximal step jumps where two values meet, and a change in the last digit of
the tracks came out as 5e-3 of the shape; shared, as 1e-12, and the errors are the same or lower.

On the exact compression: the penalty knows S by its singular values only, and R⁺W is compressed with W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution
from nrsfm.methods.weighted import Penalty, initial_values, solve_weighted
from nrsfm.options import option

LEAST_GAMMA, GAMMA_PER_NOISE = 0.003, 2.0
"""Tuned on face-seq1 and face-seq3, clean and with noise."""

SHARED = 0.2
"""Width, in the logarithm of singular values, over which weights are shared."""


@dataclass(frozen=True)
class OrganicOptions(LowRankOptions):
    """Options of :class:`Organic`: those of the global low-rank model, with weights always."""

    gamma: float | None = option(
        None,
        "Weight of the smallest singular values, in units of (rms of the tracks)·√P. Default: the larger of 0.003 and "
        "2 × the noise level.",
        symbol="γ",
        above=0,
    )
    reweight: float = option(
        0.03,
        "Where the weights ξ/(σ + ξ) begin to fall: ξ = ε times the largest singular value of R⁺W over frames.",
        symbol="ε",
        above=0,
    )
    kept: int = option(1, "Leading singular values of S♯ that are not penalised.", symbol="n", minimum=0)


class Organic:
    """Global low rank over frames by a partial sum of singular values, weighted by the first shapes' spectrum."""

    name = "organic"
    title = "Organic priors"
    year = 2022
    summary = "partial sum of singular values of the shapes, weighted by the spectrum of the first shapes"
    assumes = "few deformation modes in all; cameras that turn"
    cost = "2F²P once; F²·min(2F, P) per iteration"
    needs = Needs()
    camera_method = "averaged"
    denoise = False
    Options = OrganicOptions

    def cells(self, options: OrganicOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: OrganicOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Alternate S and S♯ with multipliers until they agree."""
        gamma = options.gamma if options.gamma is not None else max(LEAST_GAMMA, GAMMA_PER_NOISE * problem.noise)
        first = initial_values(problem)
        solution = solve_weighted(problem, options, gamma, partial_sum(first, options.reweight, options.kept), monitor)
        if options.kept >= len(first):
            solution.warnings.append(
                f"kept {options.kept} keeps all {len(first)} singular values: nothing is recovered"
            )
        return solution


def partial_sum(first: np.ndarray, epsilon: float, kept: int) -> Penalty:
    """φ_i(σ) = θ_i σ with θ_i = ξ/(``first``_i + ξ), ξ = ε × the largest of ``first``; θ_i = 0 for i < ``kept``."""
    xi = max(epsilon * float(first[0]), np.finfo(float).tiny)
    weights = xi / (first + xi)
    weights[:kept] = 0.0
    start = float(first[kept] / weights[kept]) if kept < len(first) else float(first[0])

    def proximal(values: np.ndarray, threshold: float) -> np.ndarray:
        return np.maximum(values - threshold * shared_weights(values, weights), 0.0)

    return Penalty(proximal, lambda values: float(weights @ values), start)


def shared_weights(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weights (n,) of singular values (n,), descending, averaged over those that are nearly equal."""
    logs = np.log(np.maximum(values, 1e-12 * values[0] + np.finfo(float).tiny))
    near = np.exp(-0.5 * ((logs[:, None] - logs) / SHARED) ** 2)
    return (near @ weights) / near.sum(axis=1)
