"""Signs along the sequence, the mirror, the orbit fit, and cameras that are given."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nrsfm.cameras import cameras_from_known, choose_mirror, mirrored
from nrsfm.cameras.orbit import fit_orbit, orbit_path
from nrsfm.cameras.signs import apply_signs, canonical, consistent_signs
from nrsfm.errors import InputError

random_rotations = st.integers(0, 2**32 - 1).map(lambda s: Rotation.random(7, random_state=s % 2**31).as_matrix())


@pytest.mark.parametrize("seed", range(5))
def test_signs_are_recovered(sequence, seed):
    data = sequence(frames=40, points=50, rank=2, seed=seed)
    rng = np.random.default_rng(seed)
    flips = np.where(rng.random(40) < 0.3, -1.0, 1.0)
    found = consistent_signs(apply_signs(data.rotations, flips), data.factor)
    assert abs(np.sum(found * flips)) == 40


def test_signs_prefer_to_leave_things_alone(sequence):
    data = sequence(frames=20, points=50, rank=1, seed=1)
    np.testing.assert_array_equal(consistent_signs(data.rotations, data.factor), 1.0)


@settings(max_examples=25)
@given(rotations=random_rotations)
def test_mirror_is_an_involution_of_rotations(rotations):
    other = mirrored(rotations)
    np.testing.assert_allclose(np.linalg.det(other), 1.0)
    np.testing.assert_allclose(mirrored(other), rotations)


@settings(max_examples=25)
@given(rotations=random_rotations, seed=st.integers(0, 1000))
def test_canonical_form_forgets_gauge_and_mirror(rotations, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    expected = canonical(rotations)
    np.testing.assert_allclose(canonical(rotations @ turn), expected, atol=1e-9)
    np.testing.assert_allclose(canonical(mirrored(rotations)), expected, atol=1e-9)


def bowl(points=400, frames=9):
    rng = np.random.default_rng(0)
    plane = rng.uniform(-1, 1, size=(points, 2))
    # Forward is positive: a dome towards the camera has its middle at the smallest depth.
    shape = np.column_stack([plane, np.sum(plane**2, axis=1)])
    rotations = Rotation.from_rotvec(np.linspace(-0.4, 0.4, frames)[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    return rotations, np.broadcast_to(shape, (frames, points, 3))


def test_mirror_choice_is_the_dome():
    rotations, shapes = bowl()
    kept = choose_mirror(rotations, shapes)
    assert kept["decided"]
    assert not kept["flip"]
    assert choose_mirror(rotations, shapes, mirror=True)["flip"]
    hollow = choose_mirror(mirrored(rotations), shapes * np.array([1.0, 1.0, -1.0]))
    assert hollow["flip"]
    assert hollow["bulge"] == pytest.approx(-kept["bulge"])


def test_mirror_choice_of_a_plane_is_undecided_and_finite():
    rotations, shapes = bowl()
    flat = choose_mirror(np.broadcast_to(np.eye(3), rotations.shape), shapes * np.array([1.0, 1.0, 0.0]))
    assert flat["bulge"] == 0.0
    assert not flat["decided"]


@pytest.mark.parametrize("speed", [0.5, 5.0, 40.0])
def test_orbit_fit_is_exact_on_an_orbit(speed):
    axis = np.array([0.2, 0.97, -0.1])
    axis /= np.linalg.norm(axis)
    frames = np.arange(50.0)
    path = Rotation.from_rotvec(np.radians(speed) * frames[:, None] * axis).as_matrix()
    path = path @ Rotation.random(random_state=1).as_matrix()
    velocity, deviation, turn = fit_orbit(path)
    np.testing.assert_allclose(velocity, np.radians(speed) * axis, atol=1e-8)
    assert deviation < 1e-5
    assert turn == pytest.approx(49 * speed)
    np.testing.assert_allclose(orbit_path(velocity, frames, path), path, atol=1e-7)


@settings(max_examples=25)
@given(rotations=random_rotations, rows=st.sampled_from([2, 3]), single=st.booleans())
def test_known_cameras_pass_through(rotations, rows, single):
    given_cameras = rotations[:, :rows].astype(np.float32 if single else np.float64)
    taken = cameras_from_known(given_cameras, 7)
    assert taken.dtype == np.float64
    np.testing.assert_allclose(taken, rotations, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(taken), 1.0)


def test_known_cameras_may_be_lists():
    np.testing.assert_array_equal(cameras_from_known(np.eye(3)[None].repeat(2, 0).tolist(), 2)[1], np.eye(3))


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (np.eye(3), "shape"),
        (np.zeros((4, 3, 2)), "shape"),
        (np.broadcast_to(np.eye(3), (5, 3, 3)), "received 5"),
        (np.full((4, 2, 3), np.nan), "frame 0"),
        (np.zeros((4, 2, 3)), "orthonormal"),
        (1.01 * np.broadcast_to(np.eye(3), (4, 3, 3)), "orthonormal"),
        (np.broadcast_to(np.diag([1.0, 1.0, -1.0]), (4, 3, 3)), "cross product"),
        (np.broadcast_to(np.eye(3), (4, 3, 3)).astype(complex), "dtype"),
        (np.array(["a"]), "dtype"),
        ([[1.0], [1.0, 2.0]], "rotations"),
    ],
)
def test_known_cameras_that_break_the_rules_are_refused(value, words):
    with pytest.raises(InputError, match=words):
        cameras_from_known(value, 4)
