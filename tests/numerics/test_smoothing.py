"""Smoothing over time: the dense formula, polynomials untouched, the weight that predicts best."""

import numpy as np
import pytest

from nrsfm.numerics.smoothing import ORDERS, penalty_bands, smoothed


@pytest.mark.parametrize("frames", [4, 9, 30])
@pytest.mark.parametrize("order", ORDERS)
def test_the_bands_are_those_of_the_penalty(frames, order):
    differences = np.diff(np.eye(frames), order, axis=0)
    penalty = differences.T @ differences
    bands = penalty_bands(frames, order)
    for offset in range(order + 1):
        assert np.array_equal(bands[order - offset, offset:], np.diagonal(penalty, offset))


def test_what_is_returned_is_the_penalised_least_squares_solution():
    rng = np.random.default_rng(0)
    values = np.sin(np.linspace(0, 3, 40))[:, None] * rng.standard_normal(5) + 0.05 * rng.standard_normal((40, 5))
    found = smoothed(values)
    differences = np.diff(np.eye(40), found.order, axis=0)
    matrix = np.linalg.inv(np.eye(40) + found.weight * differences.T @ differences)
    assert np.allclose(found.values, matrix @ values, atol=1e-9)
    assert found.left == pytest.approx(np.sqrt(np.trace(matrix @ matrix) / 40))
    assert found.removed == pytest.approx(np.sqrt(np.mean((values - matrix @ values) ** 2)))
    left_out = ((values - matrix @ values) / (1 - np.trace(matrix) / 40)) ** 2
    assert found.predicted == pytest.approx(np.sqrt(np.mean(left_out)))


def test_noise_is_removed_from_smooth_curves_and_its_level_found():
    rng = np.random.default_rng(1)
    time = np.linspace(0, 4 * np.pi, 200)[:, None]
    truth = np.sin(time + rng.uniform(0, 6, 8)) * rng.uniform(0.5, 2, 8)
    found = smoothed(truth + 0.1 * rng.standard_normal(truth.shape))
    assert np.sqrt(np.mean((found.values - truth) ** 2)) < 0.04
    assert found.predicted == pytest.approx(0.1, rel=0.15)
    assert found.left == pytest.approx(np.sqrt(np.mean((found.values - truth) ** 2)) / 0.1, rel=0.5)


def test_curves_without_noise_are_hardly_touched():
    time = np.linspace(0, 4 * np.pi, 200)[:, None]
    found = smoothed(np.sin(time))
    assert found.removed < 1e-5
    assert found.predicted < 1e-4


def test_samples_without_memory_are_not_followed_closely():
    """White noise alone: the best prediction is the mean."""
    found = smoothed(np.random.default_rng(2).standard_normal((300, 4)))
    assert found.left < 0.2


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames(frames):
    values = np.arange(2.0 * frames).reshape(frames, 2) ** 2
    found = smoothed(values)
    assert found.values.shape == values.shape
    assert np.isfinite(found.values).all()
    assert 0 < found.left <= 1
