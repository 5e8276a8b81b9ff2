"""A generated cloth: bending waves, a narrow fold that travels along it, and a twist."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SIZE = (300.0, 220.0)
"""Width and height, pixels."""

_STEPS = 192  # integration steps along the cloth


def waves(u: np.ndarray, v: np.ndarray, frames: int, seed: int, deformation: float) -> Callable[[int], np.ndarray]:
    """Return a function that gives the cloth (3, P) in frame f, x right, y up, z to the viewer.

    Its slope along u is prescribed and integrated, so that the cloth keeps its length; then it is twisted.
    ``u``, ``v`` (P,) are the flat positions of the points.
    """
    rng = np.random.default_rng([seed, 2])
    width, height = SIZE
    phase = rng.uniform(0.0, 2 * np.pi, 4)
    speed = rng.uniform(0.85, 1.15, 4)
    steps = np.linspace(-width / 2 * 1.2, width / 2 * 1.2, _STEPS)
    rows, row = np.unique(v, return_inverse=True)
    place = (u - steps[0]) / (steps[1] - steps[0])
    cell = np.clip(place.astype(np.int64), 0, _STEPS - 2)
    part = place - cell

    def shape(f: int) -> np.ndarray:
        t = f / (frames - 1)
        along, across = steps[None, :] / width, rows[:, None] / height
        slope = 0.5 * np.sin(2 * np.pi * (1.1 * along - 2.1 * speed[0] * t) + 0.9 * across + phase[0])
        slope += 0.25 * np.sin(2 * np.pi * (2.3 * along - 3.1 * speed[1] * t - 0.5 * across) + phase[1])
        # A narrow fold that runs along the cloth and comes round again: it moves, so no fixed basis spans it.
        away = (along + 0.4 * across * across - 2.7 * speed[2] * t + phase[3] / 6.0 + 0.7) % 1.4 - 0.7
        slope += 0.45 * (away / 0.05) * np.exp(0.5 - 0.5 * (away / 0.05) ** 2)
        slope *= deformation * (0.7 + 0.3 * np.sin(2 * np.pi * 1.3 * speed[2] * t + phase[2]))
        length = steps[1] - steps[0]
        path = np.stack([np.cos(slope), np.sin(slope)])
        path[..., 1:] = np.cumsum(0.5 * length * (path[..., 1:] + path[..., :-1]), axis=2)
        path[..., 0] = 0.0
        path -= path.mean(axis=2, keepdims=True)
        x, z = (1.0 - part) * path[:, row, cell] + part * path[:, row, cell + 1]
        turn = 2 * np.pi * (0.5 * u / width - 1.2 * speed[3] * t) + phase[3]
        twist = 0.35 * deformation * np.sin(turn)
        y = v * np.cos(twist) - z * np.sin(twist)
        return np.stack([x, y, v * np.sin(twist) + z * np.cos(twist)])

    return shape
