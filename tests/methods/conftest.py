"""Synthetic sequences whose truth is known exactly."""

from dataclasses import dataclass

import numpy as np
import pytest

from nrsfm.numerics.threads import single_thread


@dataclass
class Sequence:
    """Tracks (F, P, 2) of shapes (F, P, 3), centred in every frame, under cameras (F, 3, 3)."""

    tracks: np.ndarray
    shapes: np.ndarray
    rotations: np.ndarray


def make_sequence(frames=30, points=80, rank=2, seed=0, noise=0.0, size=100.0):
    """``rank`` basis shapes with smooth weights, seen by a camera that turns about two axes."""
    rng = np.random.default_rng(seed)
    bases = rng.standard_normal((rank, points, 3))
    bases -= bases.mean(axis=1, keepdims=True)
    time = np.arange(frames)
    weights = np.stack([np.cos((k + 1) * 0.35 * time + k) * 0.4 for k in range(rank)], axis=1)
    weights[:, 0] = 1.0
    shapes = size * np.einsum("fk,kpi->fpi", weights, bases)
    a, b = 0.25 * time, 0.5 * np.sin(0.4 * time)
    zero, one = np.zeros(frames), np.ones(frames)
    around_y = np.stack([np.cos(a), zero, np.sin(a), zero, one, zero, -np.sin(a), zero, np.cos(a)], axis=1)
    around_x = np.stack([one, zero, zero, zero, np.cos(b), -np.sin(b), zero, np.sin(b), np.cos(b)], axis=1)
    rotations = around_x.reshape(-1, 3, 3) @ around_y.reshape(-1, 3, 3)
    tracks = (shapes @ rotations.transpose(0, 2, 1))[:, :, :2]
    tracks = tracks + noise * size * rng.standard_normal(tracks.shape)
    return Sequence(tracks + np.array([320.0, 240.0]), shapes, rotations)


@pytest.fixture(scope="session")
def sequence():
    """The function that makes one."""
    return make_sequence


@pytest.fixture(autouse=True)
def _one_thread():
    """As the pipeline runs the methods: their eigenproblems are too small for more."""
    with single_thread():
        yield
