"""CSF1 recovers sequences of rank K with smooth coefficients, with cameras known and not, and chooses K."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure, uncompressed
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.csf1 import default_basis_size
from nrsfm.methods.trajectory import dct_basis
from nrsfm.metrics import camera_frame_error, shape_error
from nrsfm.options import build_options
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}


def smooth_sequence(frames=60, points=40, rank=3, size=8, seed=0):
    """Rank-K shapes whose coefficients are sums of ``size`` cosines, seen by wandering cameras."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    unknowns = np.linalg.qr(rng.standard_normal((size, rank)))[0]
    unknowns[:, 0] = 0.2 * unknowns[:, 0] + np.eye(size)[0]
    bases = rng.standard_normal((rank, points * 3)) * np.array([1.0] + [0.3] * (rank - 1))[:, None]
    shapes = (dct_basis(frames, size) @ unknowns @ bases).reshape(frames, points, 3)
    shapes -= shapes.mean(axis=1, keepdims=True)
    vectors = np.cumsum(rng.standard_normal((frames, 3)), axis=0) * 0.4
    rotations = Rotation.from_rotvec(vectors).as_matrix()
    return (shapes @ rotations.transpose(0, 2, 1))[..., :2], shapes, rotations


def solution_of(tracks, rotations, method="csf1", points=False, **options):
    """The method's own solution, on compressed tracks or on all points, cameras known."""
    measured = measure(tracks)
    small = uncompressed(measured) if points else compress(measured, np.zeros(measured.count, dtype=int))
    problem = Problem(small.factors, small.offsets, small.sizes, np.ascontiguousarray(rotations[:, :2]), 0.0)
    solver = get_method(method)
    found = solver.solve(problem, build_options(solver.Options, options), np.random.default_rng(0), lambda _: None)
    return small.expand(found.shapes, np.dtype(np.float64)), found


@pytest.mark.parametrize(("rank", "size"), [(1, 4), (2, 8), (3, 8), (4, 10)])
def test_recovers_smooth_sequences_of_rank_k(rank, size):
    tracks, shapes, rotations = smooth_sequence(rank=rank, size=size)
    found, solution = solution_of(tracks, rotations, rank=rank, basis_size=size)
    assert shape_error(found, shapes, "none") < 1e-8
    assert solution.stop_reason == "exact"
    assert len(solution.history["energy"]) == solution.iterations


def test_chooses_k():
    tracks, shapes, rotations = smooth_sequence(rank=3)
    result = reconstruct(tracks, "csf1", rotations, **EXACT)
    assert result.diagnostics["chosen"] == {"rank": 3, "basis_size": 30}
    assert shape_error(result, shapes, "none") < 1e-4


def test_recovers_cameras_too():
    """With a constant shape added, the triplet that the camera estimator looks for exists."""
    _, shapes, rotations = smooth_sequence(frames=120, rank=2)
    shapes = shapes + np.random.default_rng(8).standard_normal(shapes.shape[1:])
    shapes -= shapes.mean(axis=1, keepdims=True)
    result = reconstruct((shapes @ rotations.transpose(0, 2, 1))[..., :2], "csf1", rank=3, **EXACT)
    assert camera_frame_error(result, shapes, rotations) < 1e-3


def test_one_cell_compressed_is_all_points(sequence):
    data = sequence(noise=0.05)
    small, _ = solution_of(data.tracks, data.rotations, basis_size=12)
    full, _ = solution_of(data.tracks, data.rotations, points=True, basis_size=12)
    np.testing.assert_allclose(small, full, rtol=0, atol=1e-5 * np.abs(full).max())


@pytest.mark.parametrize("switch", [{"rank": 1}, {"basis_size": 5}, {"max_iterations": 1}, {"least_gain": 0.5}])
def test_every_option_does_something(switch, sequence):
    data = sequence(noise=0.05, rank=3)
    common = {"rank": 3, "basis_size": 12}
    plain, _ = solution_of(data.tracks, data.rotations, **common)
    other, _ = solution_of(data.tracks, data.rotations, **(common | switch))
    assert np.abs(other - plain).max() > 1e-4 * np.abs(plain).max()


def test_a_camera_at_rest_gives_no_depth_and_no_overflow(sequence):
    data = sequence()
    still = np.repeat(np.eye(3)[None], len(data.tracks), axis=0)
    found, _ = solution_of(data.tracks, still, rank=2)
    assert np.abs(found[..., 2]).max() < 1e-6 * np.abs(found).max()


def test_default_basis_size():
    assert [default_basis_size(f, None) for f in (3, 30, 99, 1102)] == [3, 30, 30, 111]
    assert default_basis_size(200, 40) == 40


@pytest.mark.parametrize(
    ("name", "rank", "expected"), [("pickup", 6, 0.0273), ("yoga", 7, 0.0285), ("stretch", 8, 0.0294)]
)
def test_published_numbers(name, rank, expected, data_root):
    from nrsfm.datasets import load

    data = load(name, data_root)
    result = reconstruct(data.tracks, "csf1", rank=rank)
    assert camera_frame_error(result, data.shapes, data.rotations) < 1.05 * expected
