"""A sheet that bends, turns and is seen by an orthographic camera: exact rank, smooth over the surface."""

import numpy as np
import pytest

from nrsfm.datasets.sequence import project


def bending_sheet(frames=30, side=15, bends=2):
    u, v = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-0.8, 0.8, side))
    u, v = u.ravel(), v.ravel()
    rest = np.stack([u, v, 0.3 * u * v], axis=1)
    modes = [np.stack([0 * u, 0.1 * u, np.sin(np.pi * (k + 1) * u / 2)], axis=1) for k in range(bends)]
    time = np.linspace(0, 1, frames)
    weights = [0.4 / (k + 1) * np.sin(2 * np.pi * (k + 1) * time + k) for k in range(bends)]
    shapes = rest + sum(w[:, None, None] * m for w, m in zip(weights, modes, strict=True))
    angle = 1.2 * np.sin(2 * np.pi * time)
    c, s = np.cos(angle), np.sin(angle)
    zero, one = np.zeros(frames), np.ones(frames)
    turn = np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=1).reshape(frames, 3, 3)
    tilt = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]])
    rotations = tilt @ turn
    shift = np.stack([0.5 * time, np.cos(3 * time)], axis=1)
    return project(shapes, rotations) + shift[:, None]


@pytest.fixture(scope="session")
def sheet():
    points = bending_sheet()
    points.flags.writeable = False
    return points


@pytest.fixture
def rng():
    return np.random.default_rng(0)
