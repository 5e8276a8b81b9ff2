"""Algorithm 2: geometry-aware dense NRSfM.

minimise   ½‖W − RS‖² + β₁‖χ − χC̃‖² + β₂‖S♯‖_* + β₃‖C̃‖_*,   χ = {Θ_iΘ_iᵀ},

with Θ_i the image of the local subspace Φ_i on a Grassmann manifold of lower dimension d̃, by the map Δ that keeps
neighbouring subspaces together. Reconstruction happens on the original manifold, grouping on the lower one.
Source: the paper, Algorithm 2. Departures as in Algorithm 1's file, as is what happens on a device.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.manifolds.grassmann import projection_kernel, similarity_graph
from nrsfm.manifolds.projection import project, reduced_dimension
from nrsfm.manifolds.self_expression import SelfExpression
from nrsfm.methods.base import LowRankState, Monitor, Needs, Problem, Solution, run_iterations, solve_global
from nrsfm.methods.local import SpatialOptions, SpatialSubspaces, default_cells
from nrsfm.options import option


@dataclass(frozen=True)
class GeometryAwareOptions(SpatialOptions):
    """Options of Algorithm 2. Its β₂ is ``gamma``."""

    projection: bool = option(
        True,
        "Group on the lower-dimensional manifold; off groups on the original one (the paper's ablation).",
    )
    tau: float = option(
        0.97,
        "Share of the Grassmann points' energy that the lower dimension keeps.",
        symbol="τ",
        above=0,
        maximum=1,
    )
    lower_dimension: int | None = option(
        None, "Dimension of the lower space. Default: from τ, at least p + 1.", symbol="d̃", minimum=1
    )
    beta1: float = option(1e-3, "Weight of the self-expression.", symbol="β₁", above=0)
    beta3: float = option(1e-4, "Weight of the nuclear norm of C̃.", symbol="β₃", above=0)


class LowerManifold:
    """f_h: Grassmann points of the cells, projected to G(p, d̃)."""

    def __init__(self, spatial: SpatialSubspaces, options: GeometryAwareOptions) -> None:
        self.dimension: int | None = None
        self._spatial, self._options = spatial, options

    def kernel(self, shapes: Any) -> np.ndarray:
        """Γ of the projected points Θ; of the points Φ themselves where the projection is off."""
        points = self._spatial.grassmann_points(shapes)
        if not self._options.projection:
            return projection_kernel(points)
        least = self._spatial.dimension
        if self._options.lower_dimension is not None:
            wanted = max(self._options.lower_dimension, least)
        else:
            # At d̃ = p every Θ_i spans the whole lower space and all subspaces look alike.
            wanted = max(reduced_dimension(points, self._options.tau), least + 1)
        result = project(points, similarity_graph(points), wanted)
        self.dimension = result.dimension
        return projection_kernel(result.points)


class GeometryAware:
    """Algorithm 2."""

    name = "geometry-aware"
    title = "Geometry-aware Grassmannians (Algorithm 2)"
    year = 2019
    summary = "global low rank, with local subspaces of trajectories grouped on a lower-dimensional Grassmann manifold"
    assumes = "surface made of parts that each move in a low-dimensional subspace, like their neighbours"
    cost = "2F²P once; F²N per iteration and F³ per regrouping, N virtual points"
    needs = Needs()
    camera_method = "intersection"
    denoise = True
    on_device = True
    Options = GeometryAwareOptions

    def cells(self, options: GeometryAwareOptions, points: int, frames: int) -> int:
        """K, or one cell where the spatial subspaces are off."""
        return (options.spatial_cells or default_cells(points)) if options.spatial else 1

    def solve(
        self, problem: Problem, options: GeometryAwareOptions, rng: np.random.Generator, monitor: Monitor
    ) -> Solution:
        """The algorithm box, line by line."""
        if not options.spatial:
            return solve_global(problem, options, monitor)
        spatial = SpatialSubspaces(problem, options, rng)
        state = LowRankState.start(spatial.working, options)
        lower = LowerManifold(spatial, options)
        express = SelfExpression(lower.kernel(state.shapes), options.beta1, options.beta3)

        def step(iteration: int) -> float:
            refresh = iteration % options.regroup_every == options.regroup_every - 1
            state.update_shapes()
            if refresh:
                express.kernel = lower.kernel(state.shapes)
            express.update_coefficients(state.beta)
            if refresh:
                spatial.regroup(express.affinity())
            state.shapes = spatial.refine(state.shapes)
            state.update_low_rank()
            express.update_auxiliary(state.beta)
            return state.update_multiplier(express.update_multiplier(state.beta))

        iterations, reason = run_iterations(state, step, monitor)
        chosen = state.chosen() | spatial.chosen() | {"lower_dimension": lower.dimension}
        return Solution(spatial.expand(state.shapes), spatial.groups, iterations, reason, state.history, chosen)
