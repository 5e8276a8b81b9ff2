import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.datasets import Sequence, add_noise
from nrsfm.datasets.paths import camera_path
from nrsfm.errors import InputError
from nrsfm.tracks import Tracks


def made(frames=20, points=3000, visible=None):
    return Tracks(np.random.default_rng(3).standard_normal((frames, points, 2)) * 40 + 500, visible)


def test_noise_has_the_stated_deviation_and_repeats_with_its_seed():
    tracks = made()
    centred = tracks.points - tracks.points.mean(axis=1, keepdims=True)
    noise = add_noise(tracks, 0.03, seed=1).points - tracks.points
    assert noise.std() == pytest.approx(0.03 * np.abs(centred).max(), rel=0.02)
    assert abs(noise.mean()) < 0.02 * noise.std()
    np.testing.assert_array_equal(add_noise(tracks, 0.03, seed=1).points, add_noise(tracks, 0.03, seed=1).points)
    assert not np.allclose(add_noise(tracks, 0.03, seed=2).points, add_noise(tracks, 0.03, seed=1).points)
    assert add_noise(tracks, 0) is tracks


@given(shift=st.floats(-1e3, 1e3), scale=st.floats(0.01, 100))
def test_noise_follows_the_unit_and_not_the_place(shift, scale):
    tracks = made(4, 5)
    noise = add_noise(tracks, 0.05).points - tracks.points
    moved = Tracks(tracks.points * scale + shift)
    np.testing.assert_allclose(add_noise(moved, 0.05).points - moved.points, noise * scale, rtol=1e-6, atol=1e-9)


def test_noise_ignores_what_is_not_seen_and_keeps_the_dtype():
    points = made(4, 5).points.astype(np.float32)
    visible = np.ones((4, 5), bool)
    hidden = points.copy()
    hidden[2, 3], visible[2, 3] = np.nan, False
    noisy = add_noise(Tracks(hidden, visible), 0.1)
    assert noisy.points.dtype == np.float32
    assert np.isfinite(noisy.points[visible]).all()
    np.testing.assert_array_equal(noisy.visible, visible)


@pytest.mark.parametrize("ratio", [-0.1, np.nan, np.inf, "much", None, True])
def test_other_ratios_are_refused(ratio):
    with pytest.raises(InputError, match="noise must be"):
        add_noise(made(3, 4), ratio)


@pytest.mark.parametrize("seed", [-1, 0.5, None, True])
def test_other_seeds_are_refused(seed):
    with pytest.raises(InputError, match="seed must be"):
        add_noise(made(3, 4), 0.1, seed)


def test_sizes_must_agree():
    tracks = made(3, 4)
    for name, array in (
        ("shapes", np.zeros((3, 5, 3))),
        ("rotations", np.zeros((4, 3, 3))),
        ("valid", np.ones(3)),
    ):
        with pytest.raises(InputError, match=f"{name} of shape"):
            Sequence("x", tracks, **{name: array})
    sequence = Sequence("x", tracks, np.zeros((3, 4, 3)))
    assert repr(sequence) == "Sequence('x', 3 frames, 4 points, shapes)"
    noisy = sequence.with_noise(0.1, seed=4)
    assert noisy.note == {"noise": 0.1, "noise_seed": 4}
    assert sequence.note == {}


@given(frames=st.integers(1, 50), turns=st.floats(0.1, 5), yaw=st.floats(-180, 180))
def test_a_camera_path_is_made_of_rotations(frames, turns, yaw):
    path = camera_path(frames, turns=turns, yaw=yaw)
    np.testing.assert_allclose(path @ path.transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(path), 1)
    assert (path[:, 1, 1] < 0).all()  # up in the object is up in the image, where y goes down
