"""The eight camera paths."""

import numpy as np
import pytest

from nrsfm.cameras import camera_turn
from nrsfm.errors import InputError
from nrsfm.experiments.paths import camera_path, path_meaning, path_names


def test_there_are_eight_and_each_says_what_it_does():
    assert len(path_names()) == 8
    assert all(path_meaning(name) for name in path_names())


@pytest.mark.parametrize("name", path_names())
@pytest.mark.parametrize("frames", [1, 2, 99])
def test_rotations_are_rotations(name, frames):
    rotations = camera_path(name, frames)
    assert rotations.shape == (frames, 3, 3)
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("still", 1.0, 2.5), ("pan5", 10.0, 10.0), ("pan15", 30.0, 30.0), ("pan45", 90.0, 90.0), ("turn", 178.0, 180.0)],
)
def test_the_camera_turns_as_far_as_the_name_says(name, least, most):
    assert least - 1e-6 <= camera_turn(camera_path(name, 99)) <= most + 1e-6


def test_only_the_shake_jumps_from_frame_to_frame():
    def largest_step(name):
        axes = camera_path(name, 99)[:, 2]
        return np.degrees(np.arccos(np.clip(np.sum(axes[1:] * axes[:-1], axis=1), -1, 1))).max()

    assert largest_step("shake") > 20
    assert max(largest_step(name) for name in path_names() if name != "shake") < 10


def test_roll_turns_the_picture():
    roll = camera_path("orbit-roll", 99)
    assert np.degrees(np.abs(np.arctan2(roll[:, 1, 0], roll[:, 0, 0]))).max() > 20
    assert np.abs(camera_path("turn", 99)[:, 1, 0]).max() < 1e-12


def test_more_frames_sample_the_same_path():
    np.testing.assert_allclose(camera_path("two-axes", 199)[::2], camera_path("two-axes", 100), atol=1e-12)


def test_unknown_names_and_no_frames_are_refused():
    with pytest.raises(InputError, match="pan15"):
        camera_path("pan16", 10)
    with pytest.raises(InputError, match="at least 1 frame"):
        camera_path("still", 0)
