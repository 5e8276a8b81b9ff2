"""DS: spatial and temporal smoothness, and a robust data term.

    minimise over S   Σ_f Σ_p ρ(|w_fp − R_f s_fp|) + (λ_t/2) ‖H S‖²_F + (λ_s/2) ‖S 𝓛ᵀ‖²_F

H takes differences of consecutive frames, 𝓛 is the Laplacian of the graph of neighbours, ρ is Huber's function:
r²/2 up to δ, δr − δ²/2 beyond.

Source: Dai, Deng and He, "Dense non-rigid structure-from-motion made easy: a spatial-temporal smoothness based
solution", ICIP 2017. Rotations are those of Dai, Li and He's intersection method.

Departures. (1) Their data term is an L1 norm of the coordinates, solved by a series of least squares problems. Here
ρ(r) = min over e of |r − e|²/2 + δ|e|, an additive outlier e_fp for every point and frame: the same behaviour on
outliers, a threshold that follows the noise, no dependence on how the image is turned, and a system matrix that never
changes. Given the outliers the normal equations are a Sylvester equation,

    (RᵀR + λ_t HᵀH) S + λ_s S 𝓛ᵀ𝓛 = Rᵀ(W − E),

which needs a few sparse factorisations, once (:mod:`nrsfm.numerics.sylvester`). What is left is a proximal gradient
iteration on E with step 1, accelerated and restarted. (2) A mesh or nearest tracks may take the place of the grid,
and 𝓛 is scaled so that λ_s means the same for any number of points (:mod:`nrsfm.neighbours`). (3) The weights are
ours, from measurement, and H is of first order by default.

It needs every point: 𝓛 mixes the columns of S, which the exact compression does not preserve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.neighbours import NeighbourOptions, find_neighbours, laplacian
from nrsfm.numerics.sylvester import Sylvester
from nrsfm.options import option

_LEAST_DELTA = 0.1  # some 3 pixels on an object of 100: less than that is deformation, not a wrong track


@dataclass(frozen=True)
class DsOptions(NeighbourOptions):
    """Options of the spatial and temporal smoothness."""

    temporal_weight: float | None = option(
        None,
        "Weight of the squared change of a point from frame to frame, in units in which the tracks have rms 1. "
        "Default: the larger of 2 and 80 × the noise level.",
        symbol="λ_t",
        above=0,
    )
    differences: int = option(1, "Order of the differences over frames.", minimum=1, maximum=2)
    spatial_weight: float | None = option(
        None,
        "Weight of the squared Laplacian, in units in which the tracks have rms 1. Default: 1e-9 + 2e-5 × the square "
        "of the noise level.",
        symbol="λ_s",
        minimum=0,
    )
    huber: float | None = option(
        None,
        "Length of a residual beyond which its cost grows linearly, in units of the tracks' rms. Default: the "
        "larger of 0.1 and 3 × the noise level.",
        symbol="δ",
        above=0,
    )
    change: float = option(
        1e-4,
        "Stop when the root mean square change of the outliers, in units of the tracks' rms, is below this.",
        above=0,
    )
    max_iterations: int = option(30, "Upper bound on iterations.", minimum=1)


class Ds:
    """Smooth in space and time, robust to outliers."""

    name = "ds"
    title = "Dense, smooth in space and time"
    year = 2017
    summary = "smoothness over frames and over neighbours, with a robust data term"
    assumes = "points move smoothly over time and like their neighbours; cameras that turn"
    cost = "F³ + F²P, and a few sparse factorisations of P×P, once; F²P + F·P log P per iteration"
    needs = Needs(frame_order=True, every_point=True, neighbours=True)
    camera_method = "intersection"
    denoise = False
    Options = DsOptions

    def cells(self, options: DsOptions, points: int, frames: int) -> int:
        """One: the points themselves."""
        return 1

    def solve(self, problem: Problem, options: DsOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Solve the Sylvester equation for shapes and shrink residuals to outliers, in turn."""
        tracks, rows = problem.tracks, problem.rotations
        graph = find_neighbours(tracks, options, problem.noise)
        smooth = laplacian(graph)
        temporal, spatial = _weights(options, problem.noise)
        observed, roughness = normal_matrices(rows, options.differences)
        system = Sylvester(observed + temporal * roughness, spatial * (smooth.T @ smooth))
        backward = rows.transpose(0, 2, 1)
        frames, _, points = tracks.shape

        def fit(outliers: np.ndarray, start: np.ndarray | None) -> np.ndarray:
            constant = (backward @ (tracks - outliers)).reshape(3 * frames, points)
            return system.solve(constant, start, min(1e-6, 0.01 * options.change))

        flat = fit(np.zeros(1), None)
        monitor(0.2)
        residual = tracks - rows @ flat.reshape(frames, 3, points)
        delta = options.huber if options.huber is not None else max(_LEAST_DELTA, 3.0 * problem.noise)
        history: dict[str, list[float]] = {"energy": [], "change": []}
        outliers, ahead, momentum = np.zeros_like(tracks), np.zeros_like(tracks), 1.0
        reason = "iteration limit"
        for iteration in range(1, options.max_iterations + 1):
            found = _shrink(residual, delta)
            change = found - outliers
            size = float(np.sqrt(np.mean(change * change)))
            history["energy"].append(
                _data_cost(residual, delta) + _roughness_cost(flat, temporal * roughness, spatial, smooth)
            )
            history["change"].append(size)
            monitor(0.2 + 0.8 * iteration / options.max_iterations)
            if size < options.change:
                reason = "outliers settled"
                break
            # Nesterov's momentum, dropped where it points uphill (O'Donoghue and Candès 2015).
            uphill = float(np.sum((ahead - found) * change)) > 0
            following = 1.0 if uphill else 0.5 * (1.0 + float(np.sqrt(1.0 + 4.0 * momentum**2)))
            ahead = found + (0.0 if uphill else (momentum - 1.0) / following) * change
            momentum, outliers = following, found
            flat = fit(ahead, flat)
            residual = tracks - rows @ flat.reshape(frames, 3, points)
        chosen: dict[str, Any] = {
            "neighbours": graph.kind,
            "pieces": graph.pieces(),
            "temporal_weight": temporal,
            "spatial_weight": spatial,
            "huber": delta,
            "outliers": float(np.mean(np.linalg.norm(outliers, axis=1) > 0)),
        }
        return Solution(flat.reshape(frames, 3, points), None, iteration, reason, history, chosen)


def normal_matrices(rows: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """RᵀR and HᵀH ⊗ I₃, both (3F, 3F), for rotations (F, 2, 3) and differences of that order over frames."""
    frames = len(rows)
    observed = np.zeros((frames, 3, frames, 3))
    index = np.arange(frames)
    observed[index, :, index] = rows.transpose(0, 2, 1) @ rows
    differences = np.diff(np.eye(frames), n=order, axis=0)
    return observed.reshape(3 * frames, -1), np.kron(differences.T @ differences, np.eye(3))


def _weights(options: DsOptions, noise: float) -> tuple[float, float]:
    """λ_t and λ_s, as told or from the noise."""
    temporal = options.temporal_weight if options.temporal_weight is not None else max(2.0, 80.0 * noise)
    spatial = options.spatial_weight if options.spatial_weight is not None else 1e-9 + 2e-5 * noise**2
    return temporal, spatial


def _shrink(residual: np.ndarray, delta: float) -> np.ndarray:
    """The outliers e_fp that minimise |r − e|²/2 + δ|e|: residual vectors (F, 2, P), shortened by δ or to nothing."""
    length = np.linalg.norm(residual, axis=1, keepdims=True)
    return residual * np.maximum(1.0 - delta / np.maximum(length, delta), 0.0)


def _data_cost(residual: np.ndarray, delta: float) -> float:
    """Σ ρ(|r_fp|) of residuals (F, 2, P)."""
    squares = np.sum(residual * residual, axis=1)
    return float(np.sum(np.where(squares <= delta**2, 0.5 * squares, delta * np.sqrt(squares) - 0.5 * delta**2)))


def _roughness_cost(flat: np.ndarray, temporal: np.ndarray, spatial: float, smooth: Any) -> float:
    """½ tr(SᵀTS) + (λ_s/2)‖S𝓛ᵀ‖² of shapes (3F, P)."""
    return 0.5 * float(np.sum(flat * (temporal @ flat))) + 0.5 * spatial * float(np.sum((smooth @ flat.T) ** 2))
