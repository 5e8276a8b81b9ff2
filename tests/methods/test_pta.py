"""PTA recovers trajectories that are sums of cosines, and chooses how many."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure, uncompressed
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.trajectory import dct_basis
from nrsfm.metrics import camera_frame_error, rotation_error, shape_error
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}


def cosine_shapes(frames=40, points=30, rank=4, seed=0):
    """Shapes whose trajectories are sums of ``rank`` cosines, and fast, wandering cameras."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    weights = rng.standard_normal((rank, 3 * points)) / np.arange(1, rank + 1)[:, None] ** 2
    shapes = (dct_basis(frames, rank) @ weights).reshape(frames, points, 3)
    shapes -= shapes.mean(axis=1, keepdims=True)
    vectors = np.cumsum(rng.standard_normal((frames, 3)), axis=0) * 0.5
    rotations = Rotation.from_rotvec(vectors).as_matrix()
    return (shapes @ rotations.transpose(0, 2, 1))[..., :2], shapes, rotations


@pytest.mark.parametrize("rank", [1, 3, 6])
def test_recovers_cosine_trajectories(rank):
    tracks, shapes, rotations = cosine_shapes(rank=rank)
    result = reconstruct(tracks, "pta", rotations, rank=rank, **EXACT)
    assert shape_error(result, shapes, "none") < 1e-10
    assert result.diagnostics["history"]["energy"][-1] < 1e-15


def test_chooses_the_number_of_cosines():
    tracks, shapes, rotations = cosine_shapes(rank=4)
    result = reconstruct(tracks, "pta", rotations, **EXACT)
    assert result.diagnostics["chosen"]["rank"] == 4
    assert shape_error(result, shapes, "none") < 1e-10


def test_recovers_cameras_too():
    """The constant trajectory's triplet exists exactly; slow cosines leave a valley in which its cost is 1e-20."""
    tracks, shapes, rotations = cosine_shapes(frames=80, rank=3, seed=1)
    result = reconstruct(tracks, "pta", rank=3, **EXACT)
    assert rotation_error(result, rotations) < 0.5
    assert camera_frame_error(result, shapes, rotations) < 0.01


def test_one_cell_compressed_is_all_points(sequence):
    data = sequence(noise=0.05)
    measured = measure(data.tracks)
    rows = np.ascontiguousarray(data.rotations[:, :2])
    method = get_method("pta")
    shapes = []
    for small in (compress(measured, np.zeros(measured.count, dtype=int)), uncompressed(measured)):
        problem = Problem(small.factors, small.offsets, small.sizes, rows, 0.05)
        solution = method.solve(problem, method.Options(), np.random.default_rng(0), lambda _: None)
        shapes.append(small.expand(solution.shapes, np.dtype(np.float64)))
    np.testing.assert_allclose(shapes[0], shapes[1], rtol=0, atol=1e-8 * np.abs(shapes[1]).max())


def test_rank_too_large_is_clamped_and_said(sequence):
    data = sequence(frames=12)
    result = reconstruct(data.tracks, "pta", data.rotations, rank=99)
    assert result.diagnostics["chosen"]["rank"] == 8
    assert any("rank 99 is more than 12 frames allow: 8 is used" in text for text in result.diagnostics["warnings"])


@pytest.mark.parametrize(
    ("name", "rank", "expected"), [("pickup", 12, 0.0415), ("yoga", 11, 0.0379), ("stretch", 12, 0.0567)]
)
def test_published_numbers(name, rank, expected, data_root):
    from nrsfm.datasets import load

    data = load(name, data_root)
    result = reconstruct(data.tracks, "pta", rank=rank)
    assert camera_frame_error(result, data.shapes, data.rotations) < 1.05 * expected
