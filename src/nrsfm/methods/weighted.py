"""The global low-rank model with another penalty on singular values than their sum, for ``rbmm`` and ``organic``.

    minimise over S   ½‖W − RS‖²_F + γ Σ_i φ_i(σ_i(S♯))

by the multiplier iteration of :mod:`nrsfm.methods.base`; the penalty enters through its proximal step on singular
values alone. It sees S only through its Gram matrix over points, so the exact compression changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nrsfm.methods.base import LowRankOptions, LowRankState, Monitor, Problem, Solution, run_iterations
from nrsfm.numerics.low_rank import shrink_over_frames


@dataclass(frozen=True)
class Penalty:
    """φ by its proximal step, its value and where the iteration may begin.

    ``proximal(σ, τ)``: argmin over x ≥ 0 of ½(x − σ)² + τφ(x), entry by entry, σ descending. ``value(σ)``: Σφ_i(σ_i).
    ``first``: the τ at which nothing that is penalised is left of R⁺W.
    """

    proximal: Callable[[np.ndarray, float], np.ndarray]
    value: Callable[[np.ndarray], float]
    first: float


@dataclass
class WeightedState(LowRankState):
    """The iteration with that penalty."""

    penalty: Penalty = field(default=Penalty(lambda values, _: values, lambda _: 0.0, 1.0))

    def update_low_rank(self) -> None:
        """S♯ ← U prox(Σ) Vᵀ of f(S) − L₁/β."""
        start = self.multiplier / -self.beta
        start += self.shapes
        threshold = self.gamma / self.beta
        self.low_rank, values = shrink_over_frames(start, lambda given: self.penalty.proximal(given, threshold))
        self.rank = int(np.count_nonzero(values))
        self.nuclear = self.penalty.value(values)


def initial_values(problem: Problem) -> np.ndarray:
    """Singular values (min(F, 3N),), descending, of S♯ for S = R⁺W."""
    flat = problem.initial_shapes.reshape(len(problem.tracks), -1)
    return np.linalg.svd(flat, compute_uv=False)


def solve_weighted(
    problem: Problem, options: LowRankOptions, gamma: float, penalty: Penalty, monitor: Monitor
) -> Solution:
    """Alternate S and S♯ with multipliers until they agree; ``gamma`` in units of √P."""
    weight = gamma * float(np.sqrt(problem.points))
    start = problem.initial_shapes
    # As in bmm: the first threshold leaves nothing, so that γ decides the answer and not the schedule.
    beta = options.beta if options.beta is not None else weight / max(penalty.first, np.finfo(float).tiny)
    state = WeightedState(
        problem, options, start, start.copy(), np.zeros_like(start), weight, min(beta, 1.0), penalty=penalty
    )

    def step(_: int) -> float:
        state.update_shapes()
        state.update_low_rank()
        return state.update_multiplier()

    iterations, reason = run_iterations(state, step, monitor)
    return Solution(state.shapes, None, iterations, reason, state.history, state.chosen())
