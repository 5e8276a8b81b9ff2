"""Sequences read again by trimesh, and, where Blender is here, by test_blender."""

import json

import numpy as np
import pytest
import trimesh

import nrsfm.export as export
from nrsfm.export.colours import group_colours

from .conftest import COLUMNS, LEFT_OUT, ROWS, bending_sheet, with_perspective

GRID = f"grid:{ROWS}x{COLUMNS}"


def upright(result, frame, reference=0):
    """Points in the default world, by the definition of the camera: right, up, towards the viewer."""
    return result.shapes[frame].astype(float) @ result.rotations[reference].T * [1, -1, -1]


def load(path):
    return trimesh.load(path, process=False, maintain_order=True)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_surfaces_come_back(result, tmp_path, kind):
    folder = tmp_path / "séquence of frames"
    found = export.write(result, folder, format=kind, faces=GRID, colours="groups", reference=2)
    names = [f"frame_{f:04d}.{kind}" for f in range(result.n_frames)]
    assert sorted(path.name for path in folder.iterdir()) == ["about.json", *names]
    assert found.files == len(names) + 1
    assert found.size == sum(path.stat().st_size for path in folder.iterdir())
    for f, name in enumerate(names):
        mesh = load(folder / name)
        np.testing.assert_allclose(mesh.vertices, upright(result, f, 2), atol=1e-5)
        assert len(mesh.faces) == found.faces == 2 * (ROWS - 1) * (COLUMNS - 1)
        if f == 0:
            first = mesh.faces
        np.testing.assert_array_equal(mesh.faces, first)
        colours = np.asarray(mesh.visual.vertex_colors)[:, :3].astype(int)
        assert np.abs(colours - group_colours(result.groups)).max() <= 1  # OBJ has four digits
    normal = load(folder / names[2]).face_normals
    assert (normal[:, 2] > 0).mean() > 0.9  # they face the viewer


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_points_without_faces_come_back(result, tmp_path, kind):
    found = export.write(result, tmp_path / kind, format=kind)
    assert found.faces == 0
    cloud = load(tmp_path / kind / f"frame_0003.{kind}")
    np.testing.assert_allclose(cloud.vertices, upright(result, 3), atol=1e-5)


def test_ply_carries_what_is_known_of_each_point(holed, tmp_path):
    found = export.write(holed, tmp_path / "out", format="ply", faces=GRID, colours="#ff8000", scale=0.5)
    assert (found.points, found.left_out) == (46, 2)
    mesh = load(tmp_path / "out" / "frame_0004.ply")
    kept = np.flatnonzero(holed.reconstructed)
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert np.isfinite(mesh.vertices).all()
    np.testing.assert_allclose(mesh.vertices, 0.5 * upright(holed, 4)[kept], atol=1e-5)
    np.testing.assert_array_equal(data["point"].ravel(), kept)
    np.testing.assert_array_equal(data["group"].ravel(), holed.groups[kept])
    np.testing.assert_allclose(data["confidence"].ravel(), holed.confidence[4, kept])
    np.testing.assert_allclose(data["deviation"].ravel(), 0.5 * holed.depth_deviation[4, kept])
    assert set(map(tuple, np.asarray(mesh.visual.vertex_colors)[:, :3])) == {(255, 128, 0)}
    assert not set(kept[mesh.faces].ravel()) & set(LEFT_OUT)


def test_one_colour_is_the_material_of_an_obj(result, tmp_path):
    export.write(result, tmp_path / "out", format="obj", faces=GRID, colours="#ff8000")
    mesh = load(tmp_path / "out" / "frame_0001.obj")
    np.testing.assert_allclose(mesh.visual.material.diffuse[:3], [255, 128, 0], atol=1)
    np.testing.assert_allclose(mesh.vertices, upright(result, 1), atol=1e-5)


def test_about_says_what_the_files_cannot(holed, tmp_path):
    export.write(holed, tmp_path / "out", format="obj", fps=30, axes="z-up")
    about = json.loads((tmp_path / "out" / "about.json").read_text(encoding="utf-8"))
    assert (about["fps"], about["frames"], about["axes"], about["frame"]) == (30.0, 7, "z-up", "object")
    assert about["points"]["numbers"] == np.flatnonzero(holed.reconstructed).tolist()
    assert np.array(about["cameras"]["orientations"]).shape == (7, 3, 3)
    assert about["cameras"]["kind"] == "orthographic"
    export.write(with_perspective(bending_sheet()), tmp_path / "other", format="ply", frame="camera")
    about = json.loads((tmp_path / "other" / "about.json").read_text(encoding="utf-8"))
    assert about["points"]["numbers"] is None
    assert np.array(about["cameras"]["positions"]).shape == (1, 3)
    assert about["cameras"]["focal"] == [900.0, 850.0]
