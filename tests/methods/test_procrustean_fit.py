"""The EM loop from any start: what it recovers, what its likelihood says, how its noise falls."""

from dataclasses import replace

import numpy as np
import pytest

from nrsfm.manifolds.procrustes import onto_tangent_space
from nrsfm.methods.procrustean_fit import Schedule, fit, unit_size


def turned(rng, frames):
    """Rotations (F, 3, 3) anywhere."""
    q = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


def gaussian_shapes(frames=30, points=10, modes=2, seed=0, noise=0.0):
    """Tracks (F, 2, P), cameras (F, 3, 3), shapes (F, 3, P): a mean of norm 1 that deforms by 15%."""
    rng = np.random.default_rng(seed)
    mean = rng.standard_normal((3, points))
    mean -= mean.mean(axis=1, keepdims=True)
    mean /= np.linalg.norm(mean)
    free = rng.standard_normal((modes, 3, points))
    free -= free.mean(axis=2, keepdims=True)
    basis = np.linalg.qr(onto_tangent_space(mean, free.reshape(modes, -1).T))[0]
    weights = 0.15 * rng.standard_normal((frames, modes)) / np.sqrt(modes)
    shapes = mean + (weights @ basis.T).reshape(frames, 3, points)
    cameras = turned(rng, frames)
    tracks = (cameras @ shapes)[:, :2]
    return tracks + noise * rng.standard_normal(tracks.shape), cameras, shapes


TRACKS, CAMERAS, SHAPES = gaussian_shapes()
FALLING = Schedule(20, 1e-2, 1e-10, 1e-3, 0.7, 1e-5)
STARTS = {
    "the truth": SHAPES,
    "their mean": np.repeat(SHAPES.mean(axis=0)[None], 30, axis=0),
    "noisy": SHAPES + 0.02 * np.random.default_rng(1).standard_normal(SHAPES.shape),
}


def ignored(_):
    """No one listens."""


def fitted(start=SHAPES, schedule=FALLING, tracks=TRACKS, cameras=CAMERAS):
    return fit(tracks, cameras, start, schedule, ignored)


def error(estimate, truth):
    return np.linalg.norm(estimate - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("kind", STARTS)
def test_every_start_ends_at_the_shapes(kind):
    found = fitted(STARTS[kind])
    assert error(found.shapes, CAMERAS @ SHAPES) < 1e-4
    assert found.reason == "shapes settled"
    np.testing.assert_allclose(found.align @ np.swapaxes(found.align, 1, 2), np.tile(np.eye(3), (30, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("kind", ["the truth", "their mean", "noisy"])
def test_likelihood_never_falls_while_the_noise_is_free(kind):
    """cooling 0 and a last noise out of reach: plain EM, and the alignment only ever climbs beside it."""
    found = fitted(STARTS[kind], Schedule(20, 1e-2, 1e-30, 1e-3, 0.0, 0.0, 40))
    energy = np.array(found.history["energy"])
    assert (np.diff(energy) < 1e-7 * np.abs(energy[:-1])).all()
    assert energy[-1] < energy[0] - 100


def test_likelihood_tells_right_shapes_from_wrong_ones():
    """At the same noise: from the shapes, and from shapes of another sequence."""
    schedule = replace(FALLING, max_iterations=60)
    right = fitted(SHAPES, schedule)
    wrong = fitted(0.3 * np.random.default_rng(2).standard_normal(SHAPES.shape), schedule)
    assert error(wrong.shapes, CAMERAS @ SHAPES) > 0.1
    assert right.likelihood > wrong.likelihood + 100


def test_the_noise_is_found():
    tracks, cameras, shapes = gaussian_shapes(frames=80, points=20, noise=0.01)
    found = fitted(np.swapaxes(cameras[:, :2], 1, 2) @ tracks, Schedule(4, 1e-2, 1e-9, 1e-3), tracks, cameras)
    total = found.model.noise + found.model.spread  # noise that is alike in all directions may be either
    assert np.sqrt(total) == pytest.approx(0.01, rel=0.15)
    assert error(found.shapes, cameras @ shapes) < 0.08


@pytest.mark.parametrize("cooling", [0.5, 0.9])
def test_the_noise_falls_as_the_schedule_says(cooling):
    schedule = Schedule(20, 1e-2, 1e-7, 1e-3, cooling)
    found = fitted(schedule=schedule)
    noise = np.array(found.history["noise"])
    assert noise[0] == 1e-2
    assert noise[-1] == pytest.approx(1e-7)
    assert (noise >= 1e-7).all()
    assert (noise[1:] >= cooling * noise[:-1] * (1 - 1e-12)).all()
    assert {len(values) for values in found.history.values()} == {found.iterations}


def test_iterations_end_where_told():
    found = fitted(schedule=replace(FALLING, max_iterations=7))
    assert (found.iterations, found.reason) == (7, "iteration limit")
    assert fitted(schedule=replace(FALLING, last_noise=1e-2, least_change=10.0)).iterations == 1


@pytest.mark.parametrize("factors", [1, 3, 500])
def test_the_covariance_has_at_most_so_many_factors(factors):
    found = fitted(schedule=replace(FALLING, factors=factors, max_iterations=10))
    assert found.model.basis.shape == (30, min(factors, 26))


def test_without_negligible_factors_the_shapes_are_the_same():
    near = replace(FALLING, first_noise=1e-5, first_spread=1e-6)
    full, few = (fitted(schedule=replace(near, negligible=share)) for share in (0.0, 1.0))
    assert 2 <= few.model.basis.shape[1] < full.model.basis.shape[1]
    assert error(few.shapes, full.shapes) < 1e-4


def test_progress_is_told_between_nought_and_one():
    told = []
    fit(TRACKS, CAMERAS, SHAPES, FALLING, told.append)
    assert len(told) > 10
    assert all(0.0 <= share <= 1.0 for share in told)
    assert told[-1] > 0.7 > told[0]


def test_points_may_be_replaced_by_their_compression():
    """40 points of 6 dimensions: the same shapes, and likelihoods that differ as little."""
    rng = np.random.default_rng(4)
    lift = np.linalg.qr(rng.standard_normal((40, 10)))[0].T
    schedule = replace(FALLING, last_noise=1e-5, max_iterations=30, first_spread=0.0)
    small = fitted(STARTS["noisy"], schedule)
    large = fitted(STARTS["noisy"] @ lift, schedule, TRACKS @ lift)
    # The noise is that of 40 coordinates, of which 30 are silent: only the first step is alike in every respect.
    assert error(large.shapes, small.shapes @ lift) < 1e-2


def test_the_object_frame_and_the_image_frame_do_not_matter():
    turn = turned(np.random.default_rng(5), 1)[0]
    schedule = replace(FALLING, max_iterations=25)
    plain = fitted(STARTS["noisy"], schedule)
    moved = fitted(turn @ STARTS["noisy"], schedule, cameras=CAMERAS @ turn.T)
    np.testing.assert_allclose(moved.shapes, plain.shapes, atol=1e-6)
    angle = np.random.default_rng(6).uniform(0, 6, 30)
    spin = np.zeros((30, 3, 3))
    spin[:, 0, 0] = spin[:, 1, 1] = np.cos(angle)
    spin[:, 1, 0], spin[:, 0, 1] = np.sin(angle), -np.sin(angle)
    spin[:, 2, 2] = 1.0
    moved = fitted(STARTS["noisy"], schedule, spin[:, :2, :2] @ TRACKS, spin @ CAMERAS)
    np.testing.assert_allclose(moved.shapes, spin @ plain.shapes, atol=1e-6)


def test_unit_size_is_that_of_the_mean_shape():
    _, _, shapes = gaussian_shapes(frames=2000)
    tracks = (turned(np.random.default_rng(7), 2000) @ shapes)[:, :2]
    assert unit_size(37.0 * tracks) == pytest.approx(37.0, rel=0.02)
    assert unit_size(np.zeros((4, 2, 5))) == 1.0


def with_frame(array, value):
    array = array.copy()
    array[3] = value
    return array


DEGENERATE = {
    "rigid": (CAMERAS[:, :2] @ SHAPES[0], np.repeat(SHAPES[:1], 30, axis=0), CAMERAS),
    "flat": (CAMERAS[:, :2] @ (SHAPES * [[1.0], [1.0], [0.0]]), SHAPES * [[1.0], [1.0], [0.0]], CAMERAS),
    "three frames": (TRACKS[:3], SHAPES[:3], CAMERAS[:3]),
    "three columns": (TRACKS[:, :, :3], SHAPES[:, :, :3], CAMERAS),
    "no turn": (
        TRACKS,
        np.swapaxes(np.tile(CAMERAS[:1], (30, 1, 1)), 1, 2)[:, :, :2] @ TRACKS,
        CAMERAS[:1] + 0 * CAMERAS,
    ),
    "a frame without extent": (with_frame(TRACKS, 0.0), with_frame(SHAPES, 0.0), CAMERAS),
    "duplicates": (np.repeat(TRACKS, 2, axis=2) / 2**0.5, np.repeat(SHAPES, 2, axis=2) / 2**0.5, CAMERAS),
}


@pytest.mark.parametrize("kind", DEGENERATE)
@pytest.mark.parametrize("negligible", [0.0, 0.1])
def test_degenerate_input_ends_finite(kind, negligible):
    tracks, start, cameras = DEGENERATE[kind]
    found = fitted(start, replace(FALLING, last_noise=1e-7, max_iterations=40, negligible=negligible), tracks, cameras)
    assert found.reason != "not finite"
    assert np.isfinite(found.shapes).all()
    assert np.isfinite(found.likelihood)
