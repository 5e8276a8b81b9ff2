"""What Algorithms 1 and 2 share on the spatial side: cells, groups of cells, their subspaces, their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.clustering import spectral_groups
from nrsfm.manifolds.local import ColumnCells, refine_groups, signal_rank
from nrsfm.methods.base import LowRankOptions, Problem, cut_by
from nrsfm.numerics.arrays import namespace_of, on_host
from nrsfm.options import option

LONG = 500
"""Frames above which merged cells are cut to the directions that hold more than ``MERGED``."""

MERGED = 1e-5
"""Root mean square of a coordinate, in units of the tracks' own, that cut directions may hold together: a tenth of what
the compression may cut."""


@dataclass(frozen=True)
class SpatialOptions(LowRankOptions):
    """Options of the spatial subspaces, beside those of the global low-rank model."""

    reweight: float = option(
        0.01,
        "Reweighting ε of the nuclear norm: σ is thresholded by τ·εσ₁/(σ + εσ₁), so that large singular values are "
        "hardly shrunk. 0 is the plain norm of the paper.",
        symbol="ε",
        minimum=0,
    )
    spatial: bool = option(True, "Spatial subspaces. Off leaves the global low-rank model.")
    spatial_cells: int | None = option(
        None,
        "k-means++ cells of points, each a Grassmann point. Default: one per 300 points, at least 2 and at most 50.",
        symbol="K_s",
        minimum=1,
    )
    spatial_dimension: int | None = option(
        None,
        "Dimension of the subspaces. Default: for each group the number of singular directions of its tracks that "
        "stand above the noise; for the Grassmann points that are compared, the least of them, at most 6.",
        symbol="p",
        minimum=1,
    )
    grouping: bool = option(True, "Spectral grouping of the cells; off keeps each cell a group of its own.")
    spatial_groups: int | None = option(
        None,
        "Groups that the cells are merged into. Default: from the largest eigengap between a fifth and a half of the "
        "cells.",
        minimum=1,
    )
    regroup_every: int = option(
        10, "Iterations between updates of Grassmann points, Γ and groups; 1 is the paper's.", minimum=1
    )


def default_cells(points: int) -> int:
    """One cell per 300 points, at least 2, at most 50."""
    return int(np.clip(round(points / 300), 2, 50))


def regrouped(
    groups: np.ndarray,
    affinity: np.ndarray,
    rng: np.random.Generator,
    count: int | None,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """P ← f_p(ξ, C, P): spectral groups, or the old ones where the affinity (still) tells nothing apart.

    It does so by putting all into one group that was not asked for.
    """
    found = spectral_groups(affinity, rng, count, span)
    return found if found.max() > 0 or count is not None else groups


class SpatialSubspaces:
    """The cells, their current groups, and the rank-p refinement of each group.

    Where nothing would be truncated (no noise, no dimension asked for) all columns are treated alike, and the
    iteration runs on ``working``, the problem with all cells merged, which is smaller and has the same answer.
    """

    def __init__(self, problem: Problem, options: SpatialOptions, rng: np.random.Generator) -> None:
        self.cells = ColumnCells(problem.offsets)
        self._problem, self._options, self._rng = problem, options, rng
        self._tracks = on_host(problem.tracks).reshape(-1, problem.tracks.shape[2])
        chosen = options.spatial_dimension
        self.truncates = problem.noise > 0 or chosen is not None
        self.working, self.cut = problem, 0.0
        self._back: Any = None
        if not self.truncates:
            self.working, self._back = problem.merged(MERGED if problem.tracks.shape[0] > LONG else 0.0)
            self.cut = cut_by(problem, self.working)
        narrowest = int(np.diff(problem.offsets).min())
        self.dimension = int(np.clip(narrowest, 1, 6)) if chosen is None else chosen
        self.dimension = min(self.dimension, 3 * problem.tracks.shape[0])
        self._set_groups(np.arange(len(self.cells)))

    def _set_groups(self, groups: np.ndarray) -> None:
        self.groups = groups
        if not self.truncates:
            self.dimensions: list[int | None] = [None] * (int(groups.max()) + 1)
            return
        self._columns = self.cells.columns_of_groups(groups)
        if self._options.spatial_dimension is not None:
            self.dimensions = [self._options.spatial_dimension] * len(self._columns)
        else:
            sizes = np.bincount(groups, weights=self._problem.sizes)
            self.dimensions = [
                signal_rank(self._tracks[:, c], int(size), self._problem.noise)
                for c, size in zip(self._columns, sizes, strict=True)
            ]

    def grassmann_points(self, shapes: Any) -> np.ndarray:
        """Φ (K, 3F, p) of the cells of S (F, 3, N), on the host: f_g."""
        return on_host(self.cells.points(_flat(self.expand(shapes)), self.dimension))

    def expand(self, shapes: Any) -> Any:
        """Shapes of the working problem to shapes of the cells' columns."""
        return shapes if self.truncates else shapes @ self._back

    def refine(self, shapes: Any) -> Any:
        """S with every group's columns brought to rank p: f_s."""
        if not self.truncates:
            return shapes
        refined = refine_groups(_flat(shapes), self._columns, self.dimensions)
        return namespace_of(refined).reshape(refined, shapes.shape)

    def chosen(self) -> dict[str, Any]:
        """What was chosen from the data: cells, groups and dimensions."""
        return {
            "spatial_cells": len(self.cells),
            "spatial_groups": int(self.groups.max()) + 1,
            "spatial_dimensions": self.dimensions,
            "grassmann_dimension": self.dimension,
            "directions": self.working.tracks.shape[2],
            "cut": self.cut,
        }

    def regroup(self, affinity: np.ndarray) -> None:
        """Regroup the cells of points; they must be three or more."""
        cells = len(self.cells)
        if not self._options.grouping or cells < 3:
            return
        span = (max(2, cells // 5), max(2, cells // 2))
        groups = regrouped(self.groups, affinity, self._rng, self._options.spatial_groups, span)
        if not np.array_equal(groups, self.groups):
            self._set_groups(groups)


def _flat(shapes: Any) -> Any:
    """S (3F, N) of shapes (F, 3, N)."""
    return namespace_of(shapes).reshape(shapes, (3 * shapes.shape[0], -1))
