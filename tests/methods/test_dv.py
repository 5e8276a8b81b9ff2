"""DV: its minimum against a conic solver, its own assumptions, its cameras, its neighbours."""

import numpy as np
import pytest

from nrsfm.methods.base import Problem
from nrsfm.methods.dv import Dv, DvOptions
from nrsfm.metrics import camera_frame_error, rotation_error, shape_error
from nrsfm.neighbours import find_neighbours, gradient
from nrsfm.pipeline import reconstruct


def grid(height, width):
    rows, columns = np.mgrid[:height, :width]
    return np.column_stack([columns.ravel(), rows.ravel()])


def solve(problem, **options):
    settings = {"change": 1e-7, "max_iterations": 4000} | options
    return Dv().solve(problem, DvOptions(**settings), np.random.default_rng(0), lambda fraction: None)


@pytest.fixture
def small(sequence):
    data = sequence(frames=4, points=12, rank=2, noise=0.05)
    tracks = data.tracks.transpose(0, 2, 1)
    tracks = tracks - tracks.mean(axis=2, keepdims=True)
    tracks /= np.sqrt(np.mean(tracks**2))
    return Problem(tracks, np.array([0, 12]), np.array([12]), np.ascontiguousarray(data.rotations[:, :2]), 0.05)


@pytest.mark.parametrize("options", [{"grid": grid(3, 4)}, {"neighbours": 3}])
def test_reaches_the_minimum_that_a_conic_solver_finds(small, options):
    cvxpy = pytest.importorskip("cvxpy")
    variation, gamma = 0.01, 0.05
    found = solve(small, variation=variation, gamma=gamma, **options)
    operator, owners = gradient(find_neighbours(small.tracks, DvOptions(**options)))
    shapes = cvxpy.Variable((12, 12))  # rows: frame and coordinate
    cost = (
        gamma
        * np.sqrt(12)
        * cvxpy.normNuc(cvxpy.vstack([cvxpy.hstack([shapes[3 * f + c] for c in range(3)]) for f in range(4)]))
    )
    for f in range(4):
        cost += 0.5 * cvxpy.sum_squares(small.tracks[f] - small.rotations[f] @ shapes[3 * f : 3 * f + 3])
    slopes = operator.toarray() @ shapes.T
    for i in np.unique(owners):
        cost += variation * cvxpy.sum(cvxpy.norm(slopes[np.flatnonzero(owners == i)], 2, axis=0))
    problem = cvxpy.Problem(cvxpy.Minimize(cost))
    problem.solve(solver="CLARABEL")
    np.testing.assert_allclose(found.history["energy"][-1], problem.value, rtol=1e-5)
    np.testing.assert_allclose(found.shapes.reshape(12, 12), shapes.value, atol=2e-3)
    assert found.stop_reason == "shapes settled"


def test_flat_pieces_are_found_and_their_edge_stays(sequence):
    """Two halves of a grid, each in one place, turning: as the cameras see them the noise goes, the jump does not."""
    data = sequence(frames=20, points=2, rank=1)
    pixels = grid(8, 16)
    half = (pixels[:, 0] >= 8).astype(int)
    clean = data.tracks[:, half]
    jump = np.linalg.norm(data.tracks[:, 1] - data.tracks[:, 0])
    tracks = clean + 0.02 * np.abs(data.shapes).max() * np.random.default_rng(0).standard_normal((20, 128, 2))
    errors = {}
    for variation in (0.0, 0.005):
        result = reconstruct(tracks, "dv", data.rotations, grid=pixels, variation=variation, gamma=0.02)
        seen = np.einsum("fij,fpj->fpi", result.rotations, result.shapes)[..., :2] + result.translations[:, None]
        errors[variation] = np.sqrt(np.mean((seen - clean) ** 2))
    sides = [seen[:, half == side].mean(axis=1) for side in (0, 1)]
    assert errors[0.005] < 0.5 * errors[0.0]
    assert np.linalg.norm(sides[1] - sides[0]) > 0.95 * jump


def test_a_low_rank_sequence_is_found_without_weights(sequence):
    data = sequence(frames=40, points=60, rank=1)
    options = {"variation": 0.0, "gamma": 1e-5, "noise_level": 0.0, "max_iterations": 20}
    assert shape_error(reconstruct(data.tracks, "dv", data.rotations, **options), data.shapes, "none") < 1e-3


def test_cameras_follow_the_shapes(sequence):
    """A rigid factorisation is a little wrong where the shape bends; given cameras stay as they are."""
    data = sequence(frames=40, points=80, rank=2)
    before, after = (reconstruct(data.tracks, "dv", joint=joint, gauge="method") for joint in (False, True))
    assert rotation_error(after, data.rotations) < rotation_error(before, data.rotations)
    assert camera_frame_error(after, data.shapes, data.rotations) < camera_frame_error(
        before, data.shapes, data.rotations
    )
    known = reconstruct(data.tracks, "dv", data.rotations, joint=True)
    np.testing.assert_allclose(known.rotations, data.rotations, atol=1e-12)


def test_float32_of_large_problems_is_accurate(small, monkeypatch):
    exact = solve(small, change=1e-4)
    monkeypatch.setattr("nrsfm.methods.dv._LARGE", 1)
    np.testing.assert_allclose(solve(small, change=1e-4).shapes, exact.shapes, atol=1e-3)


def test_a_mesh_may_be_renumbered_with_its_points(small):
    pixels = grid(3, 4)
    corner = np.flatnonzero((pixels < [3, 2]).all(axis=1))
    faces = np.column_stack([corner, corner + 1, corner + 5, corner + 4])
    order = np.random.default_rng(0).permutation(12)
    plain = solve(small, faces=faces, change=1e-5)
    turned = Problem(small.tracks[:, :, order], small.offsets, small.sizes, small.rotations, small.noise)
    moved = solve(turned, faces=np.argsort(order)[faces], change=1e-5)
    np.testing.assert_allclose(moved.shapes, plain.shapes[:, :, order], atol=1e-8)
    assert plain.chosen["neighbours"] == "mesh"
