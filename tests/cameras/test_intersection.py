"""The metric upgrade: its derivatives, its exactness on exact data, its counting rule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.cameras import intersection
from nrsfm.cameras.rigid import rigid_upgrade
from nrsfm.cameras.signs import apply_signs, consistent_signs
from nrsfm.metrics import rotation_error


@settings(max_examples=25, deadline=None)
@given(
    frames=st.integers(2, 8),
    columns=st.integers(3, 9),
    weight=st.sampled_from([0.0, 0.3, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_jacobian_agrees_with_finite_differences(frames, columns, weight, seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, frames, columns))
    matrix = rng.normal(size=(columns, 3))
    analytic = intersection.jacobian(x, y, matrix, weight)
    numeric = np.empty_like(analytic)
    for i in range(matrix.size):
        step = np.zeros(matrix.size)
        step[i] = 1e-6
        step = step.reshape(matrix.shape)
        ahead = intersection.residuals(x, y, matrix + step, weight)
        behind = intersection.residuals(x, y, matrix - step, weight)
        numeric[:, i] = (ahead - behind) / 2e-6
    scale = np.abs(analytic).max()
    np.testing.assert_allclose(analytic, numeric, atol=2e-6 * max(scale, 1.0))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(0.01, 100.0))
def test_residuals_ignore_scale_and_gauge(seed, factor):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 6, 6))
    matrix = rng.normal(size=(6, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    expected = intersection.residuals(x, y, matrix)
    np.testing.assert_allclose(intersection.residuals(x, y, factor * matrix @ turn), expected, atol=1e-9)


def test_refinement_never_raises_the_cost():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 20, 9))
    for _ in range(10):
        start = rng.normal(size=(9, 3))
        before = float(np.sum(intersection.residuals(x, y, start) ** 2))
        _, after, used = intersection.refine(x, y, start)
        assert after <= before
        assert used >= 1


@pytest.mark.parametrize("rank", [1, 2, 3])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_exact_low_rank_shapes_give_exact_cameras(sequence, rank, seed):
    data = sequence(frames=40, points=60, rank=rank, seed=seed)
    basis = intersection.dominant_basis(data.factor, 3 * rank)
    found = [u for u in intersection.upgrades(basis, rank, np.random.default_rng(0)) if u.rank == rank]
    best = min(found, key=lambda u: u.cost)
    matrix, cost, _ = intersection.refine(
        basis[0::2, : 3 * rank], basis[1::2, : 3 * rank], best.matrix, tolerance=1e-12, iterations=300
    )
    assert cost < 1e-16
    rotations, _ = intersection.polar_rotations((basis[:, : 3 * rank] @ matrix).reshape(-1, 2, 3))
    rotations = apply_signs(rotations, consistent_signs(rotations, data.factor))
    assert rotation_error(rotations, data.rotations) < 1e-4


def test_random_starts_find_what_a_rigid_start_misses(data_root):
    with np.load(data_root / "yoga.npz", allow_pickle=False) as held:
        measurements = held["W"].astype(float)
    basis = intersection.dominant_basis(measurements - measurements.mean(axis=1, keepdims=True), 9)
    cheapest = {}
    for starts in (0, 10):
        found = intersection.upgrades(basis, 3, np.random.default_rng(0), starts=starts)
        cheapest[starts] = [min(u.cost for u in found if u.rank == rank) for rank in (2, 3)]
    assert cheapest[10][0] < 0.2 * cheapest[0][0]
    assert cheapest[10][1] < 0.5 * cheapest[0][1]


def test_polar_rotations_are_the_nearest():
    rng = np.random.default_rng(1)
    blocks = rng.normal(size=(30, 2, 3))
    rotations, scales = intersection.polar_rotations(blocks)
    np.testing.assert_allclose(
        rotations @ np.swapaxes(rotations, 1, 2), np.broadcast_to(np.eye(3), (30, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    best = np.linalg.norm(blocks - rotations[:, :2], axis=(1, 2))
    for _ in range(20):
        u, _, vt = np.linalg.svd(rng.normal(size=(30, 2, 3)), full_matrices=False)
        assert (np.linalg.norm(blocks - u @ vt, axis=(1, 2)) >= best - 1e-12).all()
    assert (scales > 0).all()


@pytest.mark.parametrize(
    ("frames", "columns", "expected"), [(10, 20, 2), (3, 6, 1), (99, 30, 10), (99, 4, 2), (370, 41, 14)]
)
def test_rank_limit(frames, columns, expected):
    assert intersection.rank_limit(frames, columns) == expected


def test_dominant_basis_is_the_same_from_either_gram():
    rng = np.random.default_rng(0)
    tall = rng.normal(size=(40, 8))
    wide = tall @ np.linalg.qr(rng.normal(size=(60, 8)))[0].T
    a, b = intersection.dominant_basis(tall, 5), intersection.dominant_basis(wide, 5)
    np.testing.assert_allclose(a @ a.T, b @ b.T, atol=1e-9)


@pytest.mark.parametrize("free", [False, True])
def test_rigid_factorisation_is_exact_on_a_rigid_shape(sequence, free):
    data = sequence(frames=12, points=30, rank=1, seed=4, constant=True)
    basis = intersection.dominant_basis(data.factor, 3)
    item = rigid_upgrade(basis, free_scales=free)
    rotations, _ = intersection.polar_rotations((basis @ item.matrix).reshape(-1, 2, 3))
    assert rotation_error(rotations, data.rotations) < 1e-5
