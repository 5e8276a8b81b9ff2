"""The stage opened again by USD itself: points at and between frames, and tracks through its own cameras.

Tolerance: float32 of numbers of the object's size.
"""

import numpy as np
import pytest

import nrsfm.export as export
from nrsfm.errors import OptionError
from nrsfm.export.colours import linear

from .conftest import COLUMNS, FRAMES, ROWS, bending_sheet, seen_in_perspective, with_perspective

pxr = pytest.importorskip("pxr", reason="USD ABSENT: usd-core is not installed (the extra 'export')")

GRID = f"grid:{ROWS}x{COLUMNS}"


def opened(path):
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    surface = stage.GetPrimAtPath("/World/surface")
    return stage, surface, UsdGeom.Camera(stage.GetPrimAtPath("/World/camera"))


def points_in_world(surface, time):
    from pxr import UsdGeom

    points = np.array(UsdGeom.PointBased(surface).GetPointsAttr().Get(time), dtype=float)
    matrix = np.array(UsdGeom.Xformable(surface).ComputeLocalToWorldTransform(time))
    return points @ matrix[:3, :3] + matrix[3, :3]  # rows times matrices


def in_picture(camera, points, time):
    """Points as parts of the camera's picture, from -1 to 1, by USD's own camera."""
    from pxr import Gf

    frustum = camera.GetCamera(time).frustum
    matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    found = np.column_stack([points, np.ones(len(points))]) @ matrix
    assert isinstance(frustum, Gf.Frustum)
    return found[:, :3] / found[:, 3:]


@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".usd"])
def test_points_come_back_at_frames_and_between(result, tmp_path, suffix):
    path = tmp_path / f"büste of cloth{suffix}"
    found = export.write(result, path, faces=GRID, reference=2)
    _stage, surface, _ = opened(path)
    assert path.read_bytes()[:8] == (b"#usda 1." if suffix == ".usda" else b"PXR-USDC")
    assert surface.GetTypeName() == "Mesh"
    upright = result.shapes.astype(float) @ result.rotations[2].T * [1, -1, -1]
    for f in range(FRAMES):
        np.testing.assert_allclose(points_in_world(surface, f), upright[f], atol=1e-4)
    np.testing.assert_allclose(points_in_world(surface, 3.25), 0.75 * upright[3] + 0.25 * upright[4], atol=1e-4)
    assert [path.name for path in tmp_path.iterdir()] == [path.name]
    assert found.size == path.stat().st_size


def test_the_camera_sees_the_tracks(result, frame, tmp_path):
    export.write(result, tmp_path / "x.usdc", faces=GRID, frame=frame, image_size=(640, 480), reference=3)
    _, surface, camera = opened(tmp_path / "x.usdc")
    for f in range(FRAMES):
        seen = in_picture(camera, points_in_world(surface, f), f)
        pixels = np.column_stack([(seen[:, 0] + 1) / 2 * 640, (1 - seen[:, 1]) / 2 * 480]) - 0.5
        np.testing.assert_allclose(pixels, result.project()[f], atol=1e-2)
        assert (np.abs(seen[:, 2]) < 1).all()  # between the clipping planes


def test_a_perspective_camera_sees_what_was_seen(frame, tmp_path):
    result = with_perspective(bending_sheet())
    export.write(result, tmp_path / "x.usdc", frame=frame, image_size=(640, 480), axes="z-up", reference=1)
    _, surface, camera = opened(tmp_path / "x.usdc")
    for f in range(FRAMES):
        seen = in_picture(camera, points_in_world(surface, f), f)
        pixels = np.column_stack([(seen[:, 0] + 1) / 2 * 640, (1 - seen[:, 1]) / 2 * 480]) - 0.5
        np.testing.assert_allclose(pixels, seen_in_perspective(result, f), atol=1e-2)


def test_units_axes_and_time_are_stated(result, tmp_path):
    from pxr import UsdGeom

    for axes, word in (("y-up", "Y"), ("z-up", "Z")):
        export.write(result, tmp_path / f"{axes}.usda", axes=axes, fps=30, scale=0.001)
        stage, _, _ = opened(tmp_path / f"{axes}.usda")
        assert UsdGeom.GetStageUpAxis(stage) == word
        assert UsdGeom.GetStageMetersPerUnit(stage) == 0.001
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
        assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (30, 30)
        assert stage.GetDefaultPrim().GetPath() == "/World"
        assert stage.GetRootLayer().customLayerData["nrsfm"]["frames"] == FRAMES


def test_attributes_of_points(holed, tmp_path):
    from pxr import UsdGeom

    export.write(holed, tmp_path / "x.usdc", colours="groups")
    stage, surface, _ = opened(tmp_path / "x.usdc")  # the prim lives as long as its stage
    assert stage
    kept = np.flatnonzero(holed.reconstructed)
    variables = UsdGeom.PrimvarsAPI(surface)
    assert surface.GetTypeName() == "Points"
    np.testing.assert_array_equal(UsdGeom.Points(surface).GetIdsAttr().Get(), kept)
    np.testing.assert_array_equal(variables.GetPrimvar("point").Get(), kept)
    np.testing.assert_array_equal(variables.GetPrimvar("group").Get(), holed.groups[kept])
    np.testing.assert_allclose(variables.GetPrimvar("confidence").Get(4), holed.confidence[4, kept])
    from nrsfm.export.colours import group_colours

    colour = np.array(variables.GetPrimvar("displayColor").Get())
    np.testing.assert_allclose(colour, linear(group_colours(holed.groups[kept])), atol=1e-6)
    low, high = np.array(UsdGeom.Points(surface).GetExtentAttr().Get(2))
    points = points_in_world(surface, 2)
    np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)], atol=1e-4)


def test_axes_that_usd_does_not_know_are_refused(result, tmp_path):
    with pytest.raises(OptionError, match="y-up or z-up for usd"):
        export.write(result, tmp_path / "x.usdc", axes="opencv")


def test_without_the_library_one_line_and_nothing_written(result, tmp_path, monkeypatch):
    import sys

    from nrsfm.errors import InputError

    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match="usd-core"):
        export.write(result, tmp_path / "x.usdc")
    assert list(tmp_path.iterdir()) == []
