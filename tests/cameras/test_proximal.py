"""The proximal gradient on the Gram matrix: its adjoint, its optimality, and the cameras that come of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.cameras import CameraOptions, estimate_cameras, proximal
from nrsfm.metrics import rotation_error


@settings(max_examples=25, deadline=None)
@given(frames=st.integers(2, 9), columns=st.integers(3, 8), seed=st.integers(0, 2**32 - 1))
def test_adjoint(frames, columns, seed):
    rng = np.random.default_rng(seed)
    problem = proximal.Constraints(*rng.normal(size=(2, frames, columns)))
    gram = rng.normal(size=(columns, columns))
    gram = gram + gram.T
    residual = rng.normal(size=2 * frames + 1)
    zero = problem.residuals(np.zeros((columns, columns)))
    left, right = (problem.residuals(gram) - zero) @ residual, np.sum(gram * problem.adjoint(residual))
    np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9)


def test_residuals_are_the_metric_constraints():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 4, 6))
    matrix = rng.normal(size=(6, 3))
    found = proximal.Constraints(x, y).residuals(matrix @ matrix.T)
    u, v = x @ matrix, y @ matrix
    a, b = np.sum(u * u, axis=1), np.sum(v * v, axis=1)
    np.testing.assert_allclose(found[:4], (a - b) / np.sqrt(2))
    np.testing.assert_allclose(found[4:8], np.sqrt(2) * np.sum(u * v, axis=1))
    assert found[8] == pytest.approx(2 * (np.mean(a + b) / 2 - 1))


def test_curvature_bounds_the_map():
    rng = np.random.default_rng(1)
    problem = proximal.Constraints(*rng.normal(size=(2, 12, 5)))
    zero, bound = problem.residuals(np.zeros((5, 5))), problem.curvature()
    for _ in range(300):
        gram = rng.normal(size=(5, 5))
        gram = gram + gram.T
        assert np.sum((problem.residuals(gram) - zero) ** 2) <= bound * np.sum(gram * gram)


def test_the_minimum_is_one():
    """Conditions of a minimum over Q ⪰ 0: gradient + μI is positive semidefinite and orthogonal to Q."""
    rng = np.random.default_rng(2)
    problem = proximal.Constraints(*rng.normal(size=(2, 30, 6)))
    gram, weight = proximal.minimise(problem)
    slope = problem.adjoint(problem.residuals(gram)) + weight * np.eye(6)
    assert np.linalg.eigvalsh(gram)[0] > -1e-10
    assert np.linalg.eigvalsh(slope)[0] > -1e-4 * weight
    assert abs(np.sum(slope * gram)) < 1e-3 * weight * np.trace(gram)


@pytest.mark.parametrize("rank", [None, 1, 3])
def test_rigid_sequence(rank, sequence):
    data = sequence(40, 60, 1, seed=3, constant=True)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="proximal", camera_rank=rank))
    assert found.method == "proximal"
    assert rotation_error(found.rotations, data.rotations) < 0.5


def test_bending_sequence_needs_more_than_one_triplet(sequence):
    data = sequence(80, 60, 2, seed=4)
    errors = [
        rotation_error(
            estimate_cameras(data.factor, CameraOptions(camera_method="proximal", camera_rank=k)).rotations,
            data.rotations,
        )
        for k in (1, None)
    ]
    assert errors[1] < 5.0
    assert errors[1] < errors[0]


def test_too_large_a_rank_is_said(sequence):
    data = sequence(10, 40, 3, seed=5)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="proximal", camera_rank=9))
    assert any("camera_rank 9 is more than 10 frames" in text for text in found.warnings)
