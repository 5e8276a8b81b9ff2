"""The grown upgrade: exact recovery, never worse than the published start."""

import numpy as np
import pytest

from nrsfm.cameras import grown, trajectory
from nrsfm.cameras.intersection import dominant_basis
from nrsfm.metrics import rotation_error


def test_every_stage_is_at_least_as_good_as_the_published_start_and_as_the_one_before(sequence):
    basis = dominant_basis(sequence(60, 50, 4, seed=1, noise=0.01).measurements, 18)
    found = grown.grow(basis, 6)
    assert [k for k, _, _ in found] == [1, 2, 3, 4, 5, 6]
    costs = [cost for _, _, cost in found]
    assert costs == sorted(costs, reverse=True)
    for k, matrix, cost in found:
        x, y = trajectory.rows_of(basis, k)
        assert cost <= trajectory.refine(x, y, trajectory.published_start(k, x.shape[1]))[1] * (1 + 1e-9)
        assert np.sum(trajectory.residuals(x, y, matrix) ** 2) == pytest.approx(60 * cost)


@pytest.mark.parametrize("rank", [None, 3, 4])
def test_exact_cameras_where_a_coefficient_is_constant(rank, sequence):
    path = sequence(80, 60, 1, seed=3).rotations
    weights = np.ones((80, 3))
    for k in (1, 2):
        weights[:, k] = 0.4 * np.sin(2 * np.pi * (k + 0.5) * np.linspace(0, 1, 80) + k)
    shapes = np.einsum("fk,kcp->fcp", weights, np.random.default_rng(5).normal(size=(3, 3, 60)))
    basis = dominant_basis((path @ shapes)[:, :2].reshape(160, 60), 39)
    found = grown.upgrade(basis, rank, np.random.default_rng(0))
    assert rotation_error(found.rotations, path) < 0.01


def test_a_rank_beyond_the_equations_is_lowered_and_said(sequence):
    basis = dominant_basis(sequence(10, 60, 4, seed=2).measurements, 36)
    found = grown.upgrade(basis, 12, np.random.default_rng(0))
    assert found.rank == 3
    assert found.warnings


def test_yoga_does_not_fail_from_a_rigid_start(data_root):
    """Grown from K = 1 alone this ends 28 to 60 degrees off."""
    from nrsfm.datasets import load

    data = load("yoga", data_root)
    centred = data.tracks.points - data.tracks.points.mean(axis=1, keepdims=True)
    basis = dominant_basis(centred.transpose(0, 2, 1).reshape(2 * len(centred), -1), 39)
    for rank in (2, 7, 13):
        found = grown.upgrade(basis, rank, np.random.default_rng(0))
        assert rotation_error(found.rotations, data.rotations) < 10
