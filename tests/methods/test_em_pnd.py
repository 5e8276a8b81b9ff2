"""EM-PND: recovery of its own model, the law of EM, and its E-step against brute force."""

from dataclasses import replace

import numpy as np
import pytest

from nrsfm.manifolds.procrustes import onto_tangent_space, procrustes_directions
from nrsfm.methods.base import Problem
from nrsfm.methods.em_pnd import EmPnd, EmPndOptions, above_noise, initial_shapes
from nrsfm.methods.procrustean_normal import ProcrusteanNormal, leading_covariance, posterior
from nrsfm.metrics import rotation_error


def turning_cameras(rng, frames):
    """Cameras (F, 3, 3) that look from everywhere."""
    left, _ = np.linalg.qr(rng.standard_normal((frames, 3, 3)))
    left[:, 2] *= np.linalg.det(left)[:, None]
    return left


def gaussian_sequence(frames=60, points=14, modes=2, seed=0, size=0.15):
    """Tracks (F, P, 2), shapes (F, P, 3) and cameras: a Gaussian on the tangent space of a mean, without noise."""
    rng = np.random.default_rng(seed)
    mean = rng.standard_normal((3, points))
    mean -= mean.mean(axis=1, keepdims=True)
    mean /= np.linalg.norm(mean)
    modes_ = rng.standard_normal((modes, 3, points))
    modes_ -= modes_.mean(axis=2, keepdims=True)
    basis, _ = np.linalg.qr(onto_tangent_space(mean, modes_.reshape(modes, -1).T))
    weights = size * rng.standard_normal((frames, modes)) / np.sqrt(modes)
    shapes = mean + (weights @ basis.T).reshape(frames, 3, points)
    cameras = turning_cameras(rng, frames)
    tracks = (cameras @ shapes)[:, :2]
    return tracks.transpose(0, 2, 1), shapes.transpose(0, 2, 1), cameras


def solved(tracks, cameras, known, options, noise=0.0):
    """Shapes (F, 3, P) and cameras (F, 3, 3) that the method finds for centred tracks (F, P, 2)."""
    columns = tracks.transpose(0, 2, 1)
    left, values, right = np.linalg.svd(columns.reshape(2 * len(tracks), -1), full_matrices=False)
    live = values > 1e-10 * values[0]
    virtual = (left[:, live] * values[live]).reshape(len(tracks), 2, -1)
    offsets, sizes = np.array([0, virtual.shape[2]]), np.array([tracks.shape[1]])
    problem = Problem(virtual, offsets, sizes, cameras[:, :2], noise, cameras_known=known)
    found = EmPnd().solve(problem, options, np.random.default_rng(0), lambda _: None)
    rows = cameras[:, :2] if found.rotations is None else found.rotations
    full = np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
    return found.shapes @ right[live], full


def relative_errors(estimate, truth):
    """‖est − true‖/‖true‖ of each frame."""
    return np.linalg.norm(estimate - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))


def small_model(seed=0, frames=6, points=5, factors=4, spread=2e-3):
    """A model, tracks and alignment of no particular meaning."""
    rng = np.random.default_rng(seed)
    mean = rng.standard_normal((3, points))
    mean /= np.linalg.norm(mean)
    basis = onto_tangent_space(mean, 0.1 * rng.standard_normal((3 * points, factors)))
    model = ProcrusteanNormal(mean, basis, spread, 4e-3)
    sizes = rng.uniform(0.7, 1.3, frames)
    rows = turning_cameras(rng, frames)[:, :2]
    tracks = sizes[:, None, None] * (rows @ (mean + 0.1 * rng.standard_normal((frames, 3, points))))
    return model, tracks, rows, sizes


def brute_force(model, tracks, rows, sizes):
    """Means (F, 3N) and covariances (F, 3N, 3N) of y − M, from the full precision matrices."""
    size = model.mean.size
    projector = onto_tangent_space(model.mean, np.eye(size))
    prior = projector @ np.linalg.inv(model.basis @ model.basis.T + model.spread * np.eye(size)) @ projector
    means, covariances = [], []
    for w, r, c in zip(tracks, rows, sizes, strict=True):
        look = np.kron(c * r, np.eye(tracks.shape[2]))
        covariance = np.linalg.inv(prior + look.T @ look / model.noise)
        means.append(covariance @ look.T @ (w.reshape(-1) - look @ model.mean.reshape(-1)) / model.noise)
        covariances.append(covariance)
    return np.array(means), np.array(covariances), projector


def test_posterior_is_the_conditional_gaussian():
    model, tracks, rows, sizes = small_model()
    found = posterior(model, tracks, rows, sizes)
    means, covariances, projector = brute_force(model, tracks, rows, sizes)
    assert np.allclose(found.deviations.reshape(len(tracks), -1), means, atol=1e-7)
    moment = projector @ (covariances.mean(axis=0) + means.T @ means / len(tracks)) @ projector
    assert np.allclose(found.second_moment, moment, atol=1e-7)


def test_noise_is_the_expected_square_of_what_is_left():
    model, tracks, rows, sizes = small_model(1)
    found = posterior(model, tracks, rows, sizes)
    means, covariances, _ = brute_force(model, tracks, rows, sizes)
    total = 0.0
    for w, r, c, mean, covariance in zip(tracks, rows, sizes, means, covariances, strict=True):
        look = np.kron(c * r, np.eye(tracks.shape[2]))
        left = w.reshape(-1) - look @ (model.mean.reshape(-1) + mean)
        total += left @ left + np.trace(look @ covariance @ look.T)
    assert found.noise == pytest.approx(total / tracks.size, rel=1e-6)


def test_likelihood_is_the_gaussian_density_up_to_a_constant():
    model, tracks, rows, sizes = small_model(2)
    wide = 1e6  # the variance along the Procrustes directions that stands for a flat prior

    def density(m):
        directions = procrustes_directions(m.mean)
        covariance = m.basis @ m.basis.T + m.spread * np.eye(m.mean.size) + wide * directions @ directions.T
        total = 0.0
        for w, r, c in zip(tracks, rows, sizes, strict=True):
            look = np.kron(c * r, np.eye(tracks.shape[2]))
            seen = look @ covariance @ look.T + m.noise * np.eye(len(look))
            values, vectors = np.linalg.eigh((seen + seen.T) / 2)
            left = vectors.T @ (w.reshape(-1) - look @ m.mean.reshape(-1))
            total -= 0.5 * np.sum(left**2 / values) + 0.5 * np.sum(np.log(values))
        return total

    other = replace(model, basis=0.7 * model.basis, spread=3e-3, noise=6e-3)
    gap = posterior(model, tracks, rows, sizes).likelihood - posterior(other, tracks, rows, sizes).likelihood
    assert gap == pytest.approx(density(model) - density(other), abs=1e-3)


@pytest.mark.parametrize("factors", [3, 100])
def test_likelihood_never_decreases(factors):
    """EM over C and σ² with the alignment held, both for BBᵀ + κI and for an unrestricted C."""
    model, tracks, rows, sizes = small_model(3, frames=15, points=6)
    values = []
    for _ in range(60):
        found = posterior(model, tracks, rows, sizes)
        values.append(found.likelihood)
        basis, spread = leading_covariance(found.second_moment, factors)
        model = ProcrusteanNormal(model.mean, basis, spread, found.noise)
    assert (np.diff(values) > -1e-7 * np.abs(values[:-1])).all()
    assert values[-1] > values[0] + 1.0


def test_leading_covariance_keeps_the_trace_and_the_leading_directions():
    rng = np.random.default_rng(4)
    mean = rng.standard_normal((3, 8))
    data = onto_tangent_space(mean, rng.standard_normal((24, 60)) * np.linspace(2.0, 0.1, 24)[:, None])
    moment = data @ data.T / 60
    basis, spread = leading_covariance(moment, 5)
    full = basis @ basis.T + spread * onto_tangent_space(mean, np.eye(24))
    assert np.trace(full) == pytest.approx(np.trace(moment))
    assert np.allclose(np.linalg.eigvalsh(full)[-5:], np.linalg.eigvalsh(moment)[-5:])


def test_covariance_is_that_of_the_points():
    """Virtual points and real ones, C confined to the span of the tracks: one posterior."""
    model, tracks, rows, sizes = small_model(5, points=6, spread=0.0)
    orthonormal, _ = np.linalg.qr(np.random.default_rng(6).standard_normal((40, 6)))
    lift = np.kron(np.eye(3), orthonormal)
    real = replace(model, mean=model.mean @ orthonormal.T, basis=lift @ model.basis)
    small, large = posterior(model, tracks, rows, sizes), posterior(real, tracks @ orthonormal.T, rows, sizes)
    assert np.allclose(large.deviations, small.deviations @ orthonormal.T, atol=1e-9)
    assert np.allclose(large.second_moment, lift @ small.second_moment @ lift.T, atol=1e-9)


@pytest.fixture(scope="module")
def gaussian():
    """The sequence that the method's assumptions describe."""
    return gaussian_sequence()


RECOVERY = EmPndOptions(last_noise=1e-13, cooling=0.75, least_change=1e-7)


@pytest.mark.parametrize("known", [True, False])
def test_recovers_a_gaussian_on_the_tangent_space(gaussian, known):
    tracks, shapes, cameras = gaussian
    found, rotations = solved(tracks, cameras, known, RECOVERY)
    error = relative_errors(rotations @ found, cameras @ shapes.transpose(0, 2, 1))
    assert error.max() < 2e-4
    assert error.mean() < 2e-5
    if known:
        assert np.array_equal(rotations[:, :2], cameras[:, :2])


def test_corrects_cameras_that_are_off(gaussian):
    """Ten degrees off in every frame: the alignment is found again, up to one rotation of the object."""
    tracks, shapes, cameras = gaussian
    rng = np.random.default_rng(7)
    skew = np.cross(np.eye(3), rng.standard_normal((len(cameras), 1, 3)))
    skew *= np.radians(10.0) * np.sqrt(2.0) / np.linalg.norm(skew, axis=(1, 2), keepdims=True)
    left, _, right = np.linalg.svd(np.eye(3) + skew)
    wrong = (left @ right) @ cameras
    assert rotation_error(wrong, cameras) > 5.0
    found, rotations = solved(tracks, wrong, False, RECOVERY)
    assert rotation_error(rotations, cameras) < 0.05
    assert relative_errors(rotations @ found, cameras @ shapes.transpose(0, 2, 1)).mean() < 1e-3


def test_mixing_the_virtual_points_changes_nothing(gaussian):
    tracks, _, cameras = gaussian
    columns = tracks.transpose(0, 2, 1)
    turn, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((columns.shape[2],) * 2))
    options = EmPndOptions(max_iterations=15)
    both = []
    for given in (columns, columns @ turn):
        problem = Problem(given, np.array([0, 14]), np.array([14]), cameras[:, :2], 0.0)
        both.append(EmPnd().solve(problem, options, np.random.default_rng(0), lambda _: None).shapes)
    assert np.allclose(both[0] @ turn, both[1], atol=1e-8)


def test_fewer_factors_find_the_same_answer(gaussian):
    tracks, _shapes, cameras = gaussian
    full, _ = solved(tracks, cameras, True, RECOVERY)
    few, _ = solved(tracks, cameras, True, EmPndOptions(last_noise=1e-13, cooling=0.75, least_change=1e-7, factors=6))
    assert relative_errors(few, full).mean() < 1e-3


def test_initial_shapes_scatter_least(gaussian):
    """No other depths of the same tracks scatter less about their mean."""
    tracks, _, cameras = gaussian
    start = initial_shapes(tracks.transpose(0, 2, 1), cameras)
    assert np.allclose((cameras @ start)[:, :2], tracks.transpose(0, 2, 1))

    def scatter(shapes):
        return float(np.sum((shapes - shapes.mean(axis=0)) ** 2))

    rng = np.random.default_rng(9)
    for _ in range(5):
        depth = 1e-3 * rng.standard_normal((len(start), 1, start.shape[2]))
        assert scatter(start + cameras[:, 2][:, :, None] * depth) > scatter(start)


def test_directions_that_hold_noise_are_left_out_of_dense_tracks_only():
    rng = np.random.default_rng(10)
    frames, points, noise = 12, 3000, 0.02
    flat = rng.standard_normal((2 * frames, 4)) @ rng.standard_normal((4, points)) / 2.0
    flat += noise * rng.standard_normal(flat.shape)
    left, values, _ = np.linalg.svd(flat, full_matrices=False)
    tracks = (left * values).reshape(frames, 2, -1)
    rows = turning_cameras(rng, frames)[:, :2]
    dense = Problem(tracks, np.array([0, 24]), np.array([points]), rows, noise)
    kept = above_noise(dense)
    assert kept is not None
    assert len(kept) == 4
    assert above_noise(replace(dense, noise=0.0)) is None
    assert above_noise(replace(dense, sizes=np.array([2 * frames]))) is None


def test_noise_is_not_taken_for_deformation():
    rng = np.random.default_rng(11)
    tracks, shapes, cameras = gaussian_sequence(frames=16, points=900)
    brief = EmPndOptions(cooling=0.8, max_iterations=60)
    clean, _ = solved(tracks, cameras, True, brief)
    level = 0.05 * float(np.sqrt(np.mean(tracks**2)))
    noisy = tracks + level * rng.standard_normal(tracks.shape)
    noisy -= noisy.mean(axis=1, keepdims=True)
    unit = float(np.sqrt(np.mean(noisy**2)))
    truth = shapes.transpose(0, 2, 1)
    cut, _ = solved(noisy / unit, cameras, True, brief, noise=level / unit)
    raw, _ = solved(noisy / unit, cameras, True, brief)
    assert relative_errors(clean, truth).mean() < 0.02
    assert relative_errors(unit * cut, truth).mean() < 0.7 * relative_errors(unit * raw, truth).mean()


def test_options_do_what_they_say(gaussian):
    tracks, _, cameras = gaussian
    problem = Problem(tracks.transpose(0, 2, 1), np.array([0, 14]), np.array([14]), cameras[:, :2], 0.0)

    def run(**options):
        return EmPnd().solve(problem, EmPndOptions(**options), np.random.default_rng(0), lambda _: None)

    fast, slow = run(cooling=0.5, last_noise=1e-6), run(cooling=0.8, last_noise=1e-6)
    assert fast.iterations < slow.iterations
    assert fast.stop_reason == slow.stop_reason == "shapes settled"
    assert run(max_iterations=3).iterations == 3
    assert run(max_iterations=3).stop_reason == "iteration limit"
    assert run(max_iterations=1, first_noise=1e-2).history["noise"] == [1e-2]
    assert run(last_noise=1e-5).history["noise"][-1] == pytest.approx(1e-5)
    assert run(factors=5, max_iterations=2).chosen["factors"] == 5
    assert (np.diff(slow.history["energy"]) < 0).all()
