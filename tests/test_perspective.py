"""Perspective: the correction is exact where depth is, and evidence speaks only where there is some."""

from dataclasses import replace

import numpy as np
import pytest

import nrsfm
from nrsfm import datasets
from nrsfm.errors import InputError
from nrsfm.metrics import shape_error
from nrsfm.perspective import (
    PerspectiveOptions,
    averaged_shapes,
    find_perspective,
    mirror_evidence,
    perspective_error,
    undo_perspective,
    with_perspective,
)
from nrsfm.perspective import model as low_rank
from nrsfm.perspective.geometry import checked_intrinsics
from nrsfm.reconstruction import Reconstruction

SKEWED = np.array([[900.0, 3.0, 310.0], [0.0, 850.0, 260.0], [0.0, 0.0, 1.0]])


def seen_by(shapes: np.ndarray, intrinsics: np.ndarray, depth: np.ndarray, aside: np.ndarray) -> np.ndarray:
    """Image (F, P, 2) of shapes (F, P, 3) in camera axes whose origin is at (aside, depth) of each frame."""
    placed = shapes + np.concatenate([aside, depth[:, None]], axis=1)[:, None]
    image = placed @ intrinsics.T
    return image[..., :2] / image[..., 2:]


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, float]:
    """A talking face 40 frames long: shapes in camera axes about their centroid, rotations, a focal length."""
    sequence = datasets.synthetic.face_sequence(40, 80, "fast", seed=3)
    shapes = np.einsum("fij,fpj->fpi", sequence.rotations, sequence.shapes)
    shapes -= shapes.mean(axis=1, keepdims=True)
    return shapes, sequence.rotations, np.sqrt(np.mean(shapes[..., :2] ** 2))


def view(scene: tuple[np.ndarray, np.ndarray, float], strength: float) -> tuple[np.ndarray, np.ndarray]:
    """Perspective image of the scene and its camera matrix; strength 0 is orthography."""
    shapes, _, size = scene
    if strength == 0:
        return shapes[..., :2] + 200.0, np.eye(3)
    focal = size / strength
    matrix = np.array([[focal, 0, 200.0], [0, focal, 190.0], [0, 0, 1.0]])
    time = np.linspace(0, 3, len(shapes))
    aside = 0.3 * size * np.stack([np.sin(time), np.cos(time)], axis=1)
    return seen_by(shapes, matrix, focal * (1 + 0.03 * np.sin(2 * time)), aside), matrix


def solve(points: np.ndarray) -> Reconstruction:
    return nrsfm.reconstruct(points, method="bmm", scales="free", perspective="off")


@pytest.fixture(scope="module")
def affine(scene) -> tuple[np.ndarray, np.ndarray, Reconstruction]:
    """The scene in perspective, its camera matrix, and an affine reconstruction of it."""
    points, matrix = view(scene, 0.1)
    return points, matrix, solve(points)


def depth_agreement(result: Reconstruction, truth: np.ndarray) -> float:
    seen = result.camera_shapes()[..., 2]
    seen = seen - seen.mean(axis=1, keepdims=True)
    return float(np.sum(seen * truth[..., 2]))


def truth_of(scene: tuple[np.ndarray, np.ndarray, float], flip: bool = False) -> Reconstruction:
    shapes, rotations, _ = scene
    result = Reconstruction(
        np.swapaxes(np.swapaxes(rotations, 1, 2) @ np.swapaxes(shapes, 1, 2), 1, 2),
        rotations,
        np.zeros((len(shapes), 2)),
        np.ones(len(shapes)),
    )
    return result.mirrored() if flip else result


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_true_depth_undoes_perspective_exactly(kind: type) -> None:
    rng = np.random.default_rng(0)
    shapes = rng.standard_normal((5, 30, 3))
    shapes -= shapes.mean(axis=1, keepdims=True)
    depth, aside = rng.uniform(8, 12, 5), rng.uniform(-4, 4, (5, 2))
    points = seen_by(shapes, SKEWED, depth, aside).astype(kind)
    points.flags.writeable = False
    scales = SKEWED[0, 0] / depth
    found = undo_perspective(points, shapes[..., 2], scales, SKEWED)
    expected = scales[:, None, None] * (shapes[..., :2] + aside[:, None]) + SKEWED[:2, 2]
    assert found.dtype == kind
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 if kind is np.float64 else 5e-3)


def test_a_missing_point_stays_missing() -> None:
    points = np.full((3, 4, 2), 5.0)
    points[1, 2] = np.nan
    found = undo_perspective(points, np.zeros((3, 4)), np.ones(3), np.diag([10.0, 10.0, 1.0]))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(points))
    np.testing.assert_allclose(found[0], points[0])


def test_the_error_of_the_truth_is_zero_and_that_of_its_mirror_image_is_not(scene) -> None:
    points, matrix = view(scene, 0.1)
    time = np.linspace(0, 3, len(points))
    result = replace(truth_of(scene), scales=1 / (1 + 0.03 * np.sin(2 * time)))
    points[7, 3] = np.nan
    assert perspective_error(points, result, matrix).max() < 1e-9
    assert perspective_error(points, result.mirrored(), matrix).min() > 0.5
    assert np.isnan(perspective_error(np.full_like(points, np.nan), result, matrix)).all()


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        np.eye(4)[:3],
        np.diag([0.0, 1.0, 1.0]),
        np.diag([-5.0, 5.0, 1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.full((3, 3), np.nan),
        SKEWED.T,
        np.array([["a"] * 3] * 3),
    ],
)
def test_what_is_no_camera_matrix_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(InputError, match="intrinsics"):
        checked_intrinsics(matrix)


def test_arrays_of_other_sizes_are_refused() -> None:
    points = np.zeros((3, 4, 2))
    for depths, scales, name in ((np.zeros((4, 3)), np.ones(3), "depths"), (np.zeros((3, 4)), np.ones(4), "scales")):
        with pytest.raises(InputError, match=name):
            undo_perspective(points, depths, scales, np.eye(3))
    with pytest.raises(InputError, match="points"):
        undo_perspective(points[0], np.zeros((3, 4)), np.ones(3), np.eye(3))


def model_of(scene, points: np.ndarray, matrix: np.ndarray, rank: int, flip: bool = False):
    size = scene[2]
    result = truth_of(scene, flip)
    tracks = np.swapaxes(points - matrix[:2, 2], 1, 2) / size
    return tracks, low_rank.start(
        tracks, result.rotations, result.scales, np.swapaxes(result.shapes, 1, 2) / size, rank
    )


def test_the_mirror_image_is_the_model_with_the_other_sign_of_strength(scene) -> None:
    points, matrix = view(scene, 0.1)
    tracks, here = model_of(scene, points, matrix, 2)
    _, there = model_of(scene, points, matrix, 2, flip=True)
    for strength in (0.0, 0.1):
        one = low_rank.fit(here, tracks, strength, 4)
        other = low_rank.fit(there, tracks, -strength, 4)
        assert one.likelihood == pytest.approx(other.likelihood, abs=1e-6)
        np.testing.assert_allclose(one.camera_shapes()[:, 2], -other.camera_shapes()[:, 2], atol=1e-4)


def test_points_are_recovered_from_true_cameras_and_weights() -> None:
    rng = np.random.default_rng(1)
    frames, count, rank, strength = 20, 9, 2, 0.15
    rotations = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    parts, weights = rng.standard_normal((rank + 1, 3, count)), rng.standard_normal((frames, rank))
    shapes = parts[0] + np.einsum("fk,kip->fip", weights, parts[1:])
    seen = rotations @ shapes
    tracks = seen[:, :2] / (1 + strength * seen[:, 2:])
    state = low_rank.LowRankModel(
        parts[0], parts[1:], rotations, np.ones(frames), np.zeros((frames, 2)), 1.0, weights,
        np.zeros((frames, rank, rank)), shapes,
    )  # fmt: skip
    np.testing.assert_allclose(low_rank.point_systems(state, tracks, strength), parts, atol=1e-3)


def test_the_fit_climbs_and_leaves_its_start_alone(scene) -> None:
    points, matrix = view(scene, 0.1)
    tracks, begin = model_of(scene, points, matrix, 3)
    kept = {name: np.copy(value) for name, value in begin.__dict__.items()}
    likelihoods = [low_rank.fit(begin, tracks, 0.1, steps).likelihood for steps in (1, 4, 16)]
    assert likelihoods == sorted(likelihoods)
    for name, value in begin.__dict__.items():
        np.testing.assert_array_equal(value, kept[name])


@pytest.mark.parametrize("flip", [False, True])
def test_focal_length_and_mirror_image_are_found_together(scene, affine, flip: bool) -> None:
    points, matrix, first = affine
    if (depth_agreement(first, scene[0]) < 0) != flip:
        first = first.mirrored()
    found = find_perspective(points, first)
    assert found.decided
    assert found.flip == flip
    assert found.by == "perspective"
    assert found.strength == pytest.approx(0.1, rel=0.2)
    assert found.intrinsics[0, 0] == pytest.approx(matrix[0, 0], rel=0.2)
    given = find_perspective(points, first, matrix)
    assert given.decided
    assert given.flip == flip
    assert given.by == "intrinsics"
    evidence = mirror_evidence(given)
    assert (evidence["decided"], evidence["by"], evidence["flip"]) == (True, "intrinsics", flip)
    assert evidence["strength"] > 0


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_nothing_is_found_in_orthographic_tracks(scene, noise: float) -> None:
    points, _ = view(scene, 0.0)
    size = float(np.abs(points - points.mean(axis=1, keepdims=True)).max())
    points = points + noise * size * np.random.default_rng(0).standard_normal(points.shape)
    found = find_perspective(points, solve(points))
    assert not found.decided
    assert not found.flip
    assert found.strength == 0
    assert found.by == "convention"
    assert found.reason


@pytest.mark.parametrize("size", [1e-3, 1e4])
def test_the_unit_of_the_image_does_not_matter(affine, size: float) -> None:
    points, _, first = affine
    moved = replace(first, shapes=first.shapes * size, translations=first.translations * size)
    one, other = find_perspective(points, first), find_perspective(points * size, moved)
    assert other.strength == pytest.approx(one.strength, rel=1e-3)
    assert other.intrinsics[0, 0] == pytest.approx(one.intrinsics[0, 0] * size, rel=1e-3)


def test_few_frames_or_points_decide_nothing(scene) -> None:
    points, matrix = view(scene, 0.1)
    whole = truth_of(scene)
    for rows, columns in ((slice(0, 4), slice(None)), (slice(None), slice(0, 6))):
        part = Reconstruction(
            whole.shapes[rows, columns], whole.rotations[rows], whole.translations[rows], whole.scales[rows]
        )
        for intrinsics in (None, matrix):
            found = find_perspective(points[rows, columns], part, intrinsics)
            assert not found.decided
            assert "fewer" in found.reason


def test_rigid_and_flat_tracks_are_survived(scene) -> None:
    points, _ = view(scene, 0.0)
    whole = truth_of(scene)
    still = np.repeat(points[:1], 20, axis=0)
    cameras = np.repeat(whole.rotations[:1], 20, axis=0)
    shapes = np.repeat(whole.shapes[:1], 20, axis=0)
    flat = Reconstruction(shapes * [1, 1, 0], cameras, np.zeros((20, 2)), np.ones(20))
    assert np.isfinite(find_perspective(still, flat).strength)
    for final in ("average", "model"):
        result, report = with_perspective(
            still, lambda _: flat, PerspectiveOptions(intrinsics=np.diag([2000.0, 2000.0, 1.0])), final=final
        )
        assert np.isfinite(result.shapes).all()
        assert "mirror" in report


@pytest.mark.parametrize(("known", "final"), [(True, "average"), (False, "model"), (False, "solve")])
def test_undoing_perspective_improves_the_shapes(scene, affine, known: bool, final: str) -> None:
    points, matrix, first = affine
    options = PerspectiveOptions(intrinsics=matrix if known else None)
    result, report = with_perspective(points, solve, options, first=first, final=final)
    before, after = (shape_error(r, scene[0], "similarity") for r in (first, result))
    assert after < 0.75 * before
    assert depth_agreement(result, scene[0]) > 0
    assert report["undone"]
    assert report["focal"] == pytest.approx(matrix[0, 0], rel=0.2)
    np.testing.assert_allclose(result.scales.mean(), 1, atol=0.05)
    # The contract holds for the tracks without perspective.
    depths = result.camera_shapes()[..., 2]
    depths = depths - depths.mean(axis=1, keepdims=True)
    without = undo_perspective(points, depths, result.scales, np.array(report["intrinsics"]))
    assert np.sqrt(np.mean((result.project() - without) ** 2)) < 0.03 * scene[2]


def test_off_and_orthography_return_the_affine_answer(scene) -> None:
    calls = []

    def counted(points: np.ndarray) -> Reconstruction:
        calls.append(1)
        return answer

    answer = truth_of(scene)
    for points, mode in ((view(scene, 0.1)[0], "off"), (view(scene, 0.0)[0], "auto")):
        calls.clear()
        result, report = with_perspective(points, counted, PerspectiveOptions(perspective=mode))
        assert len(calls) == 1
        assert not report["undone"]
        assert result is answer


def test_points_outside_the_sample_get_the_same_shapes_as_those_in_it(scene) -> None:
    points, matrix = view(scene, 0.1)
    first = truth_of(scene)
    doubled = Reconstruction(np.repeat(first.shapes, 2, axis=1), first.rotations, first.translations, first.scales)
    found = averaged_shapes(np.repeat(points, 2, axis=1), doubled, matrix)
    np.testing.assert_allclose(found.shapes[:, ::2], found.shapes[:, 1::2], atol=1e-3 * scene[2])
    assert shape_error(found.shapes[:, ::2], scene[0], "similarity") < 0.05


def test_real_video(data_root) -> None:
    sequence = datasets.load("back_real126", data_root)
    points = np.asarray(sequence.tracks.points)
    result, report = with_perspective(points, solve, PerspectiveOptions(), final="model")
    camera = np.array(sequence.note["P34"])
    axis = camera[2, :3] / np.linalg.norm(camera[2, :3])
    truth = np.asarray(sequence.shapes) @ (
        axis * np.sign(np.median(np.asarray(sequence.shapes) @ camera[2, :3] + camera[2, 3]))
    )
    depths = result.camera_shapes()[..., 2]
    assert np.mean([np.corrcoef(a, b)[0, 1] for a, b in zip(depths, truth, strict=True)]) > 0.8
    assert report["mirror"]["by"] == "perspective"
    assert 0.08 < report["strength"] < 0.13
    assert shape_error(result, sequence.shapes, "similarity") < 0.06


def test_tracks_that_follow_no_camera_show_no_perspective(scene, affine) -> None:
    """Outliers that are left in the tracks look like perspective, and undoing it would tear the shapes."""
    points, _, first = affine
    assert with_perspective(points, solve, PerspectiveOptions(), first=first)[1]["undone"]
    wrong = np.random.default_rng(0).random(points.shape[:2]) < 0.05
    wild = points + 2.0 * scene[2] * wrong[..., None]
    result, report = with_perspective(wild, solve, PerspectiveOptions(), first=first)
    assert result is first
    assert not report["undone"]
    assert "no camera" in report["reason"]
