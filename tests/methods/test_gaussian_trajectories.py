"""Gaussian over trajectories: its formulas against brute force, its laws, and recovery of its own model."""

from dataclasses import replace

import numpy as np
import pytest

from nrsfm.manifolds.quaternions import turn_gradient, turned_rows
from nrsfm.methods.base import Problem
from nrsfm.methods.gaussian_trajectories import (
    EVEN,
    LARGEST_FRAMES,
    LOCAL_PRIOR,
    UNRELATED,
    Model,
    Objective,
    applies,
    cell_moments,
    first_model,
    local_covariances,
    posterior_mean,
    refine,
    track_covariance,
    unevenness,
    with_spreads,
)


def spd(rng, size, least=0.1):
    """A positive definite matrix without structure."""
    root = rng.standard_normal((size, size))
    return root @ root.T / size + least * np.eye(size)


def turning_rows(rng, frames, spread=0.6):
    """Camera rows (F, 2, 3) scattered about one view."""
    base = np.tile(np.eye(3)[:2], (frames, 1, 1))
    return turned_rows(base, np.concatenate([np.ones((frames, 1)), 0.5 * spread * rng.standard_normal((frames, 3))], 1))


def small_model(seed=0, frames=5, noise=0.02):
    rng = np.random.default_rng(seed)
    directions = spd(rng, 3)
    directions *= 3.0 / np.trace(directions)
    rows = turning_rows(rng, frames)
    return Model(rows, 0.1 * spd(rng, frames), directions, spd(rng, 3), noise, np.array([0.5, 2.0])), rng


def explicit(model, spread=1.0):
    """Covariances of shapes (3F, 3F), coordinate by coordinate within a frame, and H (2F, 3F)."""
    frames = len(model.rows)
    ones = np.ones((frames, frames))
    prior = np.kron(model.frames, model.directions) + spread * np.kron(ones, model.mean)
    seen = np.zeros((2 * frames, 3 * frames))
    for f, rows in enumerate(model.rows):
        seen[2 * f : 2 * f + 2, 3 * f : 3 * f + 3] = rows
    return prior, seen


def drawn(frames=10, points=3000, noise=0.0, seed=0, cells=3):
    """Shapes (F, 3, P) that follow the model, the true model, and a problem with cameras that are 5 degrees off."""
    rng = np.random.default_rng(seed)
    rows = turning_rows(rng, frames)
    modes = rng.standard_normal((frames, 3)) * np.array([0.3, 0.2, 0.1])
    covariance = modes @ modes.T + 1e-4 * np.eye(frames)
    spreads = np.linspace(0.3, 1.7, cells)
    mean = rng.standard_normal((3, points)) * np.array([1.0, 1.2, 0.7])[:, None]
    scale = np.sqrt(np.repeat(spreads, points // cells))
    change = np.linalg.cholesky(covariance) @ rng.standard_normal((3, frames, points)) * scale
    shapes = mean + change.transpose(1, 0, 2)
    shapes -= shapes.mean(axis=2, keepdims=True)
    tracks = rows @ shapes + noise * rng.standard_normal((frames, 2, points))
    sizes = np.full(cells, points // cells)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    wrong = turned_rows(rows, np.concatenate([np.ones((frames, 1)), 0.04 * rng.standard_normal((frames, 3))], 1))
    model = Model(rows, covariance, np.eye(3), np.diag([1.0, 1.44, 0.49]), 4e-6, spreads)
    return shapes, model, Problem(tracks, offsets, sizes, wrong, noise, cameras_known=False)


def frame_errors(rows, shapes, true_rows, truth):
    """Relative error of each frame after its own rotation."""
    errors = []
    for f in range(len(truth)):
        left, _, right = np.linalg.svd(truth[f] @ shapes[f].T)
        errors.append(np.linalg.norm(left @ right @ shapes[f] - truth[f]) / np.linalg.norm(truth[f]))
    return np.array(errors)


def test_covariance_is_that_of_projected_shapes():
    model, _ = small_model()
    prior, seen = explicit(model, spread=3.0)
    expected = seen @ prior @ seen.T + model.noise * np.eye(len(seen))
    np.testing.assert_allclose(track_covariance(model, spread=3.0), expected, atol=1e-12)


def test_posterior_mean_is_gaussian_conditioning():
    model, rng = small_model()
    tracks = rng.standard_normal((len(model.rows), 2, 7))
    prior, seen = explicit(model, spread=4.0)
    covariance = seen @ prior @ seen.T + model.noise * np.eye(len(seen))
    expected = prior @ seen.T @ np.linalg.solve(covariance, tracks.reshape(len(seen), -1))
    found = posterior_mean(model, model.frames, tracks)
    np.testing.assert_allclose(found, expected.reshape(len(model.rows), 3, -1), atol=1e-10)


@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("moves", [True, False])
def test_gradient_matches_differences(moves, near):
    model, rng = small_model()
    anchor = turning_rows(np.random.default_rng(9), len(model.rows))
    objective = Objective(model, spd(rng, 2 * len(model.rows)), anchor, move_cameras=moves, near=near)
    at = objective.start + 0.05 * rng.standard_normal(len(objective.start))
    _, gradient = objective(at)
    step = 1e-6
    slopes = [(objective(at + step * e)[0] - objective(at - step * e)[0]) / (2 * step) for e in np.eye(len(at))]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-5 * np.abs(gradient).max())


def test_objective_is_least_at_the_truth_among_covariances():
    """Without the priors' pull the likelihood of exact moments is greatest at the model that made them."""
    model, _ = small_model()
    moment = track_covariance(model)
    objective = Objective(model, moment, model.rows, move_cameras=False, near=True)
    _, gradient = objective(objective.start)
    frames = len(model.rows)
    for part, weight, matrix in (
        (gradient[: frames * frames], UNRELATED, model.frames),
        (gradient[-9:], EVEN, model.directions),
    ):
        factor = np.linalg.cholesky(matrix)
        expected = 2.0 * weight * factor.T @ unevenness(matrix)[1] @ factor
        np.testing.assert_allclose(part.reshape(matrix.shape), expected, atol=1e-5)


def test_unevenness_is_free_of_size_and_zero_for_the_identity():
    rng = np.random.default_rng(3)
    matrix = spd(rng, 6)
    assert unevenness(matrix)[0] > 0.1
    assert unevenness(7.0 * matrix)[0] == pytest.approx(unevenness(matrix)[0])
    assert unevenness(0.2 * np.eye(6))[0] == pytest.approx(0.0, abs=1e-12)
    assert abs(np.sum(unevenness(matrix)[1] * matrix)) < 1e-9  # no slope along the size


def test_quaternions_turn_and_have_that_gradient():
    rng = np.random.default_rng(4)
    rows, turns, slope = turning_rows(rng, 4), rng.standard_normal((4, 4)), rng.standard_normal((4, 2, 3))
    turned = turned_rows(rows, turns)
    np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.tile(np.eye(2), (4, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(turned_rows(rows, np.tile([2.0, 0, 0, 0], (4, 1))), rows, atol=1e-12)
    found = turn_gradient(rows, turns, slope)
    for f, i in np.ndindex(4, 4):
        step = np.zeros((4, 4))
        step[f, i] = 1e-6
        change = np.sum(slope * (turned_rows(rows, turns + step) - turned_rows(rows, turns - step))) / 2e-6
        assert found[f, i] == pytest.approx(change, abs=1e-7)


def test_spreads_are_recovered_from_exact_moments():
    model, _ = small_model(noise=0.0)
    moments = np.stack([track_covariance(model, v * model.frames) for v in (0.5, 2.0)])
    np.testing.assert_allclose(with_spreads(model, moments).spreads, [0.5, 2.0], rtol=1e-8)


def test_local_step_is_expectation_maximisation():
    """One step by brute force: the expected second moment of the deformation, and the prior's share."""
    model, rng = small_model(frames=60)  # so many frames take the fewest rounds
    rounds = 5
    moment = track_covariance(model, spd(rng, 60)) * 0.5
    prior_frames = model.spreads[0] * model.frames
    frames = prior_frames
    for _ in range(rounds):
        step = replace(model, frames=frames)
        prior, seen = explicit(step, spread=4.0)
        change = np.kron(frames, model.directions)
        covariance = seen @ prior @ seen.T + model.noise * np.eye(len(seen))
        gain = change @ seen.T @ np.linalg.inv(covariance)
        second = change + gain @ (moment - covariance) @ gain.T
        blocks = second.reshape(60, 3, 60, 3)
        best = np.einsum("ce,fcge->fg", np.linalg.inv(model.directions), blocks) / 3.0
        frames = (best + LOCAL_PRIOR * prior_frames) / (1.0 + LOCAL_PRIOR)
    found = local_covariances(replace(model, spreads=model.spreads[:1]), moment[None])[0]
    np.testing.assert_allclose(found, frames, rtol=1e-6, atol=1e-8)


def test_recovers_its_own_model_from_wrong_cameras():
    shapes, truth, problem = drawn()
    start = problem.initial_shapes
    found, rows, info = refine(problem, start)
    assert info["applied"]
    assert info["turned"] < 20.0
    errors = frame_errors(rows, found, truth.rows, shapes)
    best = np.concatenate(
        [
            posterior_mean(truth, v * truth.frames, problem.tracks[:, :, a:b])
            for v, a, b in zip(truth.spreads, problem.offsets[:-1], problem.offsets[1:], strict=True)
        ],
        axis=2,
    )
    bound = frame_errors(truth.rows, best, truth.rows, shapes)
    assert errors.mean() < 1.5 * bound.mean() + 0.005
    assert errors.mean() < 0.3 * frame_errors(problem.rotations, start, truth.rows, shapes).mean()
    np.testing.assert_allclose(rows @ found, problem.tracks, atol=0.02)


def test_exact_on_the_compression():
    """Moments are the same and shapes expand to the same, so only rounding can tell the two runs apart."""
    _, truth, problem = drawn(points=600, cells=1, noise=0.05)
    small, back = problem.merged()
    assert small.tracks.shape[2] <= 20
    np.testing.assert_allclose(cell_moments(small)[0], cell_moments(problem)[0], atol=1e-12)
    direct = posterior_mean(truth, truth.frames, problem.tracks)
    np.testing.assert_allclose(posterior_mean(truth, truth.frames, small.tracks) @ back, direct, atol=1e-9)
    direct, rows, told = refine(problem, problem.initial_shapes)
    found, turned, again = refine(small, small.initial_shapes)
    assert again["cost"] == pytest.approx(told["cost"], abs=1e-4)
    assert np.linalg.norm(turned @ (found @ back) - rows @ direct) < 1e-3 * np.linalg.norm(direct)
    assert np.linalg.norm(found @ back - direct) < 0.01 * np.linalg.norm(direct)


def test_known_cameras_stay():
    _, _, problem = drawn(points=300)
    _, rows, info = refine(replace(problem, cameras_known=True), problem.initial_shapes)
    np.testing.assert_array_equal(rows, problem.rotations)
    assert info["applied"]
    assert info["turned"] < 1e-5


def test_first_guess_hardly_matters():
    """One optimum: another start for the shapes leads to the same answer."""
    _, _, problem = drawn(points=900)
    start = problem.initial_shapes
    one, _, _ = refine(problem, start)
    two, _, _ = refine(problem, 0.5 * start + 0.5 * start.mean(axis=0))
    assert np.linalg.norm(one - two) < 0.02 * np.linalg.norm(one)


def test_leaves_alone_what_it_is_not_for():
    _, _, problem = drawn(points=300)
    still = replace(problem, rotations=np.tile(problem.rotations[:1], (10, 1, 1)))
    few = replace(problem, sizes=np.array([9, 9, 9]))
    frames = LARGEST_FRAMES + 1
    many = replace(
        problem, tracks=np.zeros((frames, 2, 300)), rotations=np.tile(problem.rotations, (21, 1, 1))[:frames]
    )
    for wrong, word in ((still, "turns"), (few, "points"), (many, "frames")):
        assert word in str(applies(wrong))
        start = np.zeros((len(wrong.tracks), 3, 300))
        found, rows, info = refine(wrong, start)
        assert found is start
        assert rows is wrong.rotations
        assert not info["applied"]
        assert word in info["reason"]
    assert applies(problem) is None


@pytest.mark.parametrize("kind", ["rigid", "planar", "twice", "three frames", "still cell", "read-only"])
def test_degenerate_tracks_give_finite_shapes(kind):
    shapes, truth, problem = drawn(points=300, frames=3 if kind == "three frames" else 8)
    if kind == "rigid":
        problem = replace(problem, tracks=truth.rows @ np.tile(shapes[:1], (8, 1, 1)))
    if kind == "planar":
        problem = replace(problem, tracks=truth.rows[:, :, :2] @ shapes[:, :2])
    if kind == "twice":
        problem = replace(problem, tracks=np.tile(problem.tracks[:1], (8, 1, 1)))
    if kind == "still cell":
        problem.tracks[:, :, :100] = 0.0
    if kind == "read-only":
        problem.tracks.setflags(write=False)
    found, rows, info = refine(problem, problem.initial_shapes)
    assert info["applied"]
    assert np.isfinite(found).all()
    np.testing.assert_allclose(rows @ rows.transpose(0, 2, 1), np.tile(np.eye(2), (len(rows), 1, 1)), atol=1e-9)
    if kind == "rigid":
        change = found - found.mean(axis=0)
        assert np.linalg.norm(change) < 0.02 * np.linalg.norm(found)


def test_moments_are_means_over_real_points():
    _, _, problem = drawn(points=300)
    moments, sizes = cell_moments(problem)
    assert sizes.tolist() == [100, 100, 100]
    np.testing.assert_allclose(moments[1], np.cov(problem.tracks.reshape(20, -1)[:, 100:200], bias=True), atol=0.2)
    model = first_model(problem, problem.initial_shapes)
    np.linalg.cholesky(model.frames)
    np.linalg.cholesky(model.mean)


def test_betters_the_second_algorithm_on_real_expressions(data_root):
    """Twelve blendshape faces from all over a take: tuned on such sequences, so only a floor is asked."""
    from nrsfm import datasets, metrics
    from nrsfm.cameras import CameraOptions, estimate_cameras
    from nrsfm.clustering import kmeans
    from nrsfm.compression import compress, measure, spectrum, track_coordinates
    from nrsfm.methods import get_method

    sequence = datasets.load("ict-rom346", data_root, points=2000)
    frames = np.linspace(0, 345, 12).astype(int)
    truth = np.asarray(sequence.shapes)[frames]
    measured = measure(np.asarray(sequence.tracks.points)[frames])
    values, vectors = spectrum(measured)
    cameras = estimate_cameras(vectors * values, CameraOptions())
    rng = np.random.default_rng(0)
    cells = kmeans(track_coordinates(measured, vectors[:, :10]), 7, rng)
    packed = compress(measured, cells, tolerance=1e-4)
    problem = Problem(packed.factors, packed.offsets, packed.sizes, cameras.rotations[:, :2], 0.0, cameras_known=False)
    method = get_method("geometry-aware")
    before = method.solve(problem, method.Options(), rng, lambda _: None).shapes
    after, _, _ = refine(problem, before)
    errors = [
        metrics.shape_error(packed.expand(shapes, np.dtype("float64")), truth, "per-frame")
        for shapes in (before, after)
    ]
    assert errors[1] < 0.8 * errors[0]
