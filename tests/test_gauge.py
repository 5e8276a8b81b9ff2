"""The object frame along a sequence: nothing seen changes, and known answers are found."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from nrsfm import reconstruct
from nrsfm.compression import compress, measure
from nrsfm.datasets import load
from nrsfm.gauge import GaugeOptions, even_gauge, fix_gauge, mean_gauge, roughness, steady_gauge
from nrsfm.metrics import shape_error

CHOICES = ("auto", "method", "cameras", "mean", "even", "steady")


def turned(vectors):
    return Rotation.from_rotvec(vectors).as_matrix()


def swing(frames, degrees=50.0):
    """A slow, smooth camera path (F, 3, 3)."""
    time = np.arange(frames)
    angles = np.stack([12 * np.sin(time / 40), degrees * np.sin(time / 25), 5 * np.cos(time / 33)], axis=1)
    return turned(np.radians(angles))


def deforming(frames, points, rng, coefficients=2):
    """Shapes (F, 3, N) about a mean, with ``coefficients`` modes that change faster than the camera; and those."""
    mean = rng.standard_normal((3, points))
    modes = rng.standard_normal((coefficients, 3, points))
    time = np.arange(frames)[:, None]
    weights = 0.2 * np.sin(time * (0.9 + 0.35 * np.arange(coefficients)) + np.arange(coefficients))
    return mean + np.einsum("fk,kcn->fcn", weights, modes), weights


@given(
    st.integers(0, 2**31),
    st.integers(3, 40),
    st.integers(1, 12),
    st.sampled_from(CHOICES),
    st.booleans(),
    st.booleans(),
)
def test_what_cameras_see_stays(seed, frames, points, choice, even, ordered):
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((frames, 3, points))
    rotations, reference = turned(rng.standard_normal((2, frames, 3)).reshape(-1, 3)).reshape(2, frames, 3, 3)
    moved, path, report = fix_gauge(
        shapes, rotations, GaugeOptions(choice), reference=reference, even=even, ordered=ordered
    )
    np.testing.assert_allclose(path @ moved, rotations @ shapes, atol=1e-12 * max(np.abs(shapes).max(), 1))
    np.testing.assert_allclose(path @ np.swapaxes(path, 1, 2), np.broadcast_to(np.eye(3), path.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(path), 1.0)
    np.testing.assert_allclose(path[0], rotations[0], atol=1e-12)
    assert report["chosen"] in CHOICES
    assert report["moved"] >= 0


def test_method_changes_nothing_and_cameras_takes_the_estimate():
    rng = np.random.default_rng(0)
    shapes, rotations, reference = rng.standard_normal((9, 3, 5)), swing(9), swing(9, 20)
    moved, path, report = fix_gauge(shapes, rotations, GaugeOptions("method"), reference=reference)
    np.testing.assert_allclose(moved, shapes, atol=1e-12)
    assert report["moved"] < 1e-5
    _, path, _ = fix_gauge(shapes, rotations, GaugeOptions("cameras"), reference=reference)
    relative = path @ np.swapaxes(path[:1], 1, 2)
    np.testing.assert_allclose(relative, reference @ np.swapaxes(reference[:1], 1, 2), atol=1e-12)


@given(st.integers(0, 2**31), st.integers(3, 30), st.integers(4, 20))
def test_mean_undoes_any_turning_of_a_rigid_shape(seed, frames, points):
    rng = np.random.default_rng(seed)
    rigid = rng.standard_normal((3, points)) * np.array([[3.0], [2.0], [1.0]])
    turns = turned(0.4 * rng.standard_normal((frames, 3)))
    moved, _, _ = fix_gauge(turns @ rigid, swing(frames), GaugeOptions("mean"))
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-6)


def test_mean_is_a_stationary_point_of_the_scatter():
    rng = np.random.default_rng(1)
    shapes, _ = deforming(25, 30, rng)
    seen = swing(25) @ shapes
    path = mean_gauge(seen, swing(25))

    def scatter(cameras):
        found = np.swapaxes(cameras, 1, 2) @ seen
        return np.sum((found - found.mean(axis=0)) ** 2)

    least = scatter(path)
    for _ in range(20):
        assert scatter(path @ turned(1e-3 * rng.standard_normal((25, 3)))) >= least


def test_an_even_turn_is_found_again():
    rng = np.random.default_rng(2)
    frames = 90
    shapes, _ = deforming(frames, 25, rng)
    velocity = np.radians([0.4, 4.0, -0.3])
    cameras = turned(np.arange(frames)[:, None] * velocity)
    wrong = np.swapaxes(turned(np.radians(4) * rng.standard_normal((frames, 3))), 1, 2)
    moved, path, report = fix_gauge(np.swapaxes(wrong, 1, 2) @ shapes, cameras @ wrong)
    assert report["chosen"] == "even"
    # One turn for the whole sequence is free.
    fix = path[0].T @ cameras[0]
    angles = np.degrees(Rotation.from_matrix(np.swapaxes(path @ fix, 1, 2) @ cameras).magnitude())
    assert angles.max() < 0.5
    assert shape_error(moved.transpose(0, 2, 1), shapes.transpose(0, 2, 1), "global") < 0.01
    assert even_gauge(cameras @ shapes, cameras) == pytest.approx(cameras, abs=0.01)


def test_turns_that_follow_the_deformation_are_given_back():
    rng = np.random.default_rng(3)
    frames = 80
    shapes, weights = deforming(frames, 40, rng)
    cameras = swing(frames)
    wrong = turned(weights @ rng.standard_normal((2, 3)) * 0.3)  # some degrees, as a metric upgrade errs
    assert np.degrees(np.linalg.norm(Rotation.from_matrix(wrong).as_rotvec(), axis=1)).mean() > 2
    estimated, taken = cameras @ np.swapaxes(wrong, 1, 2), wrong @ shapes
    before = shape_error(taken.transpose(0, 2, 1), shapes.transpose(0, 2, 1), "global")
    moved, path, report = fix_gauge(taken, estimated)
    after = shape_error(moved.transpose(0, 2, 1), shapes.transpose(0, 2, 1), "global")
    assert report["chosen"] == "steady"
    assert report["gain"] > 0.5
    assert after < 0.35 * before
    assert roughness(path) < roughness(estimated)


@pytest.mark.parametrize("frames", [100, 1500])
def test_of_many_frames_a_smaller_gain_is_believed(frames):
    """The camera jerks on its own, and the object frames follow the deformation besides: a sixth of the roughness."""
    rng = np.random.default_rng(6)
    shapes, weights = deforming(frames, 40, rng)
    cameras = turned(np.radians(rng.standard_normal((frames, 3)))) @ swing(frames)
    wrong = turned(weights @ rng.standard_normal((2, 3)) * 0.1)
    moved, _, report = fix_gauge(wrong @ shapes, cameras @ np.swapaxes(wrong, 1, 2))
    error = shape_error(moved.transpose(0, 2, 1), shapes.transpose(0, 2, 1), "global")
    assert report["gain"] < 0.2
    if frames == 100:
        assert report["chosen"] == "cameras"  # by chance, too, so few frames would show as much
    else:
        assert report["chosen"] == "steady"
        assert error < 0.001


def test_a_camera_that_jerks_on_its_own_is_left_alone():
    rng = np.random.default_rng(4)
    shapes, _ = deforming(80, 40, rng)
    for size in (1.0, 20.0):
        cameras = turned(np.radians(size) * rng.standard_normal((80, 3))) @ swing(80)
        _, gain, _ = steady_gauge(cameras @ shapes, cameras)
        assert gain < 0.2
        moved, _, report = fix_gauge(shapes, cameras)
        assert report["chosen"] in ("cameras", "mean")
        assert shape_error(moved.transpose(0, 2, 1), shapes.transpose(0, 2, 1), "global") < 0.06


def test_rules_of_auto():
    rng = np.random.default_rng(5)
    shapes, _ = deforming(12, 20, rng)
    assert fix_gauge(shapes, swing(12))[2]["chosen"] == "mean"
    assert fix_gauge(shapes, swing(12), even=True)[2]["chosen"] == "even"
    shapes, _ = deforming(30, 20, rng)
    assert fix_gauge(shapes, swing(30), ordered=False)[2]["chosen"] == "cameras"


def test_virtual_points_do_as_well_as_real_ones():
    rng = np.random.default_rng(6)
    shapes, _ = deforming(30, 200, rng)
    cameras = swing(30)
    shapes -= shapes.mean(axis=2, keepdims=True)
    points = (cameras @ shapes)[:, :2].transpose(0, 2, 1)
    compressed = compress(measure(points), np.arange(200) % 3)
    virtual = np.swapaxes(cameras[:, :2], 1, 2) @ compressed.factors
    real = compressed.expand(virtual, np.dtype(np.float64)).transpose(0, 2, 1)
    wrong = turned(0.05 * rng.standard_normal((30, 3)))
    for choice in CHOICES:
        few, path, _ = fix_gauge(virtual, cameras, GaugeOptions(choice), reference=cameras @ wrong)
        all_, other, _ = fix_gauge(real, cameras, GaugeOptions(choice), reference=cameras @ wrong)
        np.testing.assert_allclose(path, other, atol=1e-6)
        expanded = compressed.expand(few, np.dtype(np.float64)).transpose(0, 2, 1)
        np.testing.assert_allclose(expanded, all_, atol=1e-6 * np.abs(all_).max())


@pytest.mark.parametrize("kind", ["flat", "line", "nothing", "one point", "still"])
def test_degenerate_shapes_stay_finite(kind):
    rng = np.random.default_rng(7)
    shapes = rng.standard_normal((25, 3, 1 if kind == "one point" else 6))
    kept = {"flat": [1, 1, 0], "line": [1, 0, 0], "nothing": [0, 0, 0]}.get(kind, [1, 1, 1])
    shapes *= np.array(kept)[:, None]
    cameras = np.broadcast_to(np.eye(3), (25, 3, 3)).copy() if kind == "still" else swing(25)
    for choice in CHOICES:
        moved, path, _ = fix_gauge(shapes, cameras, GaugeOptions(choice))
        assert np.isfinite(moved).all()
        assert np.isfinite(path).all()


def test_read_only_single_precision_input():
    rng = np.random.default_rng(8)
    shapes = deforming(30, 20, rng)[0].astype(np.float32)
    cameras = swing(30)
    shapes.setflags(write=False)
    cameras.setflags(write=False)
    moved, path, _ = fix_gauge(shapes, cameras)
    np.testing.assert_allclose(path @ moved, cameras @ shapes, atol=1e-5)


def test_a_galloping_horse(data_root):
    sequence = load("mesh_horse_gallop", data_root)
    some = np.linspace(0, sequence.tracks.n_points - 1, 1000).astype(int)
    found = reconstruct(np.ascontiguousarray(sequence.tracks.points[:, some]), method="bmm", gauge="method")
    shapes, cameras = found.shapes.transpose(0, 2, 1).astype(float), found.rotations
    true = sequence.shapes[:, some]
    errors = {}
    for choice in ("cameras", "auto"):
        moved, _, _ = fix_gauge(shapes, cameras, GaugeOptions(choice))
        errors[choice] = shape_error(moved.transpose(0, 2, 1), true, "global")
    assert errors["auto"] < 0.7 * errors["cameras"]
