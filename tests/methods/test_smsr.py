"""SMSR: the smoother against a dense solve, its choice of strength, exact sequences, what the options change."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.errors import InputError
from nrsfm.methods.smsr import Smoother
from nrsfm.metrics import shape_error
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}


@settings(max_examples=25)
@given(frames=st.integers(2, 12), strength=st.floats(1e-4, 1e4), seed=st.integers(0, 2**32 - 1))
def test_smoothing_solves_its_least_squares_problem(frames, strength, seed):
    tracks = np.random.default_rng(seed).normal(size=(frames, 2, 5))
    second = np.diff(np.eye(frames), 2, axis=0)
    flat = tracks.reshape(frames, -1)
    stacked = np.vstack([np.eye(frames), np.sqrt(strength) * second])
    expected = np.linalg.lstsq(stacked, np.vstack([flat, np.zeros((len(second), 10))]), rcond=None)[0]
    np.testing.assert_allclose(Smoother(tracks).smooth(strength).reshape(frames, -1), expected, atol=1e-7)


def test_straight_trajectories_pass():
    tracks = np.arange(12.0)[:, None, None] * np.ones((12, 2, 3)) + 5.0
    smoother = Smoother(tracks)
    np.testing.assert_allclose(smoother.smooth(1e6), tracks, atol=1e-6)


def test_strength_is_about_that_of_least_error():
    rng = np.random.default_rng(0)
    frames, points, noise = 40, 300, 0.2
    truth = np.sin(np.arange(frames) / 4.0)[:, None, None] * rng.normal(size=(1, 2, points))
    smoother = Smoother(truth + noise * rng.normal(size=truth.shape))
    error = {s: np.linalg.norm(smoother.smooth(s) - truth) for s in np.logspace(-3, 5, 41)}
    chosen = smoother.choose(noise, points)
    assert np.linalg.norm(smoother.smooth(chosen) - truth) < 1.02 * min(error.values())


def test_more_noise_more_smoothing():
    tracks = np.random.default_rng(0).normal(size=(30, 2, 20)).cumsum(axis=0)
    chosen = [Smoother(tracks).choose(noise, 20) for noise in (0.0, 0.1, 1.0)]
    assert chosen[0] == 0.0
    assert 0.0 < chosen[1] < chosen[2]


def test_smoothing_removes_noise_and_spares_the_motion():
    rng = np.random.default_rng(1)
    truth = np.sin(np.arange(60) / 9.0)[:, None, None] * rng.normal(size=(1, 2, 50))
    noisy = truth + 0.1 * rng.normal(size=truth.shape)
    smoother = Smoother(noisy)
    smooth = smoother.smooth(smoother.choose(0.1, 50))
    assert np.linalg.norm(smooth - truth) < 0.6 * np.linalg.norm(noisy - truth)


def test_smoothing_commutes_with_compression():
    rng = np.random.default_rng(2)
    tracks = rng.normal(size=(15, 2, 40)).cumsum(axis=0)
    turn = np.linalg.qr(rng.normal(size=(40, 40)))[0]
    plain, turned = Smoother(tracks), Smoother(tracks @ turn)
    assert turned.choose(0.3, 40) == plain.choose(0.3, 40) > 0
    np.testing.assert_allclose(turned.smooth(3.0), plain.smooth(3.0) @ turn, atol=1e-10)


def test_exact_low_rank_is_found_to_solver_accuracy(sequence):
    data = sequence(frames=60, points=70, rank=2)
    result = reconstruct(data.tracks, "smsr", data.rotations, smoothing=0.0, gamma=1e-6, gap=1e-9, **EXACT)
    assert shape_error(result, data.shapes, "none") < 1e-6
    assert result.diagnostics["chosen"]["smoothing"] == 0.0


def test_without_smoothing_it_is_the_block_matrix_method(sequence):
    data = sequence(noise=0.01)
    options = EXACT | {"denoise": False}
    plain = reconstruct(data.tracks, "bmm", data.rotations, **options)
    same = reconstruct(data.tracks, "smsr", data.rotations, smoothing=0.0, **options)
    np.testing.assert_allclose(same.shapes, plain.shapes, atol=1e-9 * np.abs(plain.shapes).max())


def test_smoothing_helps_under_noise_of_slow_motion(sequence):
    """Four frames where there was one, linearly between: nearly straight trajectories."""
    data = sequence(frames=21, points=60, rank=2)
    place = np.arange(80) / 4.0
    index = place.astype(int)
    part = (place - index)[:, None, None]
    shapes = (1 - part) * data.shapes[index] + part * data.shapes[index + 1]
    rotations = data.rotations[index]
    tracks = np.einsum("fij,fpj->fpi", rotations, shapes)[..., :2]
    tracks = tracks + 10.0 * np.random.default_rng(0).normal(size=tracks.shape)
    errors = [
        shape_error(reconstruct(tracks, "smsr", rotations, smoothing=s), shapes, "none") for s in (0.0, 0.05, 1e6)
    ]
    assert errors[1] < errors[0]
    assert errors[2] > 2 * errors[0]


def test_own_cameras_are_thresholded(sequence):
    data = sequence(frames=60, points=70, rank=2)
    result = reconstruct(data.tracks, "smsr", **EXACT)
    assert result.diagnostics["cameras"]["method"] == "proximal"
    assert shape_error(result, data.shapes, "per-frame") < 0.1


def test_needs_frames_in_order(sequence):
    data = sequence()
    with pytest.raises(InputError, match="follow one another in time"):
        reconstruct(data.tracks, "smsr", data.rotations, ordered=False)
