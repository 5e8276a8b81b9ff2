"""The interface of a method, and what the methods that extend the global low-rank model share.

A method sees one :class:`Problem`: virtual tracks, cameras, the noise level. It returns one :class:`Solution`. It
does no I/O, draws no progress, times nothing and aligns nothing: the pipeline does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from nrsfm.numerics.arrays import beside, namespace_of, on_host
from nrsfm.numerics.low_rank import threshold_over_frames
from nrsfm.options import option


@dataclass(frozen=True)
class Needs:
    """What a method needs of its input; the pipeline refuses what does not have it.

    ``frame_order``: frames follow one another in time. ``every_point``: works on the real points, because its terms
    are not preserved by the compression. ``neighbours``: also knows which points are neighbours (implies
    ``every_point``). ``unscaled``: the size of each frame is left to the method, unless scales are asked for.
    """

    frame_order: bool = False
    every_point: bool = False
    neighbours: bool = False
    unscaled: bool = False
    least_frames: int = 3
    least_points: int = 4

    def __str__(self) -> str:
        words = ["frames in order"] if self.frame_order else []
        words += ["neighbours (mesh, grid or found)"] if self.neighbours else []
        if self.least_frames > 3:
            words.append(f"{self.least_frames} frames")
        return ", ".join(words) or "nothing"


@dataclass(frozen=True)
class Problem:
    """What a method works on, in units in which the centred tracks have root mean square 1.

    ``tracks`` (F, 2, N): virtual tracks, cells side by side. ``offsets`` (K+1,): cell k owns columns
    ``offsets[k]:offsets[k+1]``. ``sizes`` (K,): real points of each cell. ``rotations`` (F, 2, 3): the upper rows of
    the cameras. ``noise``: standard deviation of a real coordinate. ``cameras_known``: the cameras were given; a
    method that estimates cameras and shapes together then leaves them as they are. ``residual``: estimate of the
    noise that is left in the tracks after the compression has shrunk it, root mean square per real coordinate.
    ``ordered``: the frames follow one another in time. A method that needs every point gets the real tracks, in the
    order of the input, in place of virtual ones.

    Tracks and rotations of a method with ``on_device`` may be arrays of another library, on a device.
    """

    tracks: Any
    offsets: np.ndarray
    sizes: np.ndarray
    rotations: Any
    noise: float
    cameras_known: bool = True
    residual: float = 0.0
    ordered: bool = True

    @property
    def points(self) -> int:
        """Number of real points P."""
        return int(self.sizes.sum())

    @property
    def initial_shapes(self) -> Any:
        """S = pinv(R) W = Rᵀ W, (F, 3, N)."""
        return namespace_of(self.tracks).matrix_transpose(self.rotations) @ self.tracks

    def beside(self, like: Any) -> Problem:
        """The same problem with tracks and rotations where an array is, in its library."""
        return replace(self, tracks=beside(self.tracks, like), rotations=beside(self.rotations, like))

    def merged(self, level: float = 0.0) -> tuple[Problem, Any]:
        """The same problem with all cells compressed into one, and the map (r, N) back to their columns.

        Exact for whatever treats all columns alike, and smaller: N columns have at most 2F dimensions. ``level`` cuts
        as many trailing directions as together hold at most that root mean square per real coordinate.
        """
        xp, (frames, _, count) = namespace_of(self.tracks), self.tracks.shape
        left, along, right = xp.linalg.svd(xp.reshape(self.tracks, (2 * frames, count)), full_matrices=False)
        values = on_host(along)
        live = values > 1e-12 * max(float(values[0]), np.finfo(float).tiny)
        if level > 0:
            live &= np.cumsum(values[::-1] ** 2)[::-1] > level**2 * 2 * frames * self.points
        kept = max(1, int(np.count_nonzero(live)))  # they are descending: the first ones
        tracks = xp.reshape(left[:, :kept] * along[:kept], (frames, 2, kept))
        offsets, sizes = np.array([0, kept]), np.array([self.points])
        return replace(self, tracks=tracks, offsets=offsets, sizes=sizes), right[:kept, :]


def cut_by(whole: Problem, merged: Problem) -> float:
    """What merging has cut from the tracks: root mean square per real coordinate, in units of the tracks' own."""
    xp = namespace_of(whole.tracks)
    lost = float(xp.sum(whole.tracks**2) - xp.sum(merged.tracks**2))
    return float(np.sqrt(max(lost, 0.0) / (2 * whole.tracks.shape[0] * whole.points)))


@dataclass
class Solution:
    """What a method found: ``shapes`` (F, 3, N), where the tracks of the problem are.

    ``groups`` (K,): subspace label of each cell, or None. ``rotations`` (F, 2, 3) and ``scales`` (F,): only of a
    method that estimates cameras together with shapes, and only if they were not known; ``tracks[f] ≈ scales[f] ·
    rotations[f] @ shapes[f]`` then.
    """

    shapes: Any
    groups: np.ndarray | None
    iterations: int
    stop_reason: str
    history: dict[str, list[float]]
    chosen: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    rotations: np.ndarray | None = None
    scales: np.ndarray | None = None


Monitor = Callable[[float], None]  # told the share of the work that is done, 0 to 1


class Method(Protocol):
    """One method of the comparison. Instances are stateless; each lives in its own file.

    ``cost`` is in F, P, K. ``camera_method`` is the camera estimator of the publication, used unless the caller names
    another. ``denoise``: whether the compression shrinks noise by default (not part of any published method). A method
    that also has ``on_device = True`` works on problems whose arrays are on a device; others are given NumPy's.
    """

    name: str
    title: str
    year: int
    summary: str
    assumes: str
    cost: str
    needs: Needs
    camera_method: str
    denoise: bool
    Options: type

    def cells(self, options: Any, points: int, frames: int) -> int:
        """How many k-means++ cells of points the method wants; 1 for a global method."""
        ...

    def solve(self, problem: Problem, options: Any, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Run the method."""
        ...


@dataclass(frozen=True)
class LowRankOptions:
    """Options of the global low-rank model ½‖W − RS‖² + γ‖S♯‖_* and of its multiplier iteration."""

    gamma: float | None = option(
        None,
        "Weight of the nuclear norm, in units of (rms of the tracks)·√P. Default: the larger of 0.003 and 0.15 × "
        "the noise level.",
        symbol="γ",
        above=0,
    )
    reweight: float = option(
        0.0,
        "Reweighting ε of the nuclear norm: σ is thresholded by τ·εσ₁/(σ + εσ₁), so that large singular values are "
        "hardly shrunk. 0 is the plain norm of the paper.",
        symbol="ε",
        minimum=0,
    )
    rank: int | None = option(
        None,
        "Largest rank of S♯, the number of basis shapes. Default: none; the norm decides.",
        symbol="K",
        minimum=1,
    )
    beta: float | None = option(
        None,
        "First penalty of the multiplier method. Default: the value at which the first threshold equals the largest "
        "singular value, so that γ, far more than the schedule, decides the answer.",
        symbol="β",
        minimum=1e-12,
    )
    growth: float = option(1.1, "Growth of the penalty per iteration.", symbol="ρ, c", above=1, maximum=10)
    beta_max: float = option(1e8, "Largest penalty; reaching it stops the iteration.", symbol="β_m", above=0)
    gap: float = option(
        1e-6,
        "Stop when the root mean square of S♯ − f(S), in units of the tracks' rms, is below this (and C − J too).",
        symbol="ε",
        above=0,
    )
    max_iterations: int = option(400, "Upper bound on iterations.", minimum=1)


@dataclass
class LowRankState:
    """S, S♯, the multiplier L₁ and the penalty β of the iteration that all three methods run.

    Arrays are where the tracks of the problem are, on a device or not.
    """

    problem: Problem
    options: LowRankOptions
    shapes: Any
    low_rank: Any
    multiplier: Any
    gamma: float
    beta: float
    rank: int = 0
    nuclear: float = 0.0
    history: dict[str, list[float]] = field(default_factory=lambda: {"energy": [], "gap": [], "rank": [], "beta": []})

    @classmethod
    def start(cls, problem: Problem, options: LowRankOptions) -> LowRankState:
        """S = pinv(R) W, S♯ = f(S), L₁ = 0."""
        shapes = problem.initial_shapes
        xp = namespace_of(shapes)
        relative = options.gamma if options.gamma is not None else max(0.003, 0.15 * problem.noise)
        gamma = relative * float(np.sqrt(problem.points))
        largest = float(xp.linalg.matrix_norm(xp.reshape(shapes, (shapes.shape[0], -1)), ord=2))
        factor = options.reweight if options.reweight > 0 else 1.0
        beta = options.beta if options.beta is not None else gamma * factor / max(largest, np.finfo(float).tiny)
        low_rank, multiplier = xp.asarray(shapes, copy=True), xp.zeros_like(shapes)
        return cls(problem, options, shapes, low_rank, multiplier, gamma, min(beta, 1.0))

    def update_shapes(self) -> None:
        """S ← (RᵀR + βI)⁻¹ (β(f⁻¹(S♯) + f⁻¹(L₁)/β) + RᵀW).

        With R Rᵀ = I the inverse is explicit: S = A + Rᵀ(W − RA)/(1 + β), A = S♯ + L₁/β.
        """
        rows = self.problem.rotations
        target = self.multiplier / self.beta
        target += self.low_rank
        residual = self.problem.tracks - rows @ target
        residual /= 1.0 + self.beta
        target += namespace_of(rows).matrix_transpose(rows) @ residual
        self.shapes = target

    def update_low_rank(self) -> None:
        """S♯ ← U S_{γ/β}(Σ) Vᵀ of f(S) − L₁/β."""
        reweight = self.options.reweight if self.options.reweight > 0 else None
        start = self.multiplier / -self.beta
        start += self.shapes
        self.low_rank, values = threshold_over_frames(start, self.gamma / self.beta, reweight, self.options.rank)
        self.rank = int(np.count_nonzero(values))
        self.nuclear = float(values.sum())

    def update_multiplier(self, other_gap: float = 0.0) -> float:
        """L₁ ← L₁ + β(S♯ − f(S)); record energy, gap, rank; return the gap.

        The paper's gap is a largest entry; here it is a root mean square per real coordinate, which the
        compression leaves unchanged.
        """
        xp = namespace_of(self.shapes)
        step = self.low_rank - self.shapes
        size = float(np.sqrt(float(xp.sum(step * step)) / (3 * step.shape[0] * self.problem.points)))
        step *= self.beta
        self.multiplier += step
        residual = self.problem.tracks - self.problem.rotations @ self.low_rank
        gap = max(size, other_gap)
        self.history["energy"].append(0.5 * float(xp.sum(residual * residual)) + self.gamma * self.nuclear)
        self.history["gap"].append(gap)
        self.history["rank"].append(float(self.rank))
        self.history["beta"].append(self.beta)
        return gap

    def grow(self) -> None:
        """β ← min(ρβ, β_m)."""
        self.beta = min(self.options.growth * self.beta, self.options.beta_max)

    def chosen(self) -> dict[str, Any]:
        """What was chosen from the data: γ relative to √P, and the final rank."""
        return {"gamma": self.gamma / float(np.sqrt(self.problem.points)), "rank": self.rank}

    def finished(self, gap: float) -> str | None:
        """The reason to stop, or None."""
        if not np.isfinite(gap):
            return "not finite"
        if gap < self.options.gap:
            return "gap"
        if self.beta >= self.options.beta_max:
            return "largest penalty"
        return None


def run_iterations(state: LowRankState, step: Callable[[int], float], monitor: Monitor) -> tuple[int, str]:
    """Call ``step(iteration)``, which returns the gap, until the state is finished; returns (iterations, reason)."""
    first = None
    for iteration in range(state.options.max_iterations):
        gap = step(iteration)
        reason = state.finished(gap)
        if reason is not None:
            return iteration + 1, reason
        # The gap falls about geometrically, so its logarithm tells how far the iteration has come.
        first = gap if first is None else max(first, gap)
        if gap > 0 and first > state.options.gap:
            monitor(min(1.0, float(np.log(first / gap) / np.log(first / state.options.gap))))
        state.grow()
    return state.options.max_iterations, "iteration limit"


def solve_global(problem: Problem, options: LowRankOptions, monitor: Monitor) -> Solution:
    """The global low-rank model alone: alternate S and S♯ with multipliers until they agree."""
    state = LowRankState.start(problem, options)

    def step(_: int) -> float:
        state.update_shapes()
        state.update_low_rank()
        return state.update_multiplier()

    iterations, reason = run_iterations(state, step, monitor)
    return Solution(state.shapes, None, iterations, reason, state.history, state.chosen())
