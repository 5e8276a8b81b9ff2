"""The whole estimate: exactness, invariances, options, degenerate input, real sequences."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.cameras import CameraOptions, estimate_cameras
from nrsfm.errors import InputError
from nrsfm.metrics import rotation_error

FREE = CameraOptions(camera_path="free")


def same(a, b):
    """Rotation error in degrees between two estimates."""
    return rotation_error(a.rotations, b.rotations)


def check_valid(estimate, frames):
    rotations = estimate.rotations
    assert rotations.shape == (frames, 3, 3)
    assert np.isfinite(rotations).all()
    np.testing.assert_allclose(
        rotations @ np.swapaxes(rotations, 1, 2), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-9)
    assert estimate.scales.shape == (frames,)
    assert np.isfinite(estimate.scales).all()
    assert (estimate.scales > 0).all()
    assert sum(row["chosen"] for row in estimate.candidates) == 1


@pytest.mark.parametrize("rank", [1, 2, 3, 5])
def test_exact_data_gives_exact_cameras(sequence, rank):
    data = sequence(frames=60, points=80, rank=rank, seed=rank)
    # With other scales than free, K = 1 keeps a weak one-scale residual, which a varying amplitude does not meet.
    estimate = estimate_cameras(data.factor, CameraOptions(camera_rank=rank, scales="free"))
    check_valid(estimate, 60)
    assert estimate.rank == rank
    # The error of an angle whose cosine is rounded is 1e-6 degrees at best; the valley is flatter for larger K.
    assert rotation_error(estimate.rotations, data.rotations) < (1e-4 if rank < 4 else 1e-2)


def test_automatic_rank_finds_the_cameras_without_truth(sequence):
    data = sequence(frames=80, points=100, rank=3, seed=7)
    estimate = estimate_cameras(data.factor, CameraOptions())
    assert rotation_error(estimate.rotations, data.rotations) < 0.1
    assert len({row["K"] for row in estimate.candidates}) >= 3


def test_noise_costs_little(sequence):
    data = sequence(frames=80, points=300, rank=2, seed=5, noise=0.02)
    estimate = estimate_cameras(data.factor, CameraOptions())
    assert rotation_error(estimate.rotations, data.rotations) < 4.0


@pytest.mark.parametrize("seed", [0, 1])
def test_invariances(sequence, seed):
    data = sequence(frames=40, points=50, rank=2, seed=seed)
    options = CameraOptions(camera_rank=2)
    base = estimate_cameras(data.factor, options)
    rng = np.random.default_rng(seed)
    order = rng.permutation(50)
    shuffled = np.linalg.qr(data.measurements[:, order].T, mode="r").T
    assert same(base, estimate_cameras(shuffled, options)) < 1e-3
    assert same(base, estimate_cameras(37.5 * data.factor, options)) < 1e-3
    turn = np.linalg.qr(rng.normal(size=(data.factor.shape[1],) * 2))[0]
    assert same(base, estimate_cameras(data.factor @ turn, options)) < 1e-3
    # A turned image turns every camera: R → T R with T about the optical axis.
    angle = 0.7
    image = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = estimate_cameras((image @ data.factor.reshape(40, 2, -1)).reshape(80, -1), options)
    whole = np.eye(3)
    whole[:2, :2] = image
    assert rotation_error(turned.rotations, whole @ base.rotations) < 1e-3


def test_the_order_of_frames_does_not_matter_on_a_free_path(sequence):
    data = sequence(frames=40, points=50, rank=2, seed=3)
    order = np.random.default_rng(0).permutation(40)
    moved = data.factor.reshape(40, 2, -1)[order].reshape(80, -1)
    options = CameraOptions(camera_rank=2, camera_path="free")
    a, b = estimate_cameras(data.factor, options), estimate_cameras(moved, options)
    assert rotation_error(a.rotations[order], b.rotations) < 1e-3


def test_same_seed_same_answer(sequence):
    data = sequence(frames=30, points=40, rank=2, seed=1)
    a, b = (estimate_cameras(data.factor, CameraOptions(), seed=3) for _ in range(2))
    np.testing.assert_array_equal(a.rotations, b.rotations)
    assert a.candidates == b.candidates


def test_object_frame_is_the_first_camera(sequence):
    data = sequence(frames=30, points=40, rank=2, seed=1)
    np.testing.assert_allclose(estimate_cameras(data.factor, CameraOptions()).rotations[0], np.eye(3), atol=1e-12)


def test_an_even_turn_is_recognised_and_kept_out_of_the_shapes(sequence):
    from scipy.spatial.transform import Rotation

    frames = 60
    camera = Rotation.from_rotvec(
        np.radians(6.0) * np.arange(frames)[:, None] * np.array([0.1, 0.99, 0.05])
    ).as_matrix()
    # The object leans by up to 6 degrees on its own account: tracks alone would give that to the camera.
    lean = 0.1 * np.sin(np.linspace(0, np.pi, frames))[:, None] ** 2 * np.array([1.0, 0, 0])
    # Some noise, for exact tracks are taken at their word.
    moving = camera @ Rotation.from_rotvec(lean).as_matrix()
    data = sequence(frames=frames, points=80, rank=2, seed=0, rotations=moving, noise=0.01)
    free = estimate_cameras(data.factor, FREE)
    even = estimate_cameras(data.factor, CameraOptions())
    assert (free.path, even.path) == ("free", "orbit")
    assert rotation_error(even.rotations, camera) < 0.7 * rotation_error(free.rotations, camera)


def test_a_wandering_path_is_not_called_an_orbit(sequence):
    for seed in range(3):
        data = sequence(frames=60, points=80, rank=3, seed=seed)
        assert estimate_cameras(data.factor, CameraOptions()).path == "free"


def test_scales_are_free_only_where_the_size_changes(sequence):
    data = sequence(frames=40, points=60, rank=2, seed=6)
    zoom = np.exp(0.5 * np.sin(np.linspace(0, 5, 40)))
    zoomed = (data.factor.reshape(40, 2, -1) * zoom[:, None, None]).reshape(80, -1)
    np.testing.assert_array_equal(estimate_cameras(data.factor, CameraOptions()).scales, 1.0)
    found = estimate_cameras(zoomed, CameraOptions())
    assert rotation_error(found.rotations, data.rotations) < 0.5
    assert np.corrcoef(found.scales, zoom)[0, 1] > 0.95
    np.testing.assert_allclose(found.scales.mean(), 1.0)
    np.testing.assert_array_equal(estimate_cameras(zoomed, CameraOptions(scales="fixed")).scales, 1.0)


def test_rigid_estimator(sequence):
    data = sequence(frames=30, points=40, rank=1, seed=2, constant=True)
    estimate = estimate_cameras(data.factor, CameraOptions(camera_method="rigid"))
    assert estimate.rank == 1
    assert rotation_error(estimate.rotations, data.rotations) < 1e-4


def degenerate():
    rng = np.random.default_rng(0)
    frames = 12
    shape = rng.normal(size=(3, 30))
    from scipy.spatial.transform import Rotation

    turning = Rotation.from_rotvec(np.linspace(0, 1, frames)[:, None] * [0.2, 1.0, 0.1]).as_matrix()

    def tracks(rotations, shapes):
        w = (rotations @ shapes)[:, :2].reshape(2 * len(rotations), -1)
        return w - w.mean(axis=1, keepdims=True)

    flat = shape.copy()
    flat[2] = 0
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    line = np.outer([1.0, 0.5, 0.2], rng.normal(size=30))
    return {
        "three frames": (tracks(turning[:3], shape), CameraOptions()),
        "two frames": (tracks(turning[:2], shape), CameraOptions()),
        "planar rigid shape": (tracks(turning, flat), CameraOptions()),
        "all frames identical": (tracks(still, shape), CameraOptions()),
        "duplicate frames": (tracks(np.repeat(turning[:4], 3, axis=0), shape), CameraOptions()),
        "points on a line": (tracks(turning, line), CameraOptions()),
        "rank one": (np.outer(rng.normal(size=24), rng.normal(size=30)), CameraOptions()),
        "one row of zeros": (tracks(turning, shape) * np.r_[0.0, np.ones(23)][:, None], CameraOptions()),
        "one frame of zeros": (tracks(turning, shape) * np.r_[0.0, 0.0, np.ones(22)][:, None], CameraOptions()),
        "all zeros": (np.zeros((24, 5)), CameraOptions()),
        "K too large": (tracks(turning, shape), CameraOptions(camera_rank=9)),
        "K too large for the rank": (tracks(turning, shape), CameraOptions(camera_rank=2)),
        "rigid, planar": (tracks(turning, flat), CameraOptions(camera_method="rigid")),
        "rigid, zeros": (np.zeros((24, 5)), CameraOptions(camera_method="rigid")),
        "free scales, still": (tracks(still, shape), CameraOptions(scales="free")),
        "orbit, still": (tracks(still, shape), CameraOptions(camera_path="orbit")),
        "orbit, zeros": (np.zeros((24, 5)), CameraOptions(camera_path="orbit")),
        "noise": (rng.normal(size=(24, 30)), CameraOptions()),
    }


@pytest.mark.parametrize("name", list(degenerate()))
def test_degenerate_input_survives(name):
    factor, options = degenerate()[name]
    check_valid(estimate_cameras(factor, options), len(factor) // 2)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("all frames identical", "hardly turns"),
        ("points on a line", "no depth"),
        ("rank one", "no depth"),
        ("K too large", "is used"),
        ("K too large for the rank", "is used"),
    ],
)
def test_what_cannot_be_determined_is_said(name, words):
    factor, options = degenerate()[name]
    assert any(words in text for text in estimate_cameras(factor, options).warnings)


@pytest.mark.parametrize(
    "factor", [np.zeros((3, 4)), np.zeros((2, 4)), np.zeros(6), np.full((8, 3), np.nan), np.zeros((8, 0))]
)
def test_bad_factor_is_refused(factor):
    with pytest.raises(InputError, match="factor"):
        estimate_cameras(factor, CameraOptions())


def test_progress_rises_to_one(sequence):
    heard = []
    data = sequence(frames=20, points=30, rank=2, seed=1)
    estimate_cameras(data.factor, CameraOptions(), progress=lambda stage, fraction: heard.append((stage, fraction)))
    assert {stage for stage, _ in heard} == {"cameras"}
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


@pytest.mark.parametrize(("name", "degrees"), [("pickup", 1.0), ("yoga", 1.0), ("stretch", 2.5)])
def test_motion_capture(data_root, name, degrees):
    with np.load(data_root / f"{name}.npz", allow_pickle=False) as held:
        measurements, rotations = held["W"].astype(float), held["R"].astype(float)
    measurements -= measurements.mean(axis=1, keepdims=True)
    measurements /= np.sqrt(np.mean(measurements**2))
    estimate = estimate_cameras(measurements, CameraOptions())
    assert estimate.path == "orbit"
    assert rotation_error(estimate.rotations, rotations.reshape(-1, 2, 3)) < degrees
