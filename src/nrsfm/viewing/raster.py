"""A small depth-buffered rasteriser: triangles or discs in, one surface element per pixel out.

Drawing 60,000 triangles as vector polygons takes matplotlib seconds per panel and leaves seams between them;
filling pixels with array operations takes a tenth of a second and lets normals and colours be interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Hits(NamedTuple):
    """What the viewer sees: the covered pixels, and the surface element nearest to the viewer in each."""

    pixels: np.ndarray
    """(N,) flat index of each covered pixel, row by row."""
    element: np.ndarray
    """(N,) triangle or disc seen there."""
    weights: np.ndarray
    """(N, 3) barycentric weights of the triangle's corners; for discs (dx, dy, 0) in units of the radius."""


def _nearest(pixels: np.ndarray, depth: np.ndarray, count: int) -> np.ndarray:
    """Index of the fragment nearest to the viewer in each covered pixel."""
    order = np.argsort(-depth)
    front = np.full(count, -1, dtype=np.int64)
    # Of repeated indices NumPy keeps the last one assigned: the nearest, because the far ones come first.
    front[pixels[order]] = order
    return front[front >= 0]


def _gather(parts: Sequence[tuple[np.ndarray, ...]], width: int, height: int) -> Hits:
    if not parts:
        empty = np.zeros(0, dtype=np.int64)
        return Hits(empty, empty, np.zeros((0, 3), dtype=np.float32))
    pixels, depth, element, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    front = _nearest(pixels, depth, width * height)
    return Hits(pixels[front], element[front], weights[front])


def rasterise_triangles(xy: np.ndarray, depth: np.ndarray, triangles: np.ndarray, width: int, height: int) -> Hits:
    """Fill triangles; xy (N, 2) in pixels (x right, y down), depth (N,) grows away from the viewer."""
    corners = np.asarray(xy, dtype=np.float32)[triangles]
    depths = np.asarray(depth, dtype=np.float32)[triangles]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    low = np.clip(np.ceil(np.minimum(np.minimum(a, b), c) - 0.5), 0, (width, height)).astype(np.int32)
    high = np.clip(np.floor(np.maximum(np.maximum(a, b), c) - 0.5) + 1, 0, (width, height)).astype(np.int32)
    extent = high - low
    first, second = b - a, c - a
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    visible = (extent > 0).all(axis=1) & (np.abs(area) > 1e-12)
    size = extent.max(axis=1)
    parts = []
    side = 1
    while visible.any():
        # Triangles of similar size share one square stamp of candidate pixels.
        batch = np.flatnonzero(visible & (size <= side))
        visible[batch] = False
        step = max(1, 4_000_000 // (side * side))
        for start in range(0, len(batch), step):
            part = _stamp(batch[start : start + step], side, corners, depths, area, low, width, height)
            if part is not None:
                parts.append(part)
        side = side + 1 if side < 6 else int(side * 1.5)
    return _gather(parts, width, height)


def _stamp(
    batch: np.ndarray,
    side: int,
    corners: np.ndarray,
    depths: np.ndarray,
    area: np.ndarray,
    low: np.ndarray,
    width: int,
    height: int,
) -> tuple[np.ndarray, ...] | None:
    step_y, step_x = np.divmod(np.arange(side * side, dtype=np.int32), np.int32(side))
    x = low[batch, 0, None] + step_x
    y = low[batch, 1, None] + step_y
    a, b, c = corners[batch, 0], corners[batch, 1], corners[batch, 2]
    inverse = 1.0 / area[batch]
    half = np.float32(0.5)
    px, py = x.astype(np.float32) + half - a[:, :1], y.astype(np.float32) + half - a[:, 1:]
    e1, e2 = (b - a) * inverse[:, None], (c - a) * inverse[:, None]
    v = px * e2[:, 1:] - py * e2[:, :1]
    w = py * e1[:, :1] - px * e1[:, 1:]
    u = 1.0 - v - w
    slack = np.float32(-1e-5)  # pixels on a shared edge belong to both triangles, never to none
    inside = (np.minimum(np.minimum(u, v), w) >= slack) & (x < width) & (y < height)
    row, _ = np.nonzero(inside)
    if not len(row):
        return None
    weights = np.stack([u[inside], v[inside], w[inside]], axis=1)
    deep = np.einsum("nk,nk->n", weights, depths[batch[row]])
    return y[inside] * width + x[inside], deep, batch[row], weights


def rasterise_discs(xy: np.ndarray, depth: np.ndarray, radius: np.ndarray, width: int, height: int) -> Hits:
    """Fill one disc per point, ``radius`` (N,) in pixels; the rest as in :func:`rasterise_triangles`."""
    reaches = np.ceil(radius).astype(np.int64)
    parts = []
    for reach in np.unique(reaches):
        group = np.flatnonzero(reaches == reach)
        base = np.floor(xy[group]).astype(np.int64)
        offset_y, offset_x = np.divmod(np.arange((2 * reach + 1) ** 2), 2 * reach + 1)
        for dx, dy in zip(offset_x - reach, offset_y - reach, strict=True):
            x, y = base[:, 0] + dx, base[:, 1] + dy
            away = (np.stack([x, y], axis=1) + 0.5 - xy[group]) / radius[group, None]
            inside = (np.einsum("nk,nk->n", away, away) <= 1.0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
            kept = np.flatnonzero(inside)
            if len(kept):
                weights = np.zeros((len(kept), 3), dtype=np.float32)
                weights[:, :2] = away[kept]
                parts.append((y[kept] * width + x[kept], depth[group[kept]], group[kept], weights))
    return _gather(parts, width, height)
