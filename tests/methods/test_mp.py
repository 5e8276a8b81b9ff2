"""MP finds sequences that satisfy its assumptions exactly; its pieces agree with independent oracles."""

from dataclasses import replace

import numpy as np
import pytest

from nrsfm import datasets
from nrsfm.manifolds.motion import descend, motion_matrix
from nrsfm.manifolds.stiefel import polar_rows, turned
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.mp import MpOptions
from nrsfm.metrics import camera_frame_error, shape_error
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}


def problem_of(data, *, known=False, noise=0.0):
    centred = data.tracks - data.tracks.mean(axis=1, keepdims=True)
    tracks = centred.transpose(0, 2, 1) / np.sqrt(np.mean(centred**2))
    count = tracks.shape[2]
    rows = np.ascontiguousarray(data.rotations[:, :2])
    return Problem(tracks, np.array([0, count]), np.array([count]), rows, noise, cameras_known=known)


def solved(problem, **options):
    return get_method("mp").solve(problem, MpOptions(**options), np.random.default_rng(0), lambda _: None)


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_recovers_low_rank_sequences_with_its_own_cameras(rank, sequence):
    data = sequence(rank=rank, frames=40)
    result = reconstruct(data.tracks, "mp", **EXACT)
    assert result.diagnostics["chosen"]["rank"] == rank
    assert camera_frame_error(result, data.shapes, data.rotations) < 1e-6


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_recovers_low_rank_sequences_with_known_cameras_and_leaves_them(rank, sequence):
    data = sequence(rank=rank)
    result = reconstruct(data.tracks, "mp", data.rotations, **EXACT)
    np.testing.assert_allclose(result.rotations, data.rotations, atol=1e-12)
    assert shape_error(result, data.shapes, "none") < 1e-6


def test_cameras_of_a_wrong_start_are_mended(sequence):
    """Rigid cameras on a sequence that deforms by half are some degrees off; the joint descent puts them right."""
    data = sequence(rank=2, frames=40)
    for starts in ("given", "several"):
        result = reconstruct(data.tracks, "mp", rank=2, starts=starts, **EXACT)
        assert camera_frame_error(result, data.shapes, data.rotations) < 1e-6


@pytest.mark.parametrize(("ridge", "fixed"), [(0.05, False), (0.05, True), (0.0, True)])
def test_no_general_least_squares_solver_gets_lower(ridge, fixed):
    """The same objective, every unknown explicit, by finite differences and from the solution found and beside it."""
    least_squares = pytest.importorskip("scipy.optimize").least_squares
    rng = np.random.default_rng(7)
    frames, points, rank = 7, 8, 2
    tracks = rng.standard_normal((frames, 2, points))
    weights, rows = rng.standard_normal((frames, rank)), polar_rows(rng.standard_normal((frames, 2, 3)))
    found = descend(tracks, weights, rows, ridge=ridge, iterations=3000, tolerance=1e-13, fixed=fixed)
    size = np.sum(tracks**2)

    def residual(x):
        turns, w, basis = np.split(x, [3 * frames, 3 * frames + frames * rank])
        moved = found.rows if fixed else turned(found.rows, turns.reshape(frames, 3))
        shapes = np.tensordot(w.reshape(frames, rank), basis.reshape(rank, 3, points), axes=1)
        bend = np.sqrt(ridge) * (shapes - shapes.mean(axis=0))
        return np.concatenate([(tracks - moved @ shapes).ravel(), bend.ravel()])

    solution = np.concatenate([np.zeros(3 * frames), found.weights.ravel(), found.basis.ravel()])
    assert np.sum(residual(solution) ** 2) / size == pytest.approx(found.energy, rel=1e-9)
    for spread in (0.0, 1e-2):
        other = least_squares(residual, solution + spread * rng.standard_normal(len(solution)), max_nfev=60)
        assert 2 * other.cost / size > found.energy * (1 - 1e-4)


@pytest.mark.parametrize("fixed", [False, True])
def test_the_energy_never_rises_and_the_basis_is_optimal(fixed, sequence):
    problem = problem_of(sequence(frames=15, points=30, rank=3, noise=0.02))
    weights = np.random.default_rng(1).standard_normal((15, 2))
    found = descend(problem.tracks, weights, problem.rotations, ridge=0.0, iterations=30, tolerance=1e-8, fixed=fixed)
    assert np.all(np.diff(found.energies) < 0)
    flat = problem.tracks.reshape(30, -1)
    matrix = motion_matrix(found.weights, found.rows)
    residual = flat - matrix @ found.basis.reshape(6, -1)
    assert np.abs(matrix.T @ residual).max() < 1e-9
    assert np.sum(residual**2) / np.sum(flat**2) == pytest.approx(found.energy)
    if fixed:
        np.testing.assert_array_equal(found.rows, problem.rotations)


def test_joint_descent_is_far_below_the_published_alternation(sequence):
    data = sequence(frames=30, points=40, rank=3, noise=0.01)
    problem = problem_of(data)
    off = turned(problem.rotations, 0.2 * np.random.default_rng(2).standard_normal((30, 3)))
    problem = replace(problem, rotations=off)
    published = solved(problem, rank=3, max_iterations=0, alternations=100)
    joint = solved(problem, rank=3, ridge=0.0, starts="given")
    assert published.stop_reason == "alternation"
    assert published.chosen["ridge"] == 0.0
    assert joint.chosen["reprojection"] < 0.9 * published.chosen["reprojection"]


def test_rank_follows_the_tracks_and_the_noise_and_cannot_exceed_what_they_hold(sequence):
    data = sequence(rank=3, frames=30)
    assert solved(problem_of(data)).chosen["rank"] == 3
    assert solved(problem_of(data, noise=0.3)).chosen["rank"] < 3
    clamped = solved(problem_of(data), rank=7)
    assert clamped.chosen["rank"] == 3
    assert "rank 7" in clamped.warnings[0]


def test_ridge_keeps_shapes_nearer_their_mean(sequence):
    problem = problem_of(sequence(frames=12, points=40, rank=3, noise=0.05))
    spread = []
    for ridge in (0.0, 0.01, 1.0):
        found = solved(problem, rank=3, ridge=ridge)
        assert found.chosen["ridge"] == ridge
        spread.append(np.sum((found.shapes - found.shapes.mean(axis=0)) ** 2))
    assert spread[0] > spread[1] > spread[2]


def test_more_starts_are_tried_and_never_end_higher(sequence):
    problem = problem_of(sequence(frames=20, points=40, rank=3, noise=0.03))
    one, many = (solved(problem, rank=2, ridge=0.01, starts=starts) for starts in ("given", "several"))
    assert one.chosen["starts"] == 1 < many.chosen["starts"]
    assert many.history["energy"][-1] <= one.history["energy"][-1] * (1 + 1e-3)


def test_virtual_points_give_the_shapes_of_the_real_ones(sequence):
    problem = problem_of(sequence(frames=12, points=90, rank=2, noise=0.01))
    flat = problem.tracks.reshape(24, -1)
    left, values, right = np.linalg.svd(flat, full_matrices=False)
    virtual = Problem(
        (left * values).reshape(12, 2, -1), np.array([0, 24]), problem.sizes, problem.rotations, 0.0, False
    )
    small, full = solved(virtual, rank=2), solved(problem, rank=2)
    np.testing.assert_allclose(small.shapes @ right, full.shapes, atol=1e-6)
    np.testing.assert_allclose(small.rotations, full.rotations, atol=1e-6)


def test_first_camera_is_the_object_frame_and_rows_are_orthonormal(sequence):
    found = solved(problem_of(sequence(frames=15, noise=0.02)))
    np.testing.assert_allclose(found.rotations[0], np.eye(3)[:2], atol=1e-12)
    squares = found.rotations @ found.rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(2), squares.shape), atol=1e-12)


def test_pickup_is_at_least_as_good_as_published(data_root):
    data = datasets.load("pickup", data_root)
    result = reconstruct(data.tracks, "mp", rank=5, starts="given")
    assert camera_frame_error(result, data.shapes, data.rotations) < 0.0597 * 1.05
