"""All triplets of the corrective matrix, and the choice of the smoothest path."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from nrsfm.cameras import CameraOptions, estimate_cameras, intersection, smoothest, triplets
from nrsfm.metrics import rotation_error


def test_all_triplets_are_scaled_copies_of_the_cameras(sequence):
    """On exact tracks: ΠG_k = c_fk R_f, with independent coefficients that span those of the shapes."""
    data = sequence(50, 60, 3, seed=1)
    basis = intersection.dominant_basis(data.factor, 9)
    blocks, coefficients = triplets.all_triplets(basis, data.rotations, 3)
    assert blocks.shape == (3, 50, 2, 3)
    expected = np.einsum("fk,fij->kfij", coefficients, data.rotations[:, :2])
    np.testing.assert_allclose(blocks, expected, atol=1e-8)
    np.testing.assert_allclose(coefficients.T @ coefficients, np.eye(3), atol=1e-10)
    left = np.linalg.svd(data.shapes.reshape(50, -1))[0][:, :3]
    np.testing.assert_allclose(left @ (left.T @ coefficients), coefficients, atol=1e-7)


def test_triplets_are_the_best_fit_of_all_coefficients(sequence):
    """Against random coefficient vectors: none leaves less of M(c) outside the span of Π than the first."""
    data = sequence(30, 40, 3, seed=2, noise=0.02)
    basis = intersection.dominant_basis(data.factor, 6)
    _, coefficients = triplets.all_triplets(basis, data.rotations, 2)
    left = np.linalg.qr(basis)[0]

    def outside(c):
        stack = (c[:, None, None] * data.rotations[:, :2]).reshape(-1, 3)
        return np.linalg.norm(stack - left @ (left.T @ stack)) / np.linalg.norm(c)

    rng = np.random.default_rng(0)
    for _ in range(200):
        near = coefficients[:, 0] + rng.exponential(0.3) * rng.normal(size=30) / np.sqrt(30)
        assert outside(coefficients[:, 0]) <= outside(near) + 1e-12
    assert outside(coefficients[:, 0]) <= outside(coefficients[:, 1])


@pytest.mark.parametrize("rank", [None, 2])
def test_exact_sequence(rank, sequence):
    data = sequence(60, 60, 2, seed=3)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="smoothest", camera_rank=rank))
    assert found.method == "smoothest"
    assert found.rank == 2
    assert rotation_error(found.rotations, data.rotations) < 0.05


def test_the_smoothest_of_near_minima_wins(sequence):
    """A minimum that costs as little but jumps loses; one that costs far more is not looked at, smooth or not."""
    data = sequence(40, 50, 1, seed=4, constant=True)
    basis = intersection.dominant_basis(data.factor, 3)
    good = triplets.solve_upgrades(basis, 1, np.random.default_rng(0)).by_rank[1][0]
    still = intersection.Upgrade(1, np.diag([1.0, 1.0, 1e-3]) @ good.matrix, 1.0, "wrong", 0)
    jumpy = intersection.Upgrade(1, np.random.default_rng(1).normal(size=(3, 3)), good.cost, "wrong", 0)
    paths = [triplets.rotations_of(basis, triplets.first_triplet(basis, item)) for item in (good, jumpy)]
    chosen = smoothest._smoothest(basis, [good, still, jumpy])
    assert smoothest.roughness(chosen) == pytest.approx(min(smoothest.roughness(p) for p in paths))


def test_roughness_is_zero_only_for_a_still_camera(wandering):
    path = wandering(20, np.random.default_rng(0))
    assert smoothest.roughness(np.repeat(path[:1], 20, axis=0)) == 0.0
    by_hand = sum(np.linalg.norm(b - a) ** 2 for a, b in itertools.pairwise(path))
    assert smoothest.roughness(path) == pytest.approx(by_hand)


def test_too_large_a_rank_is_said(sequence):
    data = sequence(10, 40, 2, seed=5)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="smoothest", camera_rank=9))
    assert any("camera_rank 9 is more than 10 frames" in text for text in found.warnings)


@pytest.mark.parametrize("method", ["smoothest", "averaged", "proximal"])
@pytest.mark.parametrize("columns", [1, 2, 3, 5])
@pytest.mark.parametrize("frames", [2, 3, 7])
def test_small_and_flat_input_gives_rotations(method, columns, frames):
    factor = np.random.default_rng(columns).normal(size=(2 * frames, columns))
    found = estimate_cameras(factor, CameraOptions(camera_method=method))
    np.testing.assert_allclose(
        found.rotations @ found.rotations.transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(found.rotations), 1.0)


@pytest.mark.parametrize("method", ["smoothest", "averaged", "proximal"])
def test_nothing_that_moves(method):
    found = estimate_cameras(np.zeros((12, 4)), CameraOptions(camera_method=method))
    assert np.isfinite(found.rotations).all()
    still = np.tile(np.random.default_rng(0).normal(size=(2, 6)), (8, 1))
    found = estimate_cameras(still, CameraOptions(camera_method=method))
    assert any("hardly turns" in text for text in found.warnings)


@pytest.mark.parametrize("method", ["smoothest", "averaged", "proximal"])
def test_same_seed_same_cameras(method, sequence):
    data = sequence(16, 40, 2, seed=6, noise=0.01)
    first, second = (estimate_cameras(data.factor, CameraOptions(camera_method=method)) for _ in range(2))
    np.testing.assert_array_equal(first.rotations, second.rotations)
