"""Organic priors: the weights against their formula, ties, exact low rank, what the options change."""

import numpy as np
import pytest

from nrsfm.methods import organic
from nrsfm.methods.organic import partial_sum, shared_weights
from nrsfm.metrics import shape_error
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}
SPREAD = np.array([100.0, 20.0, 5.0, 1.0, 0.1])  # far apart beside the width over which weights are shared


def test_weights_are_those_of_the_first_spectrum():
    penalty = partial_sum(SPREAD, 0.1, 1)
    weights = np.array([0.0, 10 / 30, 10 / 15, 10 / 11, 10 / 10.1])
    values = np.array([90.0, 30.0, 8.0, 1.5, 0.2])
    np.testing.assert_allclose(penalty.proximal(values, 0.3), np.maximum(values - 0.3 * weights, 0), atol=1e-4)
    assert penalty.value(values) == pytest.approx(weights @ values)


def test_first_threshold_leaves_what_is_kept():
    for kept in (0, 1, 2):
        penalty = partial_sum(SPREAD, 0.1, kept)
        left = penalty.proximal(SPREAD, 1.001 * penalty.first)
        np.testing.assert_allclose(left[kept:], 0.0)
        np.testing.assert_allclose(left[:kept], SPREAD[:kept], rtol=1e-3)


def test_equal_values_have_equal_weights_and_the_step_does_not_jump():
    weights = np.linspace(0, 1, 5)
    values = np.array([9.0, 4.0, 4.0, 4.0, 1.0])
    shared = shared_weights(values, weights)
    np.testing.assert_allclose(shared[1:4], 0.5, atol=1e-3)
    for step in (1e-6, -1e-6):
        moved = np.array([9.0, 4.0 + abs(step), 4.0, 4.0 - abs(step), 1.0])
        np.testing.assert_allclose(shared_weights(moved, weights), shared, atol=1e-4)


def test_shared_weights_stay_between_the_least_and_the_largest():
    rng = np.random.default_rng(0)
    values, weights = np.sort(rng.exponential(size=40))[::-1], np.sort(rng.uniform(size=40))
    shared = shared_weights(values, weights)
    assert shared.min() >= weights.min() - 1e-12
    assert shared.max() <= weights.max() + 1e-12
    assert np.isfinite(shared_weights(np.zeros(3), np.ones(3))).all()


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_exact_low_rank_is_found_to_solver_accuracy(kept, sequence):
    data = sequence(frames=60, points=70, rank=3)
    result = reconstruct(data.tracks, "organic", data.rotations, gamma=1e-6, gap=1e-9, kept=kept, **EXACT)
    assert shape_error(result, data.shapes, "none") < 1e-6
    assert result.diagnostics["chosen"]["rank"] == 3


def test_what_is_kept_is_not_shrunk(sequence):
    """A weight that flattens everything else leaves the one mode, at its full size."""
    data = sequence(frames=40, rank=1)
    options = EXACT | {"gamma": 0.5, "gap": 1e-8}
    errors = [
        shape_error(reconstruct(data.tracks, "organic", data.rotations, kept=kept, **options), data.shapes, "none")
        for kept in (1, 0)
    ]
    assert errors[0] < 1e-5
    assert errors[1] > 100 * errors[0]


def test_keeping_everything_says_so(sequence):
    data = sequence(frames=12)
    result = reconstruct(data.tracks, "organic", data.rotations, kept=12, **EXACT)
    assert any("kept 12 keeps all 12" in text for text in result.diagnostics["warnings"])
    assert np.isfinite(result.shapes).all()


def test_more_noise_more_weight(sequence):
    chosen = [
        reconstruct(data.tracks, "organic", data.rotations).diagnostics["chosen"]["gamma"]
        for data in (sequence(points=200, noise=0.0), sequence(points=200, noise=0.03))
    ]
    assert chosen[0] == pytest.approx(organic.LEAST_GAMMA)
    assert chosen[1] > 5 * chosen[0]


def test_own_cameras_are_averaged(sequence):
    data = sequence(frames=60, points=70, rank=2)
    result = reconstruct(data.tracks, "organic", **EXACT)
    assert result.diagnostics["cameras"]["method"] == "averaged"
    assert shape_error(result, data.shapes, "per-frame") < 1e-3
