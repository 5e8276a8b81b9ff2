"""Exact low-rank sequences for the camera tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest


@dataclass(frozen=True)
class Sequence:
    """Centred W (2F, P) of unit RMS, its exact factor, the true shapes (F, 3, P) and cameras (F, 3, 3)."""

    measurements: np.ndarray
    factor: np.ndarray
    shapes: np.ndarray
    rotations: np.ndarray


def smooth_path(frames: int, rng: np.random.Generator, reach: float = 1.0) -> np.ndarray:
    """A wandering camera: rotation vectors that are low-frequency sums of cosines, up to ``reach`` radians."""
    from scipy.spatial.transform import Rotation

    time = np.linspace(0, 1, frames)[:, None]
    vectors = sum(rng.normal(size=3) * np.cos(np.pi * k * time) / k for k in range(1, 5))
    return Rotation.from_rotvec(reach * vectors / np.abs(vectors).max()).as_matrix()


def compress(measurements: np.ndarray) -> np.ndarray:
    """Factor (2F, r) with W = factor @ Qᵀ and orthonormal Q."""
    return np.linalg.qr(measurements.T, mode="r").T


def low_rank_sequence(
    frames: int,
    points: int,
    rank: int,
    seed: int,
    *,
    deformation: float = 0.3,
    constant: bool = False,
    noise: float = 0.0,
    rotations: np.ndarray | None = None,
) -> Sequence:
    """Shapes Σ_k c_fk B_k with smooth coefficients, seen by orthographic cameras on a wandering path."""
    rng = np.random.default_rng(seed)
    if rotations is None:
        rotations = smooth_path(frames, rng)
    bases = rng.normal(size=(rank, 3, points))
    time = np.linspace(0, 1, frames)
    weights = np.ones((frames, rank))
    if not constant:
        weights[:, 0] += 0.1 * np.sin(5 * time + rng.uniform(0, 6))
    for k in range(1, rank):
        weights[:, k] = deformation * np.sin(2 * np.pi * (k + rng.uniform()) * time + rng.uniform(0, 6))
    shapes = np.einsum("fk,kcp->fcp", weights, bases)
    shapes -= shapes.mean(axis=2, keepdims=True)
    measurements = (rotations @ shapes)[:, :2].reshape(2 * frames, points)
    measurements = measurements + noise * np.abs(measurements).max() * rng.normal(size=measurements.shape)
    measurements -= measurements.mean(axis=1, keepdims=True)
    unit = np.sqrt(np.mean(measurements**2))
    measurements = measurements / unit
    return Sequence(measurements, compress(measurements), shapes / unit, rotations)


@pytest.fixture(scope="session")
def sequence() -> Callable[..., Sequence]:
    """The maker of exact low-rank sequences."""
    return low_rank_sequence


@pytest.fixture(scope="session")
def wandering() -> Callable[..., np.ndarray]:
    """The maker of wandering camera paths."""
    return smooth_path
