"""Single rotation averaging, and the alignment of object frames before it."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.cameras import CameraOptions, estimate_cameras, signs
from nrsfm.cameras.averaged import average_paths, average_rotations
from nrsfm.metrics import rotation_error


def turns(vectors):
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vectors).as_matrix()


def summed_distance(rotation, given):
    return float(np.sum(np.sqrt(np.sum((given - rotation) ** 2, axis=(1, 2)))))


def test_average_has_the_least_summed_distance():
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    given = turns(0.4 * rng.normal(size=(5, 3)))
    found = average_rotations(given[:, None])[0]
    best = min(
        minimize(lambda v: summed_distance(turns(v), given), start, method="Nelder-Mead", options={"xatol": 1e-9}).fun
        for start in 0.2 * rng.normal(size=(4, 3))
    )
    assert summed_distance(found, given) <= best + 1e-4


def test_outliers_do_not_move_the_average():
    rng = np.random.default_rng(1)
    truth = turns(rng.normal(size=(10, 3)))
    near = turns(0.005 * rng.normal(size=(4, 10, 3)).reshape(-1, 3)).reshape(4, 10, 3, 3) @ truth
    wild = turns(rng.normal(size=(10, 3)))[None]
    robust = average_rotations(np.concatenate([near, wild]))
    assert np.degrees(np.linalg.norm(robust - truth, axis=(1, 2)) / np.sqrt(2)).max() < 1.0


def test_equal_rotations_are_their_own_average():
    given = np.tile(turns(np.array([[0.3, -2.0, 1.0]])), (3, 1, 1, 1))
    np.testing.assert_allclose(average_rotations(given), given[0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(average_rotations(-given)), 1.0)  # still a rotation


@pytest.mark.parametrize("mirrored", [False, True])
def test_object_frames_and_mirrors_are_brought_together(mirrored, wandering):
    rng = np.random.default_rng(2)
    path = wandering(25, rng)
    other = signs.mirrored(path) if mirrored else path
    paths = np.array([other @ turns(rng.normal(size=3)) for _ in range(3)] + [path])
    np.testing.assert_allclose(average_paths(paths), path, atol=1e-9)


def test_averaging_lowers_independent_errors(wandering):
    rng = np.random.default_rng(3)
    path = wandering(40, rng)
    noisy = turns(0.05 * rng.normal(size=(6 * 40, 3))).reshape(6, 40, 3, 3) @ path
    errors = [rotation_error(p, path) for p in noisy]
    assert rotation_error(average_paths(noisy), path) < 0.6 * np.mean(errors)


@pytest.mark.parametrize("rank", [None, 2])
def test_exact_sequence_is_not_averaged_away(rank, sequence):
    data = sequence(60, 60, 2, seed=3)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="averaged", camera_rank=rank))
    assert found.rank == 2
    assert rotation_error(found.rotations, data.rotations) < 0.05


def test_noisy_sequence(sequence):
    data = sequence(30, 60, 2, seed=4, noise=0.01)
    found = estimate_cameras(data.factor, CameraOptions(camera_method="averaged"))
    assert rotation_error(found.rotations, data.rotations) < 5.0
