"""Laws of the world: it is turned and not mirrored, its cameras see the tracks, and still and moving views agree."""

import numpy as np
import pytest

from nrsfm.errors import InputError
from nrsfm.export.axes import CONVENTIONS, world_from_object
from nrsfm.export.options import ExportOptions
from nrsfm.export.scene import make_scene

from .conftest import MATRIX, bending_sheet, seen_in_perspective, view, with_perspective


def scene_of(result, **options):
    return make_scene(result, ExportOptions(**{"format": "npz", **options}), None, None)


@pytest.mark.parametrize("axes", CONVENTIONS)
def test_the_world_is_a_rotation(result, axes):
    world = world_from_object(result.rotations[2], axes)
    np.testing.assert_allclose(world @ world.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(world) > 0.999


def test_the_reference_image_is_upright_in_every_convention(result):
    image = result.project()[3] - result.translations[3]
    right, down = (image / result.scales[3]).T
    points = {axes: scene_of(result, axes=axes, reference=3).points(3) for axes in CONVENTIONS}
    np.testing.assert_allclose(points["y-up"][:, :2], np.column_stack([right, -down]), atol=1e-4)
    np.testing.assert_allclose(points["opencv"][:, :2], np.column_stack([right, down]), atol=1e-4)
    np.testing.assert_allclose(points["z-up"][:, [0, 2]], np.column_stack([right, -down]), atol=1e-4)
    away = result.camera_depths()[3]
    np.testing.assert_allclose(points["y-up"][:, 2], -away, atol=1e-4)
    np.testing.assert_allclose(points["z-up"][:, 1], away, atol=1e-4)
    np.testing.assert_allclose(points["opencv"][:, 2], away, atol=1e-4)


@pytest.mark.parametrize("axes", CONVENTIONS)
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_moving_cameras_see_the_tracks(result, axes, scale):
    scene = scene_of(result, axes=axes, scale=scale, reference=2)
    cameras, image = scene.cameras, result.project()
    for f in range(result.n_frames):
        seen = view(scene.points(f), cameras.orientations[f], cameras.positions[f])
        pixels = seen[:, :2] * [1, -1] * cameras.scales[f] / scale + cameras.centre
        np.testing.assert_allclose(pixels, image[f], atol=1e-3)
        assert (-seen[:, 2] > cameras.near).all()
        assert (-seen[:, 2] < cameras.far).all()


def test_a_still_camera_sees_the_tracks(result):
    scene = scene_of(result, frame="camera", scale=0.5, reference=4)
    cameras, image = scene.cameras, result.project()
    position = cameras.positions_at(cameras.mean_scale)[4]
    for f in range(result.n_frames):
        seen = view(scene.points(f), cameras.orientations[4], position)
        pixels = seen[:, :2] * [1, -1] * cameras.mean_scale / 0.5 + cameras.centre
        np.testing.assert_allclose(pixels, image[f], atol=1e-3)


@pytest.mark.parametrize("still", [False, True])
def test_perspective_cameras_see_what_was_seen_before_perspective_was_undone(result, still):
    result = with_perspective(result)
    scene = scene_of(result, frame="camera" if still else "object", reference=1)
    cameras = scene.cameras
    assert cameras.kind == "perspective"
    assert not cameras.grows
    for f in range(result.n_frames):
        at = 1 if still else f
        seen = view(scene.points(f), cameras.orientations[at], cameras.positions[at])
        pixels = seen[:, :2] / -seen[:, 2:] * [1, -1] * cameras.focal + cameras.centre
        np.testing.assert_allclose(pixels, seen_in_perspective(result, f), atol=1e-3)


def test_the_view_holds_all_points_or_is_the_image(result):
    left, right, top, bottom = scene_of(result).cameras.window
    image = result.project().reshape(-1, 2)
    assert left < image[:, 0].min() < image[:, 0].max() < right
    assert top < image[:, 1].min() < image[:, 1].max() < bottom
    assert scene_of(result, image_size=(640, 480)).cameras.window == (-0.5, 639.5, -0.5, 479.5)


def test_equal_scales_move_nothing():
    scene = scene_of(bending_sheet(scales=False))
    assert not scene.cameras.grows


def test_points_without_a_shape_are_left_out_and_numbered(holed):
    scene = scene_of(holed)
    assert np.isfinite(scene.points(0)).all()
    np.testing.assert_array_equal(scene.kept, np.flatnonzero(holed.reconstructed))


def test_a_skew_is_told_of(result):
    import dataclasses

    matrix = MATRIX.copy()
    matrix[0, 1] = 2
    skewed = {"perspective": {"undone": True, "intrinsics": matrix.tolist(), "focal": 900.0}}
    assert "skew of 2" in scene_of(dataclasses.replace(result, diagnostics=skewed)).warnings[0]
    assert scene_of(with_perspective(result)).warnings == ()


def test_a_camera_matrix_that_is_none_is_refused(result):
    import dataclasses

    broken = {"perspective": {"undone": True, "intrinsics": [[1, 2], [3]], "focal": 3.0}}
    with pytest.raises(InputError, match="camera matrix"):
        scene_of(dataclasses.replace(result, diagnostics=broken))
