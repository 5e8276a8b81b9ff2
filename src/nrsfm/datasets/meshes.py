"""Denser versions of a surface: every new point is a fixed mean of old ones, so it moves as they do."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nrsfm.errors import InputError

_MOST_POINTS = 50_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Density:
    """How to get points from vertices: all (``None``), or sparse ``weights`` (P × vertices)."""

    weights: Any
    faces: np.ndarray | None
    n_points: int

    def apply(self, vertices: np.ndarray) -> np.ndarray:
        """Return the points (P, 3) of vertices (V, 3)."""
        return vertices if self.weights is None else self.weights @ vertices


def densify(faces: np.ndarray, n_vertices: int, subdivide: int, points: int | None) -> Density:
    """Return the density asked for.

    ``subdivide`` levels split every triangle into 4 at the midpoints of its sides, and every quad into 4 at
    those and at its centre; nothing is smoothed, so the surface stays where it is. ``points`` asks for an
    exact number: whole levels as far as they go, then new points of the next level, evenly picked (or
    vertices, evenly picked, where fewer are wanted). There are no faces then.

    Raises
    ------
    InputError
        A number is out of range, or both are given.
    """
    for name, value, least in (("subdivide", subdivide, 0), ("points", points, 1)):
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise InputError(f"{name} must be a whole number of at least {least}, received {value!r}")
    if points is not None and subdivide:
        raise InputError(f"subdivide and points cannot both be given, received {subdivide} and {points}")
    if n_vertices * 4**subdivide > _MOST_POINTS or (points or 0) > _MOST_POINTS:
        raise InputError(f"at most {_MOST_POINTS} points are made, received subdivide={subdivide}, points={points}")
    if points is None and subdivide == 0:
        return Density(None, faces, n_vertices)
    from scipy.sparse import eye_array

    weights = eye_array(n_vertices, format="csr")
    if points is not None and points < n_vertices:
        return Density(weights[_evenly(n_vertices, points)], None, points)
    level = 0
    while level < subdivide or points is not None:
        if points is not None and weights.shape[0] == points:
            return Density(weights, faces, points)
        step, finer = _split(faces, weights.shape[0])
        if points is not None and step.shape[0] > points:
            old = weights.shape[0]
            picked = old + _evenly(step.shape[0] - old, points - old)
            rows = np.concatenate([np.arange(old), picked])
            return Density((step[rows] @ weights).tocsr(), None, points)
        weights, faces = (step @ weights).tocsr(), finer
        level += 1
    return Density(weights, faces, weights.shape[0])


def _evenly(count: int, wanted: int) -> np.ndarray:
    """``wanted`` different numbers below ``count``, evenly spread."""
    return np.arange(wanted, dtype=np.int64) * count // max(wanted, 1)


def _split(faces: np.ndarray, count: int) -> tuple[Any, np.ndarray]:
    """One level: the weights (new count × count) and the new faces. Old vertices keep their numbers."""
    from scipy.sparse import csr_array

    corners = faces.shape[1]
    faces = faces.astype(np.int64)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    ends.sort(axis=1)
    keys, inverse = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True)
    edges = np.stack([keys // count, keys % count], axis=1)
    middle = count + inverse.reshape(faces.shape)  # number of the midpoint of side k, from corner k to k + 1
    rows = [np.arange(count), np.repeat(count + np.arange(len(edges)), 2)]
    columns = [np.arange(count), edges.ravel()]
    values = [np.ones(count), np.full(edges.size, 0.5)]
    total = count + len(edges)
    before = np.roll(middle, 1, axis=1)
    if corners == 4:
        centre = total + np.arange(len(faces))
        rows.append(np.repeat(centre, 4))
        columns.append(faces.ravel())
        values.append(np.full(faces.size, 0.25))
        total += len(faces)
        parts = [np.stack([faces[:, k], middle[:, k], centre, before[:, k]], axis=1) for k in range(4)]
    else:
        parts = [np.stack([faces[:, k], middle[:, k], before[:, k]], axis=1) for k in range(3)] + [middle]
    weights = csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(total, count))
    return weights, np.concatenate(parts).astype(np.int32 if total < 2**31 else np.int64)
