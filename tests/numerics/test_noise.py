"""Shrinkage of singular values and the noise estimates, on simulated matrices where the truth is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.numerics.noise import noise_from_neighbours, noise_from_spectrum, shrink_singular_values


@given(st.integers(1, 80), st.integers(1, 80), st.floats(1e-3, 10), st.floats(0, 50))
def test_shrinkage_is_the_published_formula(rows, columns, noise, factor):
    small, large = sorted((rows, columns))
    value = factor * noise * np.sqrt(large)
    beta, y = small / large, factor
    expected = 0.0
    if y > 1 + np.sqrt(beta):
        expected = np.sqrt((y**2 - beta - 1) ** 2 - 4 * beta) / y * noise * np.sqrt(large)
    got = shrink_singular_values(np.array([value]), (rows, columns), noise)
    np.testing.assert_allclose(got, [expected], rtol=1e-7, atol=1e-6 * noise * np.sqrt(large))


@given(st.lists(st.floats(0, 1e3), min_size=2, max_size=30), st.floats(0, 5))
def test_shrinkage_only_shrinks_and_keeps_order(values, noise):
    values = np.sort(values)[::-1]
    got = shrink_singular_values(values, (20, 30), noise)
    assert np.all(got >= 0)
    assert np.all(got <= values)
    assert np.all(np.diff(got) <= 1e-9 * values[0])


def test_no_noise_changes_nothing():
    values = np.array([3.0, 1.0, 0.0])
    got = shrink_singular_values(values, (3, 9), 0.0)
    np.testing.assert_array_equal(got, values)
    assert got is not values


@pytest.mark.parametrize("shape", [(20, 400), (60, 60), (200, 30)])
@pytest.mark.parametrize("strength", [1.2, 2.0, 5.0])
def test_shrinkage_is_near_the_best_possible(shape, strength):
    """Against the clean matrix: better than no shrinkage, and near the best value of each singular direction."""
    rng = np.random.default_rng(int(10 * strength))
    rank, noise = 3, 0.3
    edge = noise * (np.sqrt(shape[0]) + np.sqrt(shape[1]))
    losses, plain, best = 0.0, 0.0, 0.0
    for _ in range(8):
        left = np.linalg.qr(rng.standard_normal((shape[0], rank)))[0]
        right = np.linalg.qr(rng.standard_normal((shape[1], rank)))[0]
        clean = (left * (strength * edge * np.array([1.0, 1.3, 1.7]))) @ right.T
        u, values, vt = np.linalg.svd(clean + noise * rng.standard_normal(shape), full_matrices=False)
        ideal = np.einsum("ij,ik,kj->j", u, clean, vt.T)  # the oracle: uᵀ clean v
        losses += np.sum(((u * shrink_singular_values(values, shape, noise)) @ vt - clean) ** 2)
        plain += np.sum(((u * values) @ vt - clean) ** 2)
        best += np.sum(((u * np.maximum(ideal, 0)) @ vt - clean) ** 2)
    assert losses < 0.8 * plain
    assert losses < 1.05 * best


@pytest.mark.parametrize(
    ("frames", "points"), [(10, 1000), (50, 300), (50, 5000), (100, 150), (60, 70), (60, 50), (40, 20)]
)
def test_noise_from_spectrum(frames, points):
    """Within 5% for few modes, also with fewer points than 2F."""
    rng = np.random.default_rng(frames)
    rows, rank, noise, estimates = 2 * frames, 3, 0.7, []
    for _ in range(6):
        matrix = 5 * rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, points))
        matrix += noise * rng.standard_normal((rows, points))
        matrix -= matrix.mean(axis=1, keepdims=True)
        values = np.linalg.eigvalsh(matrix @ matrix.T)[::-1]
        estimates.append(noise_from_spectrum(values, rows, points))
    assert abs(np.mean(estimates) / noise - 1) < 0.05


@pytest.mark.parametrize("rank", [0, 4, 12, 30])
def test_noise_from_spectrum_is_an_upper_bound(rank):
    """A signal of any rank can only raise it."""
    rng = np.random.default_rng(rank)
    rows, points, noise = 40, 500, 1.0
    matrix = 2 * rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, points))
    matrix += noise * rng.standard_normal((rows, points))
    matrix -= matrix.mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(matrix @ matrix.T)[::-1]
    assert noise_from_spectrum(values, rows, points) > 0.97 * noise


def neighbourhoods(rng, count, size, frames, noise, curvature):
    """Neighbouring tracks that vary affinely (plus curvature) with three coordinates; those are given noisy."""
    places = rng.standard_normal((count, size, 3))
    maps = rng.standard_normal((count, 3, 2 * frames))
    maps[:, :, :3] = np.eye(3)  # the first three rows of the tracks are the coordinates themselves
    tracks = places @ maps + curvature * (places**2) @ rng.standard_normal((count, 3, 2 * frames))
    tracks[:, :, :3] = places
    tracks += noise * rng.standard_normal(tracks.shape)
    return tracks[:, :, :3], tracks


@pytest.mark.parametrize("frames", [4, 10, 50])
@pytest.mark.parametrize("noise", [0.001, 0.02])
def test_noise_from_neighbours(frames, noise):
    rng = np.random.default_rng(frames)
    places, tracks = neighbourhoods(rng, 200, 24, frames, noise, 0.0)
    # Errors of the three coordinates reach the residual of all others through the map: never too low, and at most
    # that much too high.
    estimate = noise_from_neighbours(places, tracks)
    assert 0.95 * noise < estimate < 2.2 * noise


@pytest.mark.parametrize("frames", [3, 5, 20])
@pytest.mark.parametrize("neighbours", [8, 24])
def test_noise_from_neighbours_counts_its_degrees_of_freedom(frames, neighbours):
    """Where the tracks do not vary with the coordinates, nothing but their noise is left: within 5%."""
    rng = np.random.default_rng(frames)
    tracks = 0.3 * rng.standard_normal((4000, neighbours, 2 * frames))
    places = 50 * rng.standard_normal((4000, neighbours, 3))
    tracks[:, :, :3] = places  # the coordinates themselves, as in the pipeline
    assert noise_from_neighbours(places, tracks) == pytest.approx(0.3, rel=0.05)


def test_curvature_only_raises_the_estimate():
    low = noise_from_neighbours(*neighbourhoods(np.random.default_rng(1), 100, 24, 10, 0.01, 0.0))
    high = noise_from_neighbours(*neighbourhoods(np.random.default_rng(1), 100, 24, 10, 0.01, 0.1))
    assert high > low
