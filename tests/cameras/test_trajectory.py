"""The constant trajectory's triplet: derivatives, exact recovery, limits."""

import numpy as np
import pytest

from nrsfm.cameras import trajectory
from nrsfm.cameras.intersection import dominant_basis
from nrsfm.metrics import rotation_error


def test_jacobian_is_the_derivative():
    rng = np.random.default_rng(0)
    x, y, matrix = rng.standard_normal((7, 6)), rng.standard_normal((7, 6)), rng.standard_normal((6, 3))
    jacobian = trajectory.jacobian(x, y, matrix)
    for i, index in enumerate(np.ndindex(matrix.shape)):
        step = np.zeros_like(matrix)
        step[index] = 1e-6
        numeric = (trajectory.residuals(x, y, matrix + step) - trajectory.residuals(x, y, matrix - step)) / 2e-6
        np.testing.assert_allclose(jacobian[:, i], numeric, atol=1e-7)


@pytest.mark.parametrize("rank", [1, 2, 4])
@pytest.mark.parametrize("chosen", [False, True])
def test_exact_cameras_where_a_coefficient_is_constant(rank, chosen, sequence):
    """From one start, so not on every sequence (see grown)."""
    path = sequence(80, 60, 1, seed=1).rotations
    weights = np.ones((80, rank))
    for k in range(1, rank):
        weights[:, k] = 0.4 * np.sin(2 * np.pi * (k + 0.5) * np.linspace(0, 1, 80) + k)
    shapes = np.einsum("fk,kcp->fcp", weights, np.random.default_rng(5).normal(size=(rank, 3, 60)))
    basis = dominant_basis((path @ shapes)[:, :2].reshape(160, 60), 39)
    found = trajectory.upgrade(basis, None if chosen else rank, np.random.default_rng(0))
    assert rotation_error(found.rotations, path) < 0.01
    assert found.rank == rank
    assert found.cost < 1e-10


def test_units_do_not_matter(sequence):
    basis = dominant_basis(sequence(40, 30, 2, seed=1, noise=0.01).measurements, 12)
    first, second = (trajectory.upgrade(scale * basis, 2, np.random.default_rng(0)) for scale in (1.0, 1e-4))
    np.testing.assert_allclose(first.rotations, second.rotations, atol=1e-6)


def test_published_start_has_its_ones_where_the_constant_is():
    start = trajectory.published_start(4, 12)
    assert [int(np.argmax(start[:, axis])) for axis in range(3)] == [0, 4, 8]
    assert np.linalg.matrix_rank(trajectory.published_start(4, 5)) == 3


def test_a_rank_beyond_the_equations_is_lowered_and_said(sequence):
    basis = dominant_basis(sequence(10, 60, 4, seed=2).measurements, 36)
    found = trajectory.upgrade(basis, 12, np.random.default_rng(0))
    assert found.rank == 3
    assert "K = 12 is more than 10 frames" in found.warnings[0]


@pytest.mark.parametrize("kind", ["zero", "planar", "still"])
def test_degenerate_tracks_give_valid_rotations(kind, sequence):
    data = sequence(20, 30, 1, seed=4)
    tracks = data.measurements.copy()
    if kind == "zero":
        tracks[:] = 0.0
    elif kind == "planar":
        flat = np.zeros((3, 30))
        flat[:2] = np.random.default_rng(0).normal(size=(2, 30))
        tracks = (data.rotations[:, :2] @ flat).reshape(40, 30)
    else:
        tracks = np.tile(tracks[:2], (20, 1))
    basis = dominant_basis(tracks, 12)
    basis = np.hstack([basis, np.zeros((40, max(0, 3 - basis.shape[1])))])
    found = trajectory.upgrade(basis, None, np.random.default_rng(0))
    np.testing.assert_allclose(
        found.rotations @ found.rotations.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-8
    )
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1.0, atol=1e-8)
