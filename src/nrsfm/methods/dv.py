"""DV: dense variational reconstruction: total variation over the surface and low rank over frames.

    minimise over S, R   ½‖W − RS‖²_F + μ Σ_f Σ_i TV(S_f^i) + γ‖S♯‖_*

TV(S_f^i) sums over the points the length of the gradient of coordinate i of frame f.

Source: Garg, Roussos and Agapito, "Dense variational reconstruction of non-rigid surfaces from monocular video",
CVPR 2013; with their λ and τ, μ = 1/λ and γ√P = τ/λ. As there, cameras start from a rigid factorisation and are
updated together with the shapes, R_f by orthogonal Procrustes against S_f (never where they were given; by default not
where there is noise, see ``joint``).

Departures. (1) They couple a smooth and a low-rank copy of S by a quadratic term and alternate primal-dual steps for
the one with a threshold for the other. Here both terms have a dual variable in one primal-dual iteration (Chambolle
and Pock 2011), which keeps the same two steps and reaches the minimum of the objective itself:

    p ← projection of p + σ_p D S̄ onto |p_i| ≤ μ          Q ← Q + σ_q S̄♯ less its threshold: ‖Q‖₂ ≤ γ√P
    S ← argmin ½‖W − RS‖² + ‖S − (S_before − t(Dᵀp + Q))‖²/2t          S̄ ← 2S − S_before

(2) It starts from the minimum without total variation, found on the exact compression, and its dual variables, where
they start from one rigid shape. (3) A mesh or nearest tracks may take the place of the pixel grid, and the gradient is
scaled so that μ means the same for any number of points (:mod:`nrsfm.neighbours`). (4) The weights are ours.

It needs every point: the total variation is not preserved by the compression.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.methods.base import LowRankOptions, LowRankState, Monitor, Needs, Problem, Solution, run_iterations
from nrsfm.neighbours import NeighbourOptions, find_neighbours, gradient
from nrsfm.numerics.total_variation import GraphVariation
from nrsfm.options import option

_CHECK = 10  # iterations between looks at energy and change, and between updates of the cameras
_LARGE = 5_000_000  # coordinates from which on the iteration runs in float32
_PROCRUSTES_STEPS = 20


@dataclass(frozen=True)
class DvOptions(NeighbourOptions):
    """Options of the variational method."""

    variation: float | None = option(
        None,
        "Weight of the total variation, in units in which the tracks have rms 1. Default: 1e-5 + 0.0015 × the noise "
        "level.",
        symbol="μ = 1/λ",
        minimum=0,
    )
    gamma: float | None = option(
        None,
        "Weight of the nuclear norm, in units of (rms of the tracks)·√P. Default: the larger of 0.005 and 1.2 × "
        "the noise level.",
        symbol="γ = τ/(λ√P)",
        above=0,
    )
    joint: bool | None = option(
        None,
        "Update the cameras together with the shapes, as published; never where they are given. Default: where the "
        "tracks are without noise, because with noise the weights shrink the depth and the cameras follow.",
    )
    penalty: float = option(
        0.1, "Inverse step of the primal variable, in units of the data term's curvature.", symbol="ρ", above=0
    )
    change: float = option(
        1e-3,
        "Stop when ten iterations change the shapes by less than this (root mean square, in units of the tracks' rms).",
        above=0,
    )
    max_iterations: int = option(200, "Upper bound on iterations.", minimum=1)


class Dv:
    """Total variation over neighbours and low rank over frames."""

    name = "dv"
    title = "Dense variational"
    year = 2013
    summary = "piecewise smooth surfaces by total variation, low rank over frames, cameras along with the shapes"
    assumes = "a surface smooth but for edges, few deformation modes; cameras that turn"
    cost = "2F²P once; F·P·k + F²P per iteration"
    needs = Needs(every_point=True, neighbours=True)
    camera_method = "rigid"
    denoise = False
    Options = DvOptions

    def cells(self, options: DvOptions, points: int, frames: int) -> int:
        """One: the points themselves."""
        return 1

    def solve(self, problem: Problem, options: DvOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Start from low rank alone, then iterate on shapes, cameras and both dual variables."""
        graph = find_neighbours(problem.tracks, options, problem.noise)
        variation, gamma = _weights(options, problem.noise)
        state = _Iteration(problem, graph, variation, gamma, options)
        wanted = problem.noise == 0 if options.joint is None else options.joint
        joint = wanted and not problem.cameras_known
        history: dict[str, list[float]] = {"energy": [], "change": []}
        reason, iteration = "iteration limit", 0
        before = state.shapes.copy()
        for iteration in range(1, options.max_iterations + 1):
            state.step()
            if iteration % _CHECK and iteration < options.max_iterations:
                continue
            size = float(np.sqrt(np.mean((state.shapes - before) ** 2, dtype=np.float64)))
            history["energy"].append(state.energy())
            turn = state.turn_cameras() if joint else 0.0
            history["change"].append(size)
            monitor(iteration / options.max_iterations)
            if max(size, turn) < options.change:
                reason = "shapes settled"
                break
            np.copyto(before, state.shapes)
        chosen: dict[str, Any] = {
            "neighbours": graph.kind,
            "pieces": graph.pieces(),
            "variation": variation,
            "gamma": gamma,
            "rank": state.rank,
            "joint": joint,
        }
        frames, points = len(problem.tracks), problem.tracks.shape[2]
        shapes = np.ascontiguousarray(state.shapes.T, dtype=np.float64).reshape(frames, 3, points)
        return Solution(shapes, None, iteration, reason, history, chosen, rotations=state.rows if joint else None)


class _Iteration:
    """Shapes as columns (P, 3F), dual variables, cameras; one primal-dual step after another."""

    def __init__(self, problem: Problem, graph: Any, variation: float, gamma: float, options: DvOptions) -> None:
        self.rows = problem.rotations.copy()
        frames, _, points = problem.tracks.shape
        kind = np.dtype(np.float32 if 3 * problem.tracks.size > 2 * _LARGE else np.float64)
        self.tracks: np.ndarray = np.ascontiguousarray(problem.tracks.reshape(2 * frames, points).T, dtype=kind)
        self.threshold = gamma * float(np.sqrt(points))
        operator, owners = gradient(graph)
        self.variation = GraphVariation(operator.astype(kind), owners, variation)
        shapes, dual = _low_rank_start(problem, gamma)
        self.shapes: np.ndarray = np.ascontiguousarray(shapes.T, dtype=kind)
        self.dual: np.ndarray = np.ascontiguousarray(dual.T, dtype=kind)
        self.ahead: np.ndarray = self.shapes.copy()
        self.variation.start(self.shapes)
        self.rank = 0
        # t(σ_p‖D‖² + σ_q) < 1, shared evenly by the two terms.
        self.rise = options.penalty
        self.climb = options.penalty / self.variation.norm2
        self.descent = 0.495 / options.penalty
        self._see()

    def _see(self) -> None:
        """RᵀW as columns and the viewing directions, for the present cameras."""
        frames, points = len(self.rows), len(self.tracks)
        kind = self.tracks.dtype
        seen = self.tracks.reshape(points, frames, 1, 2) @ self.rows.astype(kind)
        self.back = seen.reshape(points, 3 * frames)
        self.axes = np.cross(self.rows[:, 0], self.rows[:, 1]).astype(kind)

    def step(self) -> None:
        """One iteration."""
        self.dual += self.rise * self.ahead
        self.dual -= self._thresholded(self.dual, self.threshold)
        force = self.dual.copy()
        self.variation.ascend(self.ahead, self.climb, force)
        force *= -self.descent
        force += self.shapes
        force += self.descent * self.back
        # (I + t RᵀR)⁻¹ with RᵀR = I − n nᵀ, n the viewing direction.
        blocks = force.reshape(len(force), -1, 3)
        depth = np.einsum("pfi,fi->pf", blocks, self.axes)
        blocks += self.descent * depth[:, :, None] * self.axes
        force /= 1.0 + self.descent
        np.subtract(force, 0.5 * self.shapes, out=self.ahead)
        self.ahead *= 2.0
        self.shapes = force

    def _thresholded(self, columns: np.ndarray, threshold: float) -> np.ndarray:
        """The singular values of S♯ lowered by the threshold; a multiplication of the frames."""
        values, vectors = self._spectrum(columns)
        gain = np.maximum(1.0 - threshold / np.maximum(values, threshold), 0.0)
        self.rank = int(np.count_nonzero(gain))
        mixing = np.kron((vectors * gain) @ vectors.T, np.eye(3)).astype(columns.dtype)
        return columns @ mixing

    def _spectrum(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frames = len(self.rows)
        gram = (columns.T @ columns).reshape(frames, 3, frames, 3).astype(np.float64)
        squares, vectors = np.linalg.eigh(np.einsum("aibi->ab", gram))
        return np.sqrt(np.maximum(squares, 0.0)), vectors

    def energy(self) -> float:
        """The objective."""
        frames, points = len(self.rows), len(self.tracks)
        blocks = self.shapes.reshape(points, frames, 1, 3)
        residual = self.tracks.reshape(points, frames, 1, 2) - blocks @ self.rows.transpose(0, 2, 1).astype(
            self.tracks.dtype
        )
        nuclear = float(self._spectrum(self.shapes)[0].sum())
        data = 0.5 * float(np.sum(residual * residual, dtype=np.float64))
        return data + self.variation.value(self.shapes) + self.threshold * nuclear

    def turn_cameras(self) -> float:
        """R_f ← the two orthonormal rows that best explain W_f from S_f; returns the root mean square of their change.

        Two rows against three columns have no closed form; tr(R C Rᵀ), C = S Sᵀ, is majorised at the current rows,
        which leaves a polar factor (Kiers 1990), and every step lowers the residual.
        """
        frames, points = len(self.rows), len(self.tracks)
        shapes = self.shapes.reshape(points, frames, 3).transpose(1, 2, 0)
        tracks = self.tracks.reshape(points, frames, 2).transpose(1, 2, 0)
        size = (shapes @ shapes.transpose(0, 2, 1)).astype(np.float64)
        cross = (tracks @ shapes.transpose(0, 2, 1)).astype(np.float64)
        bound = np.einsum("fii->f", size)[:, None, None] * np.eye(3) - size
        before = self.rows
        for _ in range(_PROCRUSTES_STEPS):
            left, _, right = np.linalg.svd(cross + self.rows @ bound, full_matrices=False)
            self.rows = left @ right
        self._see()
        return float(np.sqrt(np.mean((self.rows - before) ** 2)))


def _low_rank_start(problem: Problem, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Minimum without total variation, (3F, P), and its dual variable Q, ‖Q‖₂ ≤ γ√P."""
    merged, expand = problem.merged()
    state = LowRankState.start(merged, LowRankOptions(gamma=gamma))

    def iterate(_: int) -> float:
        state.update_shapes()
        state.update_low_rank()
        return state.update_multiplier()

    run_iterations(state, iterate, lambda fraction: None)
    frames = len(problem.tracks)
    shapes, multiplier = (a.reshape(3 * frames, -1) @ expand for a in (state.low_rank, state.multiplier))
    return shapes, -multiplier


def _weights(options: DvOptions, noise: float) -> tuple[float, float]:
    """μ and γ, as told or from the noise."""
    variation = options.variation if options.variation is not None else 1e-5 + 1.5e-3 * noise
    gamma = options.gamma if options.gamma is not None else max(0.005, 1.2 * noise)
    return variation, gamma
