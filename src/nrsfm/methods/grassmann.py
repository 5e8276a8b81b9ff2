"""Algorithm 1: dense NRSfM with spatial and temporal Grassmannians.

minimise   ½‖W − RS‖² + γ‖S♯‖_* + λ₁‖L_s − C_sL_s‖² + λ₂‖L_t − C_tL_t‖² + λ₃‖C_s‖_* + λ₄‖C_t‖_*

with L Lᵀ = Γ, Γ_ij = ‖Φ_iᵀΦ_j‖²_F, Φ_s the local subspaces of trajectories (columns of S), Φ_t those of shapes (columns
of S♯), S and S♯ held on them. Source: the paper, Algorithm 1.

Departures, each an option: reweighted nuclear norm; Grassmann points and groups are updated every few iterations;
dimensions and the number of groups follow the noise. A cell keeps its own Grassmann point for grouping, and shares
its group's subspace for reconstruction, so that groups can change again.

Shapes may be on a device: S, S♯ and what is done to them are there; Γ, C and groups, of cells only, are on the host.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.clustering import kmeans
from nrsfm.manifolds.grassmann import projection_kernel
from nrsfm.manifolds.local import ColumnCells, refine_groups
from nrsfm.manifolds.self_expression import SelfExpression
from nrsfm.methods.base import LowRankState, Monitor, Needs, Problem, Solution, run_iterations
from nrsfm.methods.local import SpatialOptions, SpatialSubspaces, default_cells, regrouped
from nrsfm.numerics.arrays import namespace_of, on_host, taken
from nrsfm.options import option

# Singular values of a group of shapes are kept down to this share of σ√(3P). Cutting at the noise itself tears the
# shapes apart: 10 frames, 3% noise, .076 → .100; at a tenth it costs nothing, see docs/decisions.md.
_EDGE = 0.1


@dataclass(frozen=True)
class GrassmannOptions(SpatialOptions):
    """Options of Algorithm 1."""

    temporal: bool = option(True, "Temporal subspaces. Off leaves the spatial ones.")
    temporal_cells: int = option(2, "Cells of frames, each a Grassmann point.", symbol="K_t", minimum=1)
    temporal_kind: str = option(
        "consecutive",
        "How frames are put into cells: runs of consecutive frames, or k-means++ on the shapes.",
        choices=("consecutive", "kmeans"),
    )
    temporal_dimension: int | None = option(
        None,
        "Dimension of the temporal subspaces. Default: in each iteration the number of singular values of the group's "
        "shapes above a tenth of the noise; none is cut where there is no noise.",
        symbol="p_t",
        minimum=1,
    )
    temporal_groups: int | None = option(
        None,
        "Groups that the cells of frames are merged into. Default: from the largest eigengap.",
        minimum=1,
    )
    lambda1: float = option(1e-3, "Weight of the spatial self-expression.", symbol="λ₁", above=0)
    lambda2: float = option(1e-3, "Weight of the temporal self-expression.", symbol="λ₂", above=0)
    lambda3: float = option(1e-4, "Weight of the nuclear norm of C_s.", symbol="λ₃", above=0)
    lambda4: float = option(1e-4, "Weight of the nuclear norm of C_t.", symbol="λ₄", above=0)


class TemporalSubspaces:
    """Cells of frames, their groups, and the rank-p refinement of each group's shapes."""

    def __init__(self, state: LowRankState, options: GrassmannOptions, rng: np.random.Generator) -> None:
        shapes, problem = state.low_rank, state.problem
        frames = shapes.shape[0]
        count = min(options.temporal_cells, frames)
        if options.temporal_kind == "consecutive":
            labels = np.arange(frames) * count // frames
        else:
            labels = kmeans(on_host(shapes).reshape(frames, -1), count, rng)
        self._labels = labels
        self._order = np.argsort(labels, kind="stable")
        self._inverse = np.argsort(self._order)
        self.cells = ColumnCells(np.concatenate([[0], np.cumsum(np.bincount(labels))]))
        self._options, self._rng = options, rng
        smallest = int(np.diff(self.cells.offsets).min())
        self.dimension = min(options.temporal_dimension or 3, smallest)
        self._edge = _EDGE * problem.noise * np.sqrt(3.0 * problem.points)
        self._set_groups(np.arange(len(self.cells)))

    def _set_groups(self, groups: np.ndarray) -> None:
        self.groups = groups
        self._columns = self.cells.columns_of_groups(groups)

    def _matrix(self, shapes: Any) -> Any:
        """S♯ (3N, F) with the columns of each cell side by side."""
        return taken(namespace_of(shapes).reshape(shapes, (shapes.shape[0], -1)), self._order, 0).T

    def grassmann_points(self, shapes: Any) -> np.ndarray:
        """Φ_t (K_t, 3N, p_t), on the host."""
        # Not completed: fixed directions among virtual points are not those among the real ones.
        return on_host(self.cells.points(self._matrix(shapes), self.dimension, complete=False))

    def refine(self, shapes: Any) -> Any:
        """S♯ with every group of frames brought to rank p_t."""
        if self._options.temporal_dimension is None and self._edge == 0:
            return shapes
        dimensions = [self._options.temporal_dimension] * len(self._columns)
        refined = refine_groups(self._matrix(shapes), self._columns, dimensions, self._edge)
        return namespace_of(refined).reshape(taken(refined.T, self._inverse, 0), shapes.shape)

    def chosen(self) -> dict[str, Any]:
        """The frames at which another group begins."""
        labels = self.groups[self._labels]
        return {"temporal_borders": (np.flatnonzero(np.diff(labels)) + 1).tolist()}

    def regroup(self, affinity: np.ndarray) -> None:
        """Regroup the cells of frames; they must be three or more."""
        if self._options.grouping and len(self.cells) > 2:
            self._set_groups(regrouped(self.groups, affinity, self._rng, self._options.temporal_groups))


class _SelfExpressed:
    """Subspaces of one side (space or time) with their self-expression: lines 2–5 and 7–10 of the box, then 11–16.

    Without subspaces (the side is switched off) every step does nothing.
    """

    def __init__(
        self,
        subspaces: SpatialSubspaces | TemporalSubspaces | None,
        shapes: Any,
        weight: float,
        nuclear_weight: float,
    ) -> None:
        self._subspaces = subspaces
        kernel = np.eye(1) if subspaces is None else projection_kernel(subspaces.grassmann_points(shapes))
        self._express = SelfExpression(kernel, weight, nuclear_weight)

    def update(self, shapes: Any, beta: float, refresh: bool) -> Any:
        """C, then Γ of the new Grassmann points, then the refined shapes, then J."""
        if self._subspaces is None:
            return shapes
        self._express.update_coefficients(beta)
        if refresh:
            self._express.kernel = projection_kernel(self._subspaces.grassmann_points(shapes))
        refined = self._subspaces.refine(shapes)
        self._express.update_auxiliary(beta)
        return refined

    def finish(self, beta: float, refresh: bool) -> float:
        """Groups and multiplier; returns the gap between C and J."""
        if self._subspaces is None:
            return 0.0
        if refresh:
            self._subspaces.regroup(self._express.affinity())
        return self._express.update_multiplier(beta)


class Grassmann:
    """Algorithm 1."""

    name = "grassmann"
    title = "Spatial-temporal Grassmannians (Algorithm 1)"
    year = 2018
    summary = "global low rank, with local subspaces of trajectories and of shapes grouped on Grassmann manifolds"
    assumes = "surface made of parts that each move in a low-dimensional subspace"
    cost = "2F²P once; F²N + K_s²F per iteration, N virtual points"
    needs = Needs()
    camera_method = "intersection"
    denoise = True
    on_device = True
    Options = GrassmannOptions

    def cells(self, options: GrassmannOptions, points: int, frames: int) -> int:
        """K_s, or one cell where the spatial subspaces are off."""
        return (options.spatial_cells or default_cells(points)) if options.spatial else 1

    def solve(
        self, problem: Problem, options: GrassmannOptions, rng: np.random.Generator, monitor: Monitor
    ) -> Solution:
        """The algorithm box, line by line."""
        spatial = SpatialSubspaces(problem, options, rng) if options.spatial else None
        state = LowRankState.start(problem if spatial is None else spatial.working, options)
        temporal = TemporalSubspaces(state, options, rng) if options.temporal else None
        in_space = _SelfExpressed(spatial, state.shapes, options.lambda1, options.lambda3)
        in_time = _SelfExpressed(temporal, state.low_rank, options.lambda2, options.lambda4)

        def step(iteration: int) -> float:
            refresh = iteration % options.regroup_every == options.regroup_every - 1
            state.update_shapes()
            state.shapes = in_space.update(state.shapes, state.beta, refresh)
            state.update_low_rank()
            state.low_rank = in_time.update(state.low_rank, state.beta, refresh)
            gap = max(in_space.finish(state.beta, refresh), in_time.finish(state.beta, refresh))
            return state.update_multiplier(gap)

        iterations, reason = run_iterations(state, step, monitor)
        chosen = state.chosen() | (temporal.chosen() if temporal else {})
        if spatial is None:
            return Solution(state.shapes, None, iterations, reason, state.history, chosen)
        chosen |= spatial.chosen()
        return Solution(spatial.expand(state.shapes), spatial.groups, iterations, reason, state.history, chosen)
