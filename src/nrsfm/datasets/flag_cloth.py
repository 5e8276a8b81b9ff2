"""A flag in gusty wind: cloth simulated as particles held at their distances.

Compliant constraints solved once per small time step: Macklin, Müller, Chentanez: "XPBD: Position-Based Simulation
of Compliant Constrained Dynamics", MIG 2016; one iteration and many substeps as in Macklin et al.: "Small Steps in
Physics Simulation", SCA 2019. The wind (ours) pushes each vertex along its normal with the square law of drag and
changes smoothly in place and time. Threads do not stretch noticeably, the diagonals give a little, bending is soft.
"""

from __future__ import annotations

import numpy as np

_SUBSTEPS = 7
_RATE = 200.0  # frames per second: a flag in a breeze moves too fast for a camera of 30
_GRAVITY = 9.81  # m/s²


def _constraints(rows: int, columns: int, rest: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]:
    """Batches (i, j, rest length, compliance) in which no particle occurs twice, so that each is one array step."""
    number = np.arange(rows * columns).reshape(rows, columns)
    batches = []
    for dy, dx, compliance in (
        (0, 1, 0.0),
        (1, 0, 0.0),
        (1, 1, 1e-7),
        (1, -1, 1e-7),
        (0, 2, 3e-6),
        (2, 0, 3e-6),
        (0, 4, 2e-5),
        (4, 0, 2e-5),
    ):
        first = number[: rows - dy, max(-dx, 0) : columns - max(dx, 0)]
        second = number[dy:, max(dx, 0) : columns + min(dx, 0)]
        # Pairs that share no particle: walk along the step and take every second.
        row, column = np.indices(first.shape)
        key = (column // dx if dy == 0 else row // dy) % 2
        for parity in (0, 1):
            i, j = first[key == parity], second[key == parity]
            if len(i):
                batches.append((i, j, np.linalg.norm(rest[i] - rest[j], axis=1), compliance))
    return batches


def _normals(x: np.ndarray, rows: int, columns: int) -> np.ndarray:
    grid = x.reshape(rows, columns, 3)
    normal = np.cross(np.gradient(grid, axis=1), np.gradient(grid, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    return normal.reshape(-1, 3)


def _gusts(rng: np.random.Generator, count: int = 6) -> tuple[np.ndarray, ...]:
    """Waves (direction in the plane, speed, phase) whose sum modulates the wind."""
    return (
        rng.normal(0, 4.0, (count, 2)),
        rng.uniform(3.0, 11.0, count),
        rng.uniform(0, 2 * np.pi, count),
    )


def simulate(frames: int, seed: int, *, rows: int = 32, columns: int = 44) -> np.ndarray:
    """Return (F, rows·columns, 3) positions in metres of a flag of 0.9 × 1.26, pole at x = 0.

    x to the right, y down, z away from the viewer; rows from the top, row by row. 200 frames per second.
    """
    rng = np.random.default_rng([seed, 7])
    height, width = 0.9, 1.26
    v, u = np.meshgrid(np.linspace(0, height, rows), np.linspace(0, width, columns), indexing="ij")
    x = np.stack([u.ravel(), v.ravel(), 0.02 * np.sin(5 * u.ravel() + 3 * v.ravel())], axis=1)
    rest = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    batches = _constraints(rows, columns, rest)
    free = (u.ravel() > 0).astype(np.float64)
    velocity = np.zeros_like(x)
    step = 1 / (_RATE * _SUBSTEPS)
    waves, speeds, phases = _gusts(rng)
    pairs = []
    for i, j, length, compliance in batches:
        weight = free[i] + free[j]
        moving = weight > 0
        i, j, length = i[moving], j[moving], length[moving]
        pairs.append((i, j, length, free[i], free[j], weight[moving] + compliance / step**2))
    held = []
    warm_up = 200
    for f in range(warm_up + frames):
        t = f / _RATE
        phase = x[:, :2] @ waves.T + speeds * t + phases
        gust = np.sin(phase).mean(axis=1)
        sideways = 1.0 * np.sin(2.3 * t) + 3.0 * gust
        wind = np.stack([9.0 + 3.0 * gust, -3.0 + 1.0 * np.cos(phase).mean(axis=1), sideways], axis=1)
        for _ in range(_SUBSTEPS):
            normal = _normals(x, rows, columns)
            relative = np.einsum("nk,nk->n", wind - velocity, normal)
            push = 1.1 * relative * np.abs(relative)
            velocity += step * (push[:, None] * normal + np.array([0, _GRAVITY, 0]))
            velocity *= free[:, None] * (1 - 0.35 * step)
            new = x + step * velocity
            for i, j, length, free_i, free_j, weight in pairs:
                away = new[i] - new[j]
                distance = np.sqrt(np.einsum("nk,nk->n", away, away))
                share = ((distance - length) / (weight * np.maximum(distance, 1e-9)))[:, None] * away
                new[i] -= free_i[:, None] * share
                new[j] += free_j[:, None] * share
            velocity = (new - x) / step
            x = new
        if f >= warm_up:
            held.append(x.copy())
    return np.stack(held)


def refine(positions: np.ndarray, rows: int, columns: int, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cloth on a grid ``factor`` times as fine, (F, P, 3), through cubic splines, and its triangles.

    The triangles turn clockwise as the viewer sees them at rest (x right, y down).
    """
    from scipy.interpolate import CubicSpline

    from nrsfm.datasets.grids import full_grid

    frames = len(positions)
    fine_rows, fine_columns = (rows - 1) * factor + 1, (columns - 1) * factor + 1
    grid = positions.reshape(frames, rows, columns, 3)
    grid = CubicSpline(np.arange(rows), grid, axis=1)(np.linspace(0, rows - 1, fine_rows))
    grid = CubicSpline(np.arange(columns), grid, axis=2)(np.linspace(0, columns - 1, fine_columns))
    _, _, faces = full_grid(fine_rows * fine_columns, float(fine_columns - 1), float(fine_rows - 1))
    return grid.reshape(frames, -1, 3), faces
