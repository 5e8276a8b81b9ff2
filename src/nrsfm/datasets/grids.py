"""Regular grids with exactly as many nodes as asked for, and the triangles between them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def trimmed_grid(
    points: int,
    reach: tuple[float, float],
    centre: tuple[float, float],
    outline: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    area: float,
    smooth: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exactly ``points`` nodes of a square grid, those least far out, and the triangles between them.

    ``outline`` measures how far out a node lies (1: on the edge); the grid covers centre ± reach. ``smooth``
    moves the outermost nodes outwards, onto one level of the outline.
    """
    spacing = np.sqrt(area / points)
    while True:
        axes = []
        for half, middle in zip(reach, centre, strict=True):
            count = int(np.ceil(half / spacing)) + 1
            axes.append(middle + spacing * (np.arange(2 * count) - count + 0.5))
        if len(axes[0]) * len(axes[1]) >= points:
            break
        spacing *= 0.9
    # Rows from the top down. Diagonals mirror each other, as the two halves of a face do.
    u, v = np.meshgrid(axes[0], axes[1][::-1])
    order = np.argsort(outline(u.ravel(), v.ravel()), kind="stable")
    kept = np.sort(order[:points])
    number = np.full(u.size, -1, dtype=np.int64)
    number[kept] = np.arange(points)
    faces = _triangles(number.reshape(u.shape), u[:-1, :-1] >= centre[0])
    u, v = u.ravel()[kept], v.ravel()[kept]
    if smooth:
        beside = np.pad(number.reshape(len(axes[1]), len(axes[0])) >= 0, 1)
        rim = ~(beside[:-2, 1:-1] & beside[2:, 1:-1] & beside[1:-1, :-2] & beside[1:-1, 2:]).ravel()[kept]
        for _ in range(3):
            stretch = outline(u[rim], v[rim])
            stretch = stretch.max() / np.maximum(stretch, 0.5)
            u[rim] = centre[0] + stretch * (u[rim] - centre[0])
            v[rim] = centre[1] + stretch * (v[rim] - centre[1])
    return u, v, faces


def full_grid(points: int, width: float, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exactly ``points`` nodes of a grid over a rectangle, row by row; the last row may stop early."""
    ideal = np.sqrt(points * width / height)
    tried = np.arange(max(2, int(0.9 * ideal)), max(3, int(np.ceil(1.1 * ideal))) + 1)
    rest = -points % tried  # nodes that the last row lacks: as few as possible
    columns = int(tried[np.lexsort((np.abs(tried - ideal), rest))[0]])
    rows = -(-points // columns)
    number = np.arange(rows * columns)
    row, column = np.divmod(number[:points], columns)
    u = (column / (columns - 1) - 0.5) * width
    v = (0.5 - row / max(rows - 1, 1)) * height
    number[points:] = -1
    grid = number.reshape(rows, columns)
    return u, v, _triangles(grid, np.ones(grid[:-1, :-1].shape, dtype=bool))


def _triangles(number: np.ndarray, falling: np.ndarray) -> np.ndarray:
    """Triangles (M, 3) int32 between neighbouring nodes of a grid of point numbers, -1 for no point.

    ``falling`` says for each cell whether its diagonal falls to the right. A cell that lacks one corner keeps
    one triangle.
    """
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    one_missing = (a < 0).astype(int) + (b < 0) + (c < 0) + (d < 0) == 1
    falling = np.where(one_missing, (b < 0) | (d < 0), falling)
    faces = np.concatenate(
        [
            np.stack(corners, axis=-1)[split]
            for corners, split in (
                ((a, b, d), ~falling),
                ((b, c, d), ~falling),
                ((a, b, c), falling),
                ((a, c, d), falling),
            )
        ]
    )
    return faces[(faces >= 0).all(axis=1)].astype(np.int32)
