"""The files opened by Blender itself, in a process of its own: Blender is no dependency, and under another licence.

NRSFM_BLENDER names a Python that has the module bpy (or is found in it by itself, where bpy is installed).
"""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nrsfm.export as export

from .conftest import COLUMNS, FRAMES, ROWS, bending_sheet, seen_in_perspective, view, with_perspective

GRID = f"grid:{ROWS}x{COLUMNS}"
TIMES = (0, 1, 3, 3.5, FRAMES - 1)
TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@pytest.fixture(scope="module")
def blender():
    python = os.environ.get("NRSFM_BLENDER") or (sys.executable if importlib.util.find_spec("bpy") else None)
    if not python:
        pytest.skip("BLENDER ABSENT: no module 'bpy' (set NRSFM_BLENDER to a Python that has it to test with Blender)")

    def read(path, times=TIMES):
        script, target = Path(__file__).with_name("read_in_blender.py"), path.with_name("found.npz")
        words = [python, str(script), str(path), "25", ",".join(map(str, times)), str(target)]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=200)
        assert target.exists(), done.stdout + done.stderr
        with np.load(target) as found:
            return dict(found)

    return read


def upright(result, time):
    """Points in Blender's world at a time between frames: the reference camera looks along +y, z is up."""
    low = min(int(time), FRAMES - 2)
    shape = (1 - (time - low)) * result.shapes[low] + (time - low) * result.shapes[low + 1]
    return shape.astype(float) @ result.rotations[0].T @ np.diag([1, -1, -1]) @ TO_Z_UP.T


@pytest.mark.parametrize("faces", [None, GRID])
def test_glb_moves_as_it_should(blender, tmp_path, faces):
    result = bending_sheet(scales=False)
    export.write(result, tmp_path / "fläche 1.glb", faces=faces, colours="groups", scale=0.01, targets=FRAMES)
    found = blender(tmp_path / "fläche 1.glb")
    for points, time in zip(found["points"], TIMES, strict=True):
        np.testing.assert_allclose(points, 0.01 * upright(result, time), atol=1e-5)
    assert found["polygons"] == (0 if faces is None else 2 * (ROWS - 1) * (COLUMNS - 1))
    assert len(found["colours"]) == 1


def test_glb_is_seen_as_it_was(blender, frame, tmp_path):
    result = bending_sheet()
    export.write(result, tmp_path / "x.glb", faces=GRID, frame=frame, targets=FRAMES, image_size=(640, 480))
    found = blender(tmp_path / "x.glb", [0, 2, 6])
    for k, f in enumerate([0, 2, 6]):
        camera = found["cameras"][k]
        seen = view(found["points"][k], camera[:3, :3], camera[:3, 3])
        pixels = seen[:, :2] * [1, -1] / found["ortho_scale"][k] * 640 + [319.5, 239.5]
        np.testing.assert_allclose(pixels, result.project()[f], atol=2e-2)


@pytest.mark.parametrize("name", ["x.glb", "x.usdc"])
def test_perspective_is_seen_as_it_was(blender, tmp_path, name):
    result = with_perspective(bending_sheet())
    options = {"targets": FRAMES} if name == "x.glb" else {}
    export.write(result, tmp_path / name, image_size=(640, 480), **options)
    found = blender(tmp_path / name, [0, 2, 6])
    for k, f in enumerate([0, 2, 6]):
        camera = found["cameras"][k]
        seen = view(found["points"][k], camera[:3, :3], camera[:3, 3])
        pixels = seen[:, :2] / -seen[:, 2:] * [900, -850] + [310, 250]
        np.testing.assert_allclose(pixels, seen_in_perspective(result, f), atol=2e-2)
    lens, width, height = found["lens"][0]
    if name == "x.usdc":
        assert lens / width == pytest.approx(900 / 640, rel=1e-4)
    else:  # vertical, and the width is that of the pictures: the view symmetric about the principal point
        assert lens / height == pytest.approx(850 / (2 * 250.5), rel=1e-4)


@pytest.mark.parametrize("faces", [None, GRID])
def test_usd_moves_as_it_should(blender, tmp_path, faces):
    result = bending_sheet()
    export.write(result, tmp_path / "x.usdc", faces=faces, colours="groups", scale=0.01)
    found = blender(tmp_path / "x.usdc")
    scene_size = 0.01  # metersPerUnit
    for k, time in enumerate(TIMES):
        np.testing.assert_allclose(found["points"][k], scene_size * upright(result, time), atol=1e-4)
        if time == int(time):
            camera = found["cameras"][k]
            seen = view(found["points"][k], camera[:3, :3], camera[:3, 3]) / scene_size
            image = result.project()[int(time)] / result.scales[int(time)]
            np.testing.assert_allclose(np.diff(seen[:, :2], axis=0), np.diff(image, axis=0) * [1, -1], atol=1e-2)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_frames_stand_upright(blender, tmp_path, kind):
    result = bending_sheet()
    export.write(result, tmp_path / "out", format=kind, faces=GRID, colours="groups")
    path = tmp_path / "out" / f"frame_0003.{kind}"
    found = blender(path, [0])
    np.testing.assert_allclose(found["points"][0], upright(result, 3), atol=1e-3)
    assert len(found["colours"]) == 1
