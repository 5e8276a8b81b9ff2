"""Errors against brute force and under the transformations that each alignment must not see."""

import tracemalloc

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
    depth_calibration,
    frame_errors,
    mocap_error,
    point_errors,
    rotation_error,
    scored_points,
    shape_error,
)
from nrsfm.reconstruction import Reconstruction


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
    assert np.isnan(shape_error(estimate, truth, align, valid=np.zeros_like(valid)))
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


def holed(seed, lost=(2, 5), frames=6, points=12):
    """A reconstruction without a shape for the points ``lost``, the truth, and the same two without these points."""
    estimate, truth, rng = pair(seed, frames, points)
    rotations = random_rotations(rng, frames)
    known = ~np.isin(np.arange(points), lost)
    estimate[:, ~known] = np.nan
    moved = np.zeros((frames, 2)), np.ones(frames)
    result = Reconstruction(estimate, rotations, *moved)
    return result, truth, Reconstruction(estimate[:, known], rotations, *moved), truth[:, known], known


@pytest.mark.parametrize("align", ALIGNMENTS)
@given(seed=seeds)
@settings(max_examples=10)
def test_points_without_a_shape_are_not_scored(align, seed):
    result, truth, part, true_part, known = holed(seed)
    np.testing.assert_array_equal(scored_points(result, truth), known)
    np.testing.assert_array_equal(scored_points(truth, result), known)
    np.testing.assert_allclose(frame_errors(result, truth, align), frame_errors(part, true_part, align), rtol=1e-9)
    np.testing.assert_allclose(frame_errors(truth, result, align), frame_errors(true_part, part, align), rtol=1e-9)
    for whole, expected in (
        (aligned(result, truth, align), aligned(part, true_part, align)),
        (point_errors(result, truth, align), point_errors(part, true_part, align)),
    ):
        np.testing.assert_allclose(whole[:, known], expected, rtol=1e-9)
        assert np.isnan(whole[:, ~known]).all()
    valid = np.random.default_rng(seed).random(truth.shape[:2]) < 0.7
    np.testing.assert_allclose(
        frame_errors(result, truth, align, valid=valid),
        frame_errors(part, true_part, align, valid=valid[:, known]),
        rtol=1e-9,
    )


@given(seed=seeds)
@settings(max_examples=10)
def test_the_other_scores_leave_them_out_too(seed):
    result, truth, part, true_part, _ = holed(seed)
    cameras = random_rotations(np.random.default_rng(seed), len(truth))
    assert mocap_error(result, truth) == pytest.approx(mocap_error(part, true_part))
    assert camera_frame_error(result, truth, cameras) == pytest.approx(camera_frame_error(part, true_part, cameras))
    assert rotation_error(result, cameras) == pytest.approx(rotation_error(part, cameras))


def test_plain_arrays_with_nan_are_still_refused():
    result, truth, *_ = holed(0)
    with pytest.raises(InputError, match="estimate: every coordinate must be finite, received 36"):
        shape_error(result.shapes, truth)
    assert scored_points(result.shapes, truth).all()


def calibrated(seed, *, told=1.0, unit=1.0, mirrored=False, frames=20, points=400):
    """A reconstruction whose depths err normally, by deviations that it tells times ``told``; truth and cameras."""
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal((frames, points, 3)) * np.array([3.0, 2.0, 1.0])
    cameras = random_rotations(rng, frames)
    deviation = rng.uniform(0.02, 0.2, (frames, points))
    error = deviation * rng.standard_normal((frames, points))
    seen = np.einsum("fij,fpj->fpi", cameras, truth)
    seen[..., 2] += error
    shapes = np.einsum("fji,fpj->fpi", cameras, seen)
    moved = np.zeros((frames, 2)), np.ones(frames)
    result = Reconstruction(shapes / unit, cameras, *moved, depth_deviation=told * deviation / unit)
    return (result.mirrored() if mirrored else result), truth, cameras


@pytest.mark.parametrize("unit", [1.0, 50.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_true_deviations_are_found_calibrated(unit, mirrored):
    result, truth, cameras = calibrated(3, unit=unit, mirrored=mirrored)
    found = depth_calibration(result, truth, cameras)
    assert found["entries"] == 8000
    assert found["within_1"] == pytest.approx(0.6827, abs=0.02)
    assert found["within_2"] == pytest.approx(0.9545, abs=0.01)
    assert found["error_rms"] == pytest.approx(found["deviation_rms"], rel=0.05)
    assert found["cameras"] == "true"
    still = np.tile(np.eye(3), (len(truth), 1, 1))
    in_camera = Reconstruction(
        result.camera_shapes(), still, result.translations, result.scales, depth_deviation=result.depth_deviation
    )
    again = depth_calibration(in_camera, np.einsum("fij,fpj->fpi", cameras, truth), still)
    assert again["within_1"] == pytest.approx(found["within_1"], abs=2e-3)


@pytest.mark.parametrize(("told", "within"), [(0.5, (0.3829, 0.6827)), (2.0, (0.9545, 0.9999))])
def test_deviations_that_are_too_small_or_too_large_show(told, within):
    result, truth, cameras = calibrated(4, told=told)
    found = depth_calibration(result, truth, cameras)
    assert (found["within_1"], found["within_2"]) == pytest.approx(within, abs=0.02)
    assert found["deviation_rms"] / found["error_rms"] == pytest.approx(told, rel=0.05)


def test_without_cameras_the_truth_is_turned_onto_the_estimate():
    result, truth, _ = calibrated(5)
    turned = truth @ random_rotations(np.random.default_rng(1), 1)[0]
    found = depth_calibration(result, turned)
    assert found["cameras"] == "aligned"
    assert found["within_1"] == pytest.approx(0.6827, abs=0.03)


def test_calibration_counts_valid_reconstructed_points_only():
    result, truth, cameras = calibrated(6, points=50)
    shapes, deviation = result.shapes.copy(), result.depth_deviation.copy()
    shapes[:, 7], deviation[:, 7] = np.nan, np.nan
    result = Reconstruction(shapes, cameras, result.translations, result.scales, depth_deviation=deviation)
    valid = np.ones(truth.shape[:2], dtype=bool)
    valid[3], valid[:, 9] = False, False
    truth[~valid] = np.nan
    found = depth_calibration(result, truth, cameras, valid=valid)
    assert found["entries"] == 19 * 48
    assert found["within_2"] > 0.9


def test_calibration_says_what_it_needs():
    result, truth, cameras = calibrated(7, frames=3, points=6)
    with pytest.raises(InputError, match="a reconstruction with depth_deviation is needed"):
        depth_calibration(Result(result.shapes, cameras), truth, cameras)
    with pytest.raises(InputError, match="valid: at least one point must count"):
        depth_calibration(result, truth, cameras, valid=np.zeros((3, 6), dtype=bool))


def whole_arrays(estimate, truth, align):
    """The definition of e3D, written with all frames at once."""
    a, b = (np.asarray(s, dtype=np.float64) for s in (estimate, truth))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    cross = np.einsum("fpi,fpj->fij", a, b)
    if align == "global":
        cross = np.broadcast_to(cross.sum(axis=0), cross.shape)
    u, _, vt = np.linalg.svd(cross)
    moved = a if align == "none" else a @ (u @ vt)
    if align == "similarity":
        moved = moved * (np.sum(moved * b, axis=(1, 2)) / np.sum(moved**2, axis=(1, 2)))[:, None, None]
    return np.mean(np.linalg.norm(moved - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2)))


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """Estimate and truth of 120 frames, 2,000 points, as memory-mapped float32 files."""
    folder, shapes = tmp_path_factory.mktemp("mapped"), pair(9, 120, 2000)[:2]
    for name, array in zip(("estimate", "truth"), shapes, strict=True):
        np.save(folder / f"{name}.npy", array.astype(np.float32))
    return [np.load(folder / f"{name}.npy", mmap_mode="r") for name in ("estimate", "truth")]


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_frame_by_frame_gives_what_all_frames_at_once_give(mapped, align):
    expected = whole_arrays(*mapped, align)
    assert shape_error(*mapped, align) == pytest.approx(expected, abs=1e-12)
    assert shape_error(*(np.array(shapes) for shapes in mapped), align) == shape_error(*mapped, align)


@pytest.mark.parametrize(
    "score",
    [
        lambda a, b: shape_error(a, b, "global"),
        lambda a, b: shape_error(a, b, "per-frame", valid=np.ones(b.shape[:2], dtype=bool)),
        mocap_error,
        lambda a, b: camera_frame_error(
            Result(a, np.tile(np.eye(3), (len(a), 1, 1))), b, np.tile(np.eye(3), (len(b), 1, 1))
        ),
    ],
    ids=["global", "per-frame", "mocap", "camera frame"],
)
def test_memory_is_that_of_a_few_frames(mapped, score):
    score(mapped[0][:2], mapped[1][:2])
    tracemalloc.start()
    score(*mapped)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    one_frame = 8 * mapped[0][0].size
    assert peak < 12 * one_frame, f"{peak / one_frame:.1f} frames in float64, of {len(mapped[0])}"


def test_a_coordinate_that_is_not_finite_is_found_in_the_last_frame():
    estimate, truth, _ = pair(1, frames=3)
    truth[2, 5, 1] = np.inf
    for score in (shape_error, mocap_error, aligned):
        with pytest.raises(InputError, match="truth: every coordinate must be finite, received 1 "):
            score(estimate, truth)
