"""Errors against brute force and under the transformations that each alignment must not see."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from nrsfm.errors import InputError
from nrsfm.metrics import (
    ALIGNMENTS,
    aligned,
    camera_frame_error,
    frame_errors,
    mocap_error,
    point_errors,
    rotation_error,
    shape_error,
)


class Result:
    def __init__(self, shapes, rotations=None):
        self.shapes, self.rotations = shapes, rotations


def random_rotations(rng, count):
    return Rotation.random(count, rng=rng).as_matrix()


def pair(seed, frames=4, points=9, noise=0.2):
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal((frames, points, 3)) * np.array([3.0, 2.0, 1.0])
    return truth + noise * rng.standard_normal(truth.shape), truth, rng


seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("align", ALIGNMENTS)
@given(seed=seeds)
@settings(max_examples=20)
def test_zero_for_the_truth_and_positive_else(align, seed):
    estimate, truth, _ = pair(seed)
    assert shape_error(truth, truth, align) == pytest.approx(0, abs=1e-12)
    assert shape_error(estimate, truth, align) > 0.01


@pytest.mark.parametrize("align", ALIGNMENTS)
@given(seed=seeds)
@settings(max_examples=20)
def test_translation_and_order_of_points_do_not_matter(align, seed):
    estimate, truth, rng = pair(seed)
    expected = frame_errors(estimate, truth, align)
    moved = estimate + rng.standard_normal((len(truth), 1, 3)) * 50
    np.testing.assert_allclose(frame_errors(moved, truth, align), expected, rtol=1e-6)
    order = rng.permutation(truth.shape[1])
    np.testing.assert_allclose(frame_errors(estimate[:, order], truth[:, order], align), expected, rtol=1e-9)
    np.testing.assert_allclose(frame_errors(9.0 * estimate, 9.0 * truth, align), expected, rtol=1e-9)


@given(seed=seeds, mirror=st.booleans())
@settings(max_examples=25)
def test_what_each_alignment_forgives(seed, mirror):
    estimate, truth, rng = pair(seed)
    flip = np.diag([1.0, 1.0, -1.0 if mirror else 1.0])
    once = estimate @ (random_rotations(rng, 1)[0] @ flip).T
    each = estimate @ (random_rotations(rng, len(truth)) @ flip).transpose(0, 2, 1)
    scaled = each * rng.uniform(0.2, 5, (len(truth), 1, 1))
    for align, same, different in (
        ("none", [], [once, each, scaled]),
        ("global", [once], [each, scaled]),
        ("per-frame", [once, each], [scaled]),
        ("similarity", [once, each, scaled], []),
    ):
        expected = shape_error(estimate, truth, align)
        for moved in same:
            assert shape_error(moved, truth, align) == pytest.approx(expected, rel=1e-6)
        for moved in different:
            assert abs(shape_error(moved, truth, align) - expected) > 1e-3


@given(seed=seeds)
@settings(max_examples=20)
def test_more_freedom_never_costs(seed):
    """Per frame the least squares over a larger family; the global fit minimises the sum of squares."""
    estimate, truth, _ = pair(seed, noise=1.0)
    none, per_frame, similarity = (frame_errors(estimate, truth, a) for a in ("none", "per-frame", "similarity"))
    assert np.all(per_frame <= none + 1e-12)
    assert np.all(similarity <= per_frame + 1e-12)
    weights = np.sum((truth - truth.mean(1, keepdims=True)) ** 2, axis=(1, 2))
    together = frame_errors(estimate, truth, "global")
    assert np.sum(weights * together**2) <= np.sum(weights * none**2) + 1e-9


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_alignments_are_optimal_by_brute_force(align):
    """Over rotations and reflections (and scales) by a general optimiser from many starts."""
    estimate, truth, _ = pair(3, frames=2, noise=0.8)
    est, true = (x - x.mean(axis=1, keepdims=True) for x in (estimate, truth))

    def cost(vector, frames, flip, scale):
        turn = flip * Rotation.from_rotvec(vector[:3]).as_matrix()
        size = np.exp(vector[3]) if scale else 1.0
        return np.sum((size * est[frames] @ turn.T - true[frames]) ** 2)

    def best(frames, scale):
        starts = np.random.default_rng(0).uniform(-3, 3, (6, 3))
        return min(
            minimize(cost, [*s, 0.0], args=(frames, flip, scale), tol=1e-12).fun for s in starts for flip in (1, -1)
        )

    errors = frame_errors(estimate, truth, align)
    norms = np.sum(true**2, axis=(1, 2))
    if align == "none":
        np.testing.assert_allclose(errors**2 * norms, np.sum((est - true) ** 2, axis=(1, 2)))
    elif align == "global":
        assert np.sum(errors**2 * norms) == pytest.approx(best([0, 1], False), rel=1e-6)
    else:
        for f in range(2):
            assert errors[f] ** 2 * norms[f] == pytest.approx(best([f], align == "similarity"), rel=1e-6)


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_valid_points_alone_count(align):
    estimate, truth, rng = pair(1, frames=3, points=12)
    valid = rng.random((3, 12)) < 0.6
    expected = frame_errors(estimate, truth, align, valid=valid)
    estimate[~valid], truth[~valid] = np.nan, np.inf
    np.testing.assert_allclose(frame_errors(estimate, truth, align, valid=valid), expected)
    if align != "global":
        for f in range(3):
            one = frame_errors(estimate[f : f + 1, valid[f]], truth[f : f + 1, valid[f]], align)
            np.testing.assert_allclose(expected[f], one[0])
    valid[1] = False
    errors = frame_errors(estimate, truth, align, valid=valid)
    assert np.isnan(errors[1])
    assert np.isfinite(shape_error(estimate, truth, align, valid=valid))


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_everything_valid_is_no_mask(align):
    estimate, truth, _ = pair(2)
    mask = np.ones(truth.shape[:2], dtype=bool)
    np.testing.assert_allclose(frame_errors(estimate, truth, align, valid=mask), frame_errors(estimate, truth, align))


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_single_point_shapes(align):
    estimate, truth, _ = pair(0, frames=3)
    truth[0] = estimate[0] = 7.0
    truth[1] = 1.0
    errors = frame_errors(estimate, truth, align)
    assert errors[0] == 0
    assert errors[1] == (0 if align == "similarity" else np.inf)
    assert np.isfinite(errors[2])
    estimate[2] = 0.0
    assert frame_errors(estimate, truth, align)[2] == pytest.approx(1.0)


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_aligned_and_point_errors_tell_the_same(align):
    estimate, truth, _ = pair(5)
    true = truth - truth.mean(axis=1, keepdims=True)
    moved = aligned(estimate, truth, align)
    errors = np.linalg.norm(moved - true, axis=(1, 2)) / np.linalg.norm(true, axis=(1, 2))
    np.testing.assert_allclose(errors, frame_errors(estimate, truth, align))
    np.testing.assert_allclose(point_errors(estimate, truth, align), np.linalg.norm(moved - true, axis=2))


def test_objects_and_float32_are_taken():
    estimate, truth, _ = pair(5)
    expected = shape_error(estimate, truth)
    assert shape_error(Result(estimate), Result(truth)) == expected
    assert shape_error(estimate.astype(np.float32), truth) == pytest.approx(expected, rel=1e-5)
    assert shape_error(np.round(9 * estimate).astype(int), np.round(9 * truth).astype(int)) > 0


@given(seed=seeds)
@settings(max_examples=15)
def test_mocap_error_is_its_definition(seed):
    estimate, truth, rng = pair(seed)
    spread = np.mean([np.mean([np.std(frame[:, c]) for c in range(3)]) for frame in truth])
    expected = np.mean(point_errors(estimate, truth, "global")) / spread
    assert mocap_error(estimate, truth) == pytest.approx(expected)
    turned = estimate @ random_rotations(rng, 1)[0].T
    assert mocap_error(turned, truth) == pytest.approx(expected, rel=1e-6)
    assert mocap_error(7 * estimate, 7 * truth) == pytest.approx(expected)
    assert mocap_error(truth, truth) == pytest.approx(0, abs=1e-12)


def test_mocap_error_of_points_without_extent():
    flat = np.ones((2, 3, 3))
    assert mocap_error(flat, flat) == 0
    assert mocap_error(pair(0, 2, 3)[0], flat) == np.inf


@given(seed=seeds, mirror=st.booleans(), rows=st.sampled_from([2, 3]))
@settings(max_examples=30)
def test_rotation_error_forgives_the_object_frame_and_the_mirror(seed, mirror, rows):
    rng = np.random.default_rng(seed)
    truth = random_rotations(rng, 6)
    estimate = truth @ random_rotations(rng, 1)[0]
    if mirror:
        flip = np.diag([1.0, 1.0, -1.0])
        estimate = flip @ estimate @ flip
    assert rotation_error(estimate[:, :rows], truth) == pytest.approx(0, abs=1e-4)
    assert rotation_error(Result(None, estimate), Result(None, truth[:, :rows])) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("degrees", [1.0, 20.0, 90.0])
def test_rotation_error_of_one_turned_camera(degrees):
    """Among many, the one wrong camera hardly moves the alignment: the mean is its angle over their number."""
    truth = random_rotations(np.random.default_rng(0), 400)
    estimate = truth.copy()
    estimate[7] = Rotation.from_rotvec([0, np.radians(degrees), 0]).as_matrix() @ truth[7]
    # The alignment shares at most about a second time that angle among all cameras.
    assert degrees / 400 * 0.5 < rotation_error(estimate, truth) < degrees / 400 * 2.5


@given(seed=seeds)
@settings(max_examples=20)
def test_camera_frame_error_forgives_frames_that_turn_with_their_cameras(seed):
    estimate, truth, rng = pair(seed)
    rotations = random_rotations(rng, len(truth))
    expected = camera_frame_error(Result(estimate, rotations), truth, rotations)
    drift = random_rotations(rng, len(truth))  # object frame of the estimate, another one in every frame
    turned = Result(estimate @ drift.transpose(0, 2, 1), rotations @ drift.transpose(0, 2, 1))
    assert camera_frame_error(turned, truth, rotations) == pytest.approx(expected, rel=1e-6)
    seen = np.stack([r @ s.T for r, s in zip(rotations, estimate, strict=True)]).transpose(0, 2, 1)
    true = np.stack([r @ s.T for r, s in zip(rotations, truth, strict=True)]).transpose(0, 2, 1)
    assert expected == pytest.approx(shape_error(seen, true, "global"))
    mirrored = Result(estimate, np.diag([1.0, 1.0, -1.0]) @ rotations)
    assert camera_frame_error(mirrored, truth, rotations) == pytest.approx(expected, rel=1e-6)


BAD = [
    (np.zeros((2, 3)), "shape"),
    (np.zeros((2, 3, 2)), "shape"),
    (np.zeros((0, 3, 3)), "at least one"),
    (np.zeros((2, 3, 3), dtype=complex), "dtype complex128"),
    (np.zeros((2, 3, 3), dtype=object), "dtype object"),
    (np.zeros((2, 4, 3)), r"\(2, 4, 3\)"),
    (np.full((2, 3, 3), np.nan), "18"),
]


@pytest.mark.parametrize(("value", "text"), BAD)
def test_bad_shapes_are_refused_by_name(value, text):
    good = np.ones((2, 3, 3))
    with pytest.raises(InputError, match=text) as caught:
        shape_error(value, good)
    assert "estimate" in str(caught.value)
    with pytest.raises(InputError, match=text) as caught:
        shape_error(good, value)
    assert "truth" in str(caught.value)


def test_other_arguments_are_checked():
    good = np.ones((2, 3, 3))
    with pytest.raises(InputError, match="did you mean 'global'"):
        shape_error(good, good, "globl")
    with pytest.raises(InputError, match="valid"):
        shape_error(good, good, valid=np.ones((3, 2), dtype=bool))
    with pytest.raises(InputError, match="valid"):
        shape_error(good, good, valid=np.ones((2, 3)))
    with pytest.raises(InputError, match="estimate"):
        rotation_error(np.ones((2, 3)), good)
    with pytest.raises(InputError, match="2 and 3"):
        rotation_error(np.ones((2, 3, 3)), np.ones((3, 3, 3)))
