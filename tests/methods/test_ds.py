"""DS: its minimum against dense and conic solvers, its own assumptions, outliers, its neighbours."""

import numpy as np
import pytest

from nrsfm.methods.base import Problem
from nrsfm.methods.ds import Ds, DsOptions, normal_matrices
from nrsfm.metrics import shape_error
from nrsfm.neighbours import find_neighbours, laplacian
from nrsfm.pipeline import reconstruct


def solve(problem, **options):
    settings = {"change": 1e-8, "max_iterations": 400} | options
    return Ds().solve(problem, DsOptions(**settings), np.random.default_rng(0), lambda fraction: None)


@pytest.fixture
def small(sequence):
    data = sequence(frames=5, points=12, rank=2, noise=0.05)
    tracks = data.tracks.transpose(0, 2, 1)
    tracks = tracks - tracks.mean(axis=2, keepdims=True)
    tracks /= np.sqrt(np.mean(tracks**2))
    tracks[2, :, 5] += 1.5
    return Problem(tracks, np.array([0, 12]), np.array([12]), np.ascontiguousarray(data.rotations[:, :2]), 0.05)


@pytest.mark.parametrize("order", [1, 2])
def test_least_squares_equal_a_dense_solve(small, order):
    found = solve(small, temporal_weight=0.7, spatial_weight=1e-3, huber=1e6, differences=order, neighbours=3)
    graph = laplacian(find_neighbours(small.tracks, DsOptions(neighbours=3))).toarray()
    seen, rough = normal_matrices(small.rotations, order)
    whole = np.kron(seen + 0.7 * rough, np.eye(12)) + 1e-3 * np.kron(np.eye(15), graph.T @ graph)
    right = small.initial_shapes.reshape(-1)
    np.testing.assert_allclose(found.shapes.reshape(-1), np.linalg.solve(whole, right), atol=1e-6)
    assert (found.iterations, found.chosen["outliers"]) == (1, 0.0)


def test_differences_over_frames():
    rows = np.tile(np.eye(3)[:2], (6, 1, 1))
    shapes = np.random.default_rng(0).standard_normal((6, 3))
    for order in (1, 2):
        seen, rough = normal_matrices(rows, order)
        flat = shapes.reshape(-1)
        np.testing.assert_allclose(flat @ rough @ flat, np.sum(np.diff(shapes, n=order, axis=0) ** 2))
        np.testing.assert_allclose(flat @ seen @ flat, np.sum(shapes[:, :2] ** 2))


def test_reaches_the_minimum_that_a_conic_solver_finds(small):
    cvxpy = pytest.importorskip("cvxpy")
    found = solve(small, temporal_weight=0.5, spatial_weight=1e-4, huber=0.1, neighbours=3)
    graph = laplacian(find_neighbours(small.tracks, DsOptions(neighbours=3))).toarray()
    shapes = cvxpy.Variable((15, 12))
    cost = 0.5e-4 * cvxpy.sum_squares(shapes @ graph.T) + 0.25 * cvxpy.sum_squares(shapes[3:] - shapes[:-3])
    for f in range(5):
        residual = small.tracks[f] - small.rotations[f] @ shapes[3 * f : 3 * f + 3]
        cost += 0.5 * cvxpy.sum(cvxpy.huber(cvxpy.norm(residual, 2, axis=0), 0.1))
    problem = cvxpy.Problem(cvxpy.Minimize(cost))
    problem.solve(solver="CLARABEL")
    assert found.stop_reason == "outliers settled"
    np.testing.assert_allclose(found.history["energy"][-1], problem.value, rtol=1e-6)
    np.testing.assert_allclose(found.shapes.reshape(15, 12), shapes.value, atol=1e-3)
    assert 0 < found.chosen["outliers"] < 1


def test_a_rigid_shape_is_found_exactly(sequence):
    """No change over frames costs nothing; without weight on space nothing pulls."""
    data = sequence(frames=30, points=60, rank=1)
    rigid = np.repeat(data.shapes[:1], 30, axis=0)
    tracks = (rigid @ data.rotations.transpose(0, 2, 1))[..., :2]
    result = reconstruct(tracks, "ds", data.rotations, spatial_weight=0.0, precision="float64", noise_level=0.0)
    assert shape_error(result, rigid, "none") < 1e-6


def test_wrong_tracks_hardly_pull(sequence):
    data = sequence(frames=30, points=80, rank=1)
    rigid = np.repeat(data.shapes[:1], 30, axis=0)
    tracks = (rigid @ data.rotations.transpose(0, 2, 1))[..., :2]
    rng = np.random.default_rng(0)
    wrong = rng.random((30, 80)) < 0.05
    tracks = tracks + wrong[..., None] * rng.standard_normal((30, 80, 2)) * 3 * np.abs(tracks).mean()
    options = {"spatial_weight": 0.0, "noise_level": 0.0, "temporal_weight": 100.0, "outliers": False}
    errors = [
        shape_error(reconstruct(tracks, "ds", data.rotations, huber=huber, **options), rigid, "none")
        for huber in (0.02, 1e3)
    ]
    assert errors[0] < 0.1 * errors[1]


def test_spatial_weight_takes_noise_away(sequence):
    """A smooth sheet: neighbours know better than a point's own noise."""
    rows, columns = np.mgrid[:16, :16] / 8.0 - 1.0
    sheet = np.column_stack([columns.ravel(), rows.ravel(), 0.4 * (columns * rows).ravel()])
    data = sequence(frames=20, points=4)
    shapes = np.repeat(sheet[None], 20, axis=0)
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    tracks = (shapes @ data.rotations.transpose(0, 2, 1))[..., :2]
    tracks = tracks + 0.05 * np.random.default_rng(0).standard_normal(tracks.shape)
    pixels = np.rint(8 * (sheet[:, :2] + 1)).astype(int)
    errors = [
        shape_error(
            reconstruct(tracks, "ds", data.rotations, grid=pixels, spatial_weight=weight, temporal_weight=1.0),
            shapes,
            "none",
        )
        for weight in (1e-12, 1e-4)
    ]
    assert errors[1] < 0.8 * errors[0]


def test_a_mesh_may_be_renumbered_with_its_points(small):
    faces = np.array([[i, i + 1, i + 2] for i in range(10)])
    order = np.random.default_rng(0).permutation(12)
    plain = solve(small, faces=faces)
    turned = Problem(small.tracks[:, :, order], small.offsets, small.sizes, small.rotations, small.noise)
    moved = solve(turned, faces=np.argsort(order)[faces])
    np.testing.assert_allclose(moved.shapes, plain.shapes[:, :, order], atol=1e-6)
