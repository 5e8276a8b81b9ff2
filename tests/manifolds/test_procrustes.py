"""Generalised Procrustes alignment and the tangent space at a mean."""

import numpy as np
import pytest

from nrsfm.manifolds.procrustes import align, onto_tangent_space, procrustes_directions, procrustes_mean


def rotations(rng, count):
    quaternions = rng.standard_normal((count, 4))
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def test_directions_are_derivatives_of_rotation_and_size():
    rng = np.random.default_rng(0)
    mean = rng.standard_normal((3, 7))
    directions = procrustes_directions(mean)
    assert np.array_equal(directions[:, 0], mean.reshape(-1))
    for k in range(3):
        axis = np.eye(3)[k]
        expected = np.cross(axis, mean.T).T
        assert np.allclose(directions[:, k + 1], expected.reshape(-1))


def test_align_undoes_rotation_and_size():
    rng = np.random.default_rng(1)
    mean = rng.standard_normal((3, 9))
    mean /= np.linalg.norm(mean)
    turns, sizes = rotations(rng, 5), rng.uniform(0.3, 2.0, 5)
    found, scale = align(sizes[:, None, None] * (np.swapaxes(turns, 1, 2) @ mean), mean)
    assert np.allclose(found, turns)
    assert np.allclose(scale, sizes)


def test_aligned_shapes_differ_from_the_mean_only_in_the_tangent_space():
    rng = np.random.default_rng(2)
    mean = rng.standard_normal((3, 9))
    mean /= np.linalg.norm(mean)
    shapes = rotations(rng, 6) @ (mean + 0.05 * rng.standard_normal((6, 3, 9)))
    found, scale = align(shapes, mean)
    aligned = (found @ shapes) / scale[:, None, None]
    deviations = (aligned - mean).reshape(6, -1)
    assert np.abs(deviations @ procrustes_directions(mean)).max() < 1e-12
    assert np.linalg.det(found) == pytest.approx(np.ones(6))


def test_alignment_never_reflects():
    mean = np.random.default_rng(3).standard_normal((3, 9))
    found, _ = align((np.diag([1.0, 1.0, -1.0]) @ mean)[None], mean)
    assert np.linalg.det(found[0]) == pytest.approx(1.0)


def test_projection_is_idempotent_and_survives_points_on_a_line():
    rng = np.random.default_rng(4)
    for mean in (rng.standard_normal((3, 6)), np.outer([1.0, 2.0, 3.0], rng.standard_normal(6))):
        vectors = rng.standard_normal((18, 3))
        once = onto_tangent_space(mean, vectors)
        assert np.allclose(onto_tangent_space(mean, once), once)
        assert np.abs(procrustes_directions(mean).T @ once).max() < 1e-10


def test_mean_of_copies_is_the_shape():
    rng = np.random.default_rng(5)
    shape = rng.standard_normal((3, 8))
    copies = rotations(rng, 7) @ shape
    mean, turns, sizes = procrustes_mean(copies, copies[0], iterations=20)
    assert np.linalg.norm(mean) == pytest.approx(1.0)
    assert np.allclose(sizes, np.linalg.norm(shape))
    assert np.allclose(turns @ copies / sizes[:, None, None], mean)


def test_a_frame_in_one_point_stays_finite():
    mean = np.random.default_rng(6).standard_normal((3, 8))
    turns, sizes = align(np.zeros((1, 3, 8)), mean)
    assert np.isfinite(turns).all()
    assert sizes[0] > 0
