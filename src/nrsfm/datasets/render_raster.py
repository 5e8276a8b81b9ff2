"""Triangles to samples, and points to hidden or seen: the geometry of the test renderer.

Ours. Both functions walk over (triangle, row) pairs. :func:`rasterise` cuts each triangle with each row of samples
and lists what lies between the two ends, so that no sample outside is ever looked at; :func:`hidden` keeps the
asked points sorted row by row, where the candidates of a (triangle, row) pair are one contiguous run, and tests the
points themselves. Visibility is thus exact: it does not depend on the resolution of a depth buffer.

Sample (i, j) of a grid has its centre at x = j, y = i. Barycentric weights are those of the object's triangle:
under perspective, weights λ in the image become λ_k / z_k, normalised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_EDGE = 1e-7  # samples on a shared edge belong to both triangles, never to none


class Fragments(NamedTuple):
    """The surface element nearest to the camera in each covered sample."""

    pixel: np.ndarray
    """(N,) flat index of the sample, row by row, ascending."""
    triangle: np.ndarray
    """(N,) number of the triangle."""
    weights: np.ndarray
    """(N, 3) barycentric weights of its corners, float64."""


class _Planes(NamedTuple):
    """Weight k of triangle m at (x, y) is a·(x − x0) + b·(y − y0) + c, with the triangle's first corner (x0, y0)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    x0: np.ndarray
    y0: np.ndarray
    area: np.ndarray


def _planes(corners: np.ndarray) -> _Planes:
    """Linear functions of the weights, for corners (M, 3, 2); degenerate triangles get area 0."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    # Twice the area of a triangle with these two sides, were they at right angles, to within a factor of 2.
    sides = np.abs(first[:, 0]) + np.abs(first[:, 1]), np.abs(second[:, 0]) + np.abs(second[:, 1])
    area = np.where(np.abs(area) > 1e-12 * sides[0] * sides[1], area, 0.0)
    inverse = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    a = np.empty((len(corners), 3))
    b = np.empty_like(a)
    a[:, 1], b[:, 1] = second[:, 1] * inverse, -second[:, 0] * inverse
    a[:, 2], b[:, 2] = -first[:, 1] * inverse, first[:, 0] * inverse
    a[:, 0], b[:, 0] = -a[:, 1] - a[:, 2], -b[:, 1] - b[:, 2]
    c = np.zeros_like(a)
    c[:, 0] = 1.0
    return _Planes(a, b, c, corners[:, 0, 0].copy(), corners[:, 0, 1].copy(), area)


def facing(xy: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return twice the signed area (M,) of each triangle in the image; its sign tells which side is seen."""
    corners = xy[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area: np.ndarray = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return area


def _least(values: np.ndarray) -> np.ndarray:
    """Least of three along axis 1; NumPy's reduction over so short an axis takes ten times as long."""
    least: np.ndarray = np.minimum(np.minimum(values[:, 0], values[:, 1]), values[:, 2])
    return least


def _most(values: np.ndarray) -> np.ndarray:
    most: np.ndarray = np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])
    return most


def _expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For runs of given lengths: the run of each element and its place in the run."""
    run = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(run)) - np.repeat(np.cumsum(counts) - counts, counts)
    return run, place


def _rows(corners: np.ndarray, chosen: np.ndarray, height: int, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """(triangle, row) pairs: every row of samples (widened by ``margin``) that a chosen triangle reaches."""
    low = np.maximum(np.ceil(_least(corners[:, :, 1]) - margin), 0)
    high = np.minimum(np.floor(_most(corners[:, :, 1]) + margin), height - 1)
    counts = np.where(chosen, np.maximum(high - low + 1, 0), 0).astype(np.int64)
    triangle, place = _expand(counts)
    return triangle, low.astype(np.int64)[triangle] + place


def _object_weights(weights: np.ndarray, depths: np.ndarray, perspective: bool) -> np.ndarray:
    if not perspective:
        return weights
    weights = weights / depths
    weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
    return weights


def rasterise(
    xy: np.ndarray, depth: np.ndarray, faces: np.ndarray, width: int, height: int, *, perspective: bool = False
) -> Fragments:
    """Return what a camera sees at each sample of a grid of ``height`` × ``width``.

    Parameters
    ----------
    xy, depth
        (P, 2) positions in samples and (P,) depths, growing away from the camera, of the vertices.
    faces
        (M, 3) triangles. Both sides are seen; see :func:`facing`.
    width, height
        Size of the grid.
    perspective
        Whether ``xy`` came from a division by ``depth``.
    """
    corners = xy[faces]
    plane = _planes(corners)
    triangle, y = _rows(corners, plane.area != 0, height, _EDGE)
    # Each weight must be at least 0: one bound of x from every edge, from the left where the weight grows with x.
    a = plane.a[triangle]
    rest = plane.b[triangle] * (y - plane.y0[triangle])[:, None] + plane.c[triangle] + _EDGE
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = -rest / a
    left = _most(np.where(a > 0, bound, -np.inf))
    right = _least(np.where(a < 0, bound, np.inf))
    empty = _least(np.where(a == 0, rest, 0.0)) < 0
    start = np.maximum(np.ceil(left + plane.x0[triangle]), 0)
    stop = np.minimum(np.floor(right + plane.x0[triangle]), width - 1)
    counts = np.where(empty, 0, np.maximum(stop - start + 1, 0)).astype(np.int64)
    run, place = _expand(counts)
    x = start.astype(np.int64)[run] + place
    pixel = y[run] * width + x
    triangle = triangle[run]
    dx, dy = x - plane.x0[triangle], y[run] - plane.y0[triangle]
    weights = plane.a[triangle] * dx[:, None] + plane.b[triangle] * dy[:, None] + plane.c[triangle]
    depths = depth[faces[triangle]]
    weights = _object_weights(weights, depths, perspective)
    front = _nearest(pixel, np.einsum("nk,nk->n", weights, depths), width * height)
    return Fragments(pixel[front], triangle[front], weights[front])


def _nearest(pixel: np.ndarray, depth: np.ndarray, count: int) -> np.ndarray:
    """Of the fragments in each sample the index of the nearest, by rising sample."""
    holder = np.full(count, -1, dtype=np.int64)
    alive = np.arange(len(pixel))
    # Every round some fragment takes each contested sample, and only what is nearer stays in the contest: as many
    # rounds as surfaces lie behind each other, and the set shrinks fast.
    while len(alive):
        holder[pixel[alive]] = alive
        alive = alive[depth[alive] < depth[holder[pixel[alive]]]]
    return holder[holder >= 0]


def hidden(
    points: np.ndarray,
    depths: np.ndarray,
    own: np.ndarray,
    xy: np.ndarray,
    depth: np.ndarray,
    faces: np.ndarray,
    *,
    tolerance: float,
    perspective: bool = False,
) -> np.ndarray:
    """Return which points (N,) bool of the surface lie behind another part of it.

    Parameters
    ----------
    points, depths
        (N, 2) image positions and (N,) depths of the asked points; those that are not finite count as hidden.
    own
        (N,) triangle on which each point lies.
    xy, depth, faces, perspective
        The surface, as in :func:`rasterise`.
    tolerance
        What lies less than this in front hides nothing: neighbours share edges.
    """
    result = ~np.isfinite(points).all(axis=1)
    asked = np.flatnonzero(~result)
    if not len(asked) or not len(faces):
        return result
    low = np.floor(points[asked].min(axis=0))
    cell = (np.floor(points[asked]) - low).astype(np.int64)
    width, height = (int(n) + 1 for n in cell.max(axis=0))
    flat = cell[:, 1] * width + cell[:, 0]
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(width * height + 1))
    asked = asked[order]
    corners = xy[faces] - low
    plane = _planes(corners)
    left = np.clip(np.floor(_least(corners[:, :, 0])), -1, width).astype(np.int64)
    right = np.clip(np.floor(_most(corners[:, :, 0])), -1, width).astype(np.int64)
    # Cell row i spans y from i to i + 1.
    floored = np.floor(corners)
    triangle, y = _rows(floored, (plane.area != 0) & (right >= 0) & (left < width), height, 0.0)
    start = first[y * width + np.maximum(left[triangle], 0)]
    stop = first[y * width + np.minimum(right[triangle], width - 1) + 1]
    run, place = _expand(np.maximum(stop - start, 0))
    point, triangle = asked[start[run] + place], triangle[run]
    other = own[point] != triangle
    point, triangle = point[other], triangle[other]
    dx = points[point, 0] - low[0] - plane.x0[triangle]
    dy = points[point, 1] - low[1] - plane.y0[triangle]
    weights = plane.a[triangle] * dx[:, None] + plane.b[triangle] * dy[:, None] + plane.c[triangle]
    inside = _least(weights) >= -_EDGE
    point, corner_depths = point[inside], depth[faces[triangle[inside]]]
    weights = _object_weights(weights[inside], corner_depths, perspective)
    before = np.einsum("nk,nk->n", weights, corner_depths) < depths[point] - tolerance
    result[point[before]] = True
    return result
