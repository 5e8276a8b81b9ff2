"""The smoothest motion: the dense least-squares solution, exact where it can be, the same on compressed tracks."""

import numpy as np
import pytest

from nrsfm.methods.smooth_motion import smooth_motion


def views(frames, seed=0):
    """Upper rows (F, 2, 3) of rotations anywhere."""
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((frames, 3, 3)))[0][:, :2]


@pytest.mark.parametrize("weight", [1e-3, 1.0, 50.0])
def test_it_is_the_least_squares_solution(weight):
    rng = np.random.default_rng(1)
    frames, rows, tracks = 8, views(8), rng.standard_normal((8, 2, 5))
    design = np.zeros((2 * frames, 3 * frames))
    for f in range(frames):
        design[2 * f : 2 * f + 2, 3 * f : 3 * f + 3] = rows[f]
    changes = np.sqrt(weight) * np.kron(np.diff(np.eye(frames), axis=0), np.eye(3))
    target = np.concatenate([tracks.reshape(2 * frames, 5), np.zeros((len(changes), 5))])
    expected = np.linalg.lstsq(np.concatenate([design, changes]), target, rcond=None)[0]
    assert np.allclose(smooth_motion(tracks, rows, weight).reshape(3 * frames, 5), expected, atol=1e-8)


def test_a_rigid_body_is_found_exactly_whatever_the_weight():
    body = np.random.default_rng(2).standard_normal((3, 6))
    rows = views(10)
    for weight in (1e-4, 1e4):
        assert np.allclose(smooth_motion(rows @ body, rows, weight), body, atol=1e-6)


def test_a_small_weight_meets_the_tracks():
    rng = np.random.default_rng(3)
    rows, tracks = views(12), rng.standard_normal((12, 2, 4))
    found = smooth_motion(tracks, rows, 1e-8)
    assert np.abs(rows @ found - tracks).max() < 1e-6


def test_columns_do_not_know_of_each_other():
    rng = np.random.default_rng(4)
    rows, tracks, mix = views(9), rng.standard_normal((9, 2, 4)), rng.standard_normal((4, 7))
    assert np.allclose(smooth_motion(tracks @ mix, rows, 0.1), smooth_motion(tracks, rows, 0.1) @ mix, atol=1e-9)


def test_a_camera_that_stands_still_gives_flat_shapes_not_an_error():
    rows = np.broadcast_to(np.eye(3)[:2], (5, 2, 3))
    found = smooth_motion(np.random.default_rng(5).standard_normal((5, 2, 3)), rows, 0.01)
    assert np.isfinite(found).all()
    assert np.abs(found[:, 2]).max() < 1e-6
