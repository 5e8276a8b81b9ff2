"""Long sequences are compressed from the leading directions alone, with the same virtual tracks in effect."""

import numpy as np
import pytest

from nrsfm import compression
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.numerics import leading


@pytest.fixture
def long(monkeypatch):
    """Every sequence counts as long."""
    monkeypatch.setattr(compression, "FULL", 0)
    monkeypatch.setattr(leading, "FULL", 0)
    monkeypatch.setattr(compression, "_FIRST_DIRECTIONS", 16)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_leading_directions_are_those_of_all(long, noise):
    measured = compression.measure(face_sequence(frames=150, points=900, noise=noise).tracks.points)
    values, vectors = compression.spectrum(measured)
    few, directions = compression.spectrum(measured, leading=40)
    assert directions.shape == (300, 40)
    clear = values[:40] > 3 * values[60]
    assert clear.sum() >= 4
    np.testing.assert_allclose(few[clear], values[:40][clear], rtol=1e-8)
    cosines = np.abs(np.sum(directions[:, clear] * vectors[:, :40][:, clear], axis=0))
    np.testing.assert_allclose(cosines, 1.0, atol=1e-8)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_what_the_compression_of_a_long_sequence_loses_keeps_to_the_tolerance(long, noise):
    measured = compression.measure(face_sequence(frames=150, points=900, noise=noise).tracks.points)
    labels = np.arange(900) % 2
    tolerance = 1e-3
    small = compression.compress(measured, labels, noise=0.0, tolerance=tolerance)
    back = small.factors.reshape(300, -1)
    for k, members in enumerate(compression.members_of_cells(labels, small.sizes)):
        own = slice(small.offsets[k], small.offsets[k + 1])
        lost = measured.columns(members) - back[:, own] @ (small.maps[k] @ measured.columns(members))
        assert np.sqrt(np.mean(lost**2)) <= 1.12 * tolerance  # what was never computed comes on top: a quarter


def test_the_noise_is_read_off_some_of_the_rows(long):
    face = face_sequence(frames=500, points=400, noise=0.02)
    measured = compression.measure(face.tracks.points)
    full = compression.estimate_noise(measured, *of(measured, None), np.random.default_rng(0))
    some = compression.estimate_noise(measured, *of(measured, 40), np.random.default_rng(0))
    assert some == pytest.approx(full, rel=0.02)


def of(measured, count):
    values, vectors = compression.spectrum(measured, leading=count)
    return values, compression.track_coordinates(measured, vectors[:, :10])
