"""The built-in sequences: exact sizes, exact geometry, deformation of no finite rank."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.datasets.synthetic import (
    CAMERAS,
    IMAGE_SIZE,
    SyntheticSequence,
    camera_rotations,
    face_sequence,
    sheet_sequence,
)
from nrsfm.errors import InputError, OptionError
from nrsfm.metrics import shape_error

MAKERS = [face_sequence, sheet_sequence]
makers = pytest.mark.parametrize("make", MAKERS)


def rank_spectrum(sequence: SyntheticSequence) -> np.ndarray:
    """Singular values of the mean-free shape matrix (one frame per row), relative to the first."""
    rows = sequence.shapes.reshape(len(sequence.shapes), -1)
    values = np.linalg.svd(rows - rows.mean(axis=0), compute_uv=False)
    return values / values[0]


@settings(max_examples=40, deadline=None)
@given(
    make=st.sampled_from(MAKERS),
    frames=st.integers(2, 9),
    points=st.integers(4, 700),
    camera=st.sampled_from(sorted(CAMERAS)),
    seed=st.integers(0, 2**40),
    deformation=st.floats(0, 2),
    zoom=st.floats(0, 0.5),
)
def test_sizes_and_projection(make, frames, points, camera, seed, deformation, zoom):
    s = make(frames, points, camera, 0.0, seed, deformation, zoom=zoom)
    assert s.tracks.points.shape == (frames, points, 2)
    assert s.shapes.shape == (frames, points, 3)
    assert np.isfinite(s.shapes).all()
    eye = np.broadcast_to(np.eye(3), (frames, 3, 3))
    np.testing.assert_allclose(s.rotations @ s.rotations.transpose(0, 2, 1), eye, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(s.rotations), 1.0, atol=1e-12)
    seen = np.einsum("fij,fpj->fpi", s.rotations[:, :2], s.shapes)
    np.testing.assert_allclose(s.tracks.points, s.scales[:, None, None] * seen + s.translations[:, None], atol=1e-9)
    assert s.faces.ndim == 2
    assert s.faces.shape[1] == 3
    assert s.faces.min() >= 0
    assert s.faces.max() < points
    assert (s.scales > 0).all()


@makers
def test_same_arguments_same_sequence_other_seed_other_motion(make):
    one, two, other = make(6, 200, noise=0.01), make(6, 200, noise=0.01), make(6, 200, noise=0.01, seed=1)
    np.testing.assert_array_equal(one.tracks.points, two.tracks.points)
    np.testing.assert_array_equal(one.shapes, two.shapes)
    assert np.abs(one.shapes - other.shapes).max() > 1.0


@makers
def test_more_frames_sample_the_same_motion(make):
    coarse, fine = make(5, 150), make(9, 150)
    np.testing.assert_allclose(coarse.shapes, fine.shapes[::2], atol=1e-9)


@makers
def test_not_low_rank_by_construction(make):
    values = rank_spectrum(make(99, 1500))
    # No cut-off: every singular value but the last (lost to the mean) is far above rounding, and from each to
    # the next the fall is gentle. A linear basis of K shapes would fall to rounding after K.
    assert values[97] > 1e-11
    assert (values[1:98] / values[:97]).min() > 0.05
    assert values[11] > 1e-2


def test_rigid_without_deformation():
    shapes = face_sequence(8, 300, deformation=0.0).shapes
    np.testing.assert_allclose(shapes, np.broadcast_to(shapes[0], shapes.shape), atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_expressions_are_as_large_as_real_ones(seed):
    s = face_sequence(60, 1200, seed=seed)
    rigid = np.broadcast_to(s.shapes.mean(axis=0), s.shapes.shape)
    assert 0.045 < shape_error(rigid, s.shapes, "per-frame") < 0.08


def test_an_expression_is_local():
    from nrsfm.datasets import face_surface as face

    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-80, 80, 41), np.linspace(-90, 80, 41)))
    skin = face.make_skin(u, v)
    rest = dict.fromkeys(face.EXPRESSIONS, 0.0)
    still = face.pose(skin, rest)
    for name in face.EXPRESSIONS:
        moved = np.linalg.norm(face.pose(skin, rest | {name: 1.0}) - still, axis=0)
        assert moved.max() > 2.0, name
        assert np.median(moved) < 0.15 * moved.max(), name


def test_expressions_are_not_linear_in_their_strength():
    from nrsfm.datasets import face_surface as face

    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-80, 80, 41), np.linspace(-90, 80, 41)))
    skin = face.make_skin(u, v)
    rest = dict.fromkeys(face.EXPRESSIONS, 0.0)
    still = face.pose(skin, rest)
    for name in face.EXPRESSIONS:
        half, full = (face.pose(skin, rest | {name: a}) - still for a in (0.5, 1.0))
        assert np.abs(full - 2 * half).max() > 0.05, name


@pytest.mark.parametrize("ratio", [0.01, 0.05])
def test_noise_has_the_stated_level(ratio):
    clean, noisy = face_sequence(12, 2000), face_sequence(12, 2000, noise=ratio)
    np.testing.assert_array_equal(clean.shapes, noisy.shapes)
    centred = clean.tracks.points - clean.tracks.points.mean(axis=1, keepdims=True)
    added = noisy.tracks.points - clean.tracks.points
    assert added.std() == pytest.approx(ratio * np.abs(centred).max(), rel=0.02)
    assert abs(added.mean()) < 0.02 * added.std()


def test_the_face_looks_at_the_camera_and_stands_upright():
    s = face_sequence(3, 3000, "pan30", deformation=0.0)
    shape = s.shapes[1]  # the middle frame faces the camera
    np.testing.assert_allclose(s.rotations[1], np.eye(3), atol=1e-12)
    nose = shape[np.argmin(shape[:, 2])]  # z grows away from the camera
    extent = np.ptp(shape, axis=0)
    assert abs(nose[0]) < 0.03 * extent[0]
    from_top = (nose[1] - shape[:, 1].min()) / extent[1]  # y grows downwards
    assert 0.5 < from_top < 0.68
    assert 0.6 < extent[0] / extent[1] < 0.8
    assert (s.tracks.points >= 0).all()
    assert (s.tracks.points <= IMAGE_SIZE).all()


def test_triangles_cover_the_dense_face_once_and_face_one_way():
    s = face_sequence(2, 5000, deformation=0.0)
    corners = s.shapes[0][s.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] * np.sign(np.median(normal[:, 2])) > 0).mean() > 0.95
    assert len(np.unique(np.sort(s.faces, axis=1), axis=0)) == len(s.faces)
    assert len(np.unique(s.faces)) == 5000
    edges = np.sort(np.concatenate([s.faces[:, [0, 1]], s.faces[:, [1, 2]], s.faces[:, [2, 0]]]), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() == 2


def test_camera_paths():
    def yaw(name):
        return np.degrees(np.arctan2(*camera_rotations(name, 61)[:, 0, [2, 0]].T))

    assert sorted(np.abs(yaw("pan30"))[[0, -1]].round(6)) == [30.0, 30.0]
    assert sorted(np.abs(yaw("pan90"))[[0, -1]].round(6)) == [90.0, 90.0]
    turns = {name: np.count_nonzero(np.diff(np.sign(np.diff(yaw(name))))) for name in ("fast", "slow")}
    assert turns["fast"] >= 5
    assert 1 <= turns["slow"] <= 2


def test_dtype_is_as_asked_and_changes_little():
    small, large = face_sequence(4, 300, dtype="float32"), face_sequence(4, 300)
    assert small.shapes.dtype == small.tracks.points.dtype == np.float32
    assert large.shapes.dtype == large.tracks.points.dtype == np.float64
    np.testing.assert_allclose(small.tracks.points, large.tracks.points, atol=1e-3)


@makers
@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"frames": 1}, "frames"),
        ({"frames": 3.0}, "frames"),
        ({"frames": True}, "frames"),
        ({"points": 3}, "points"),
        ({"points": -5}, "points"),
        ({"camera": "quick"}, "camera"),
        ({"camera": None}, "camera"),
        ({"camera": ["fast"]}, "camera"),
        ({"noise": -0.1}, "noise"),
        ({"noise": float("nan")}, "noise"),
        ({"seed": -1}, "seed"),
        ({"seed": 0.5}, "seed"),
        ({"deformation": 3}, "deformation"),
        ({"deformation": "large"}, "deformation"),
        ({"zoom": 0.9}, "zoom"),
    ],
)
def test_bad_arguments(make, arguments, word):
    with pytest.raises(OptionError, match=f"^{word} must be") as caught:
        make(**{"frames": 3, "points": 10, **arguments})
    assert "\n" not in str(caught.value)
    assert repr(next(iter(arguments.values()))) in str(caught.value)


def test_bad_dtype():
    with pytest.raises(InputError, match="dtype"):
        face_sequence(3, 10, dtype="int32")


def test_a_wrong_camera_names_the_near_one():
    with pytest.raises(OptionError, match="did you mean 'pan30'"):
        face_sequence(3, 10, "pan3")
