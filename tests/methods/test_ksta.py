"""KSTA: its kernels against direct computation, and sequences whose coefficients follow the look of the frames."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure, uncompressed
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.ksta import affine_distances, kernel_basis, rotation_invariant_distances
from nrsfm.metrics import shape_error
from nrsfm.options import build_options
from nrsfm.pipeline import reconstruct


def solution_of(tracks, rotations, points=False, **options):
    measured = measure(tracks)
    small = uncompressed(measured) if points else compress(measured, np.zeros(measured.count, dtype=int))
    problem = Problem(small.factors, small.offsets, small.sizes, np.ascontiguousarray(rotations[:, :2]), 0.0)
    method = get_method("ksta")
    found = method.solve(problem, build_options(method.Options, options), np.random.default_rng(0), lambda _: None)
    return small.expand(found.shapes, np.dtype(np.float64)), found


def test_rotation_invariant_distance_is_the_best_over_turns():
    flat = np.random.default_rng(0).standard_normal((8, 11))
    distances = rotation_invariant_distances(flat)
    z = flat[0::2] + 1j * flat[1::2]
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    turns = np.exp(1j * np.linspace(0, 2 * np.pi, 20001))
    for f, g in ((0, 1), (2, 3)):
        tried = np.sum(np.abs(z[f] - turns[:, None] * z[g]) ** 2, axis=1)
        assert distances[f, g] == pytest.approx(tried.min(), abs=1e-6)
    np.testing.assert_allclose(np.diag(distances), 0, atol=1e-12)


def test_affine_distance_is_zero_between_views_of_one_shape_only():
    rng = np.random.default_rng(1)
    shapes = rng.standard_normal((2, 3, 15))
    views = np.concatenate([rng.standard_normal((2, 3)) @ shapes[k] for k in (0, 0, 1)])
    distances = affine_distances(views)
    assert distances[0, 1] < 1e-12
    assert distances[0, 2] > 1e-4
    values = np.linalg.svd(views[[0, 1, 4, 5]], compute_uv=False) ** 2
    assert distances[0, 2] == pytest.approx(values[-1] / values.sum(), rel=1e-8)
    np.testing.assert_allclose(distances, distances.T, atol=1e-12)


def test_kernel_basis_is_orthonormal_and_reproduces_the_kernel():
    distances = rotation_invariant_distances(np.random.default_rng(0).standard_normal((20, 11)))
    basis = kernel_basis(distances, 0.5, 10)
    kernel = np.exp(-distances)
    np.testing.assert_allclose(basis.T @ basis, np.eye(10), atol=1e-10)
    np.testing.assert_allclose(basis @ (basis.T @ kernel), kernel, atol=1e-8)
    assert kernel_basis(np.zeros((10, 10)), 0.5, 4).shape == (10, 1)


def recurring(frames=60, points=30, seed=0):
    """Three poses that come back in random order, each under its own two cameras: the look decides the shape."""
    rng = np.random.default_rng(seed)
    poses = np.array([1.0, 1.0, 1.0])[:, None, None] * rng.standard_normal((points, 3))
    poses = poses + 0.4 * rng.standard_normal((3, points, 3))
    cameras = np.linalg.qr(rng.standard_normal((3, 4, 3, 3)))[0]
    cameras *= np.linalg.det(cameras)[..., None, None]
    which, view = rng.integers(3, size=frames), rng.integers(4, size=frames)
    shapes, rotations = poses[which], cameras[which, view]
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    return (shapes @ rotations.transpose(0, 2, 1))[..., :2], shapes, rotations


@pytest.mark.parametrize(("kernel", "options"), [("rik", {}), ("asfm", {"width": 0.01})])
def test_recovers_recurring_shapes_in_any_order(kernel, options):
    """The look has 12 values, which 12 eigenvectors tell apart; two views of one pose are one to a narrow ``asfm``."""
    tracks, shapes, rotations = recurring()
    found, solution = solution_of(tracks, rotations, rank=3, basis_size=12, kernel=kernel, **options)
    assert shape_error(found, shapes, "none") < 1e-6
    assert solution.history["energy"][-1] < 1e-10


def test_order_of_the_frames_does_not_matter(sequence):
    data = sequence(noise=0.02)
    order = np.random.default_rng(3).permutation(len(data.tracks))
    plain, _ = solution_of(data.tracks, data.rotations)
    moved, _ = solution_of(data.tracks[order], data.rotations[order])
    np.testing.assert_allclose(moved, plain[order], rtol=0, atol=1e-4 * np.abs(plain).max())
    assert reconstruct(data.tracks[order], "ksta", data.rotations[order], ordered=False, rank=2).shapes.shape[0] == 30


def test_one_cell_compressed_is_all_points(sequence):
    data = sequence(noise=0.05)
    small, _ = solution_of(data.tracks, data.rotations)
    full, _ = solution_of(data.tracks, data.rotations, points=True)
    np.testing.assert_allclose(small, full, rtol=0, atol=1e-5 * np.abs(full).max())


@pytest.mark.parametrize(
    "switch",
    [{"rank": 1}, {"basis_size": 5}, {"kernel": "asfm"}, {"width": 0.1}, {"max_iterations": 1}, {"least_gain": 0.5}],
)
def test_every_option_does_something(switch, sequence):
    data = sequence(noise=0.05, rank=3)
    common = {"rank": 3, "basis_size": 12, "width": 1.0}
    plain, _ = solution_of(data.tracks, data.rotations, **common)
    other, _ = solution_of(data.tracks, data.rotations, **(common | switch))
    assert np.abs(other - plain).max() > 1e-4 * np.abs(plain).max()
