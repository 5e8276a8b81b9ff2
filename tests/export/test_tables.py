import csv
import json

import numpy as np
import pytest

import nrsfm.export as export

from .conftest import COLUMNS, ROWS, bending_sheet, view
from .test_ply_obj import upright


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_long_table(tmp_path, dtype):
    result = bending_sheet(holes=True, dtype=dtype)
    export.write(result, tmp_path / "t.csv", fps=10)
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    kept = np.flatnonzero(result.reconstructed)
    assert list(rows[0]) == ["frame", "time", "point", "x", "y", "z", "group", "confidence", "depth_deviation"]
    assert len(rows) == 7 * 46
    numbers = np.array([[float(row[name]) for name in row] for row in rows]).reshape(7, 46, -1)
    np.testing.assert_array_equal(numbers[:, 0, 0], np.arange(7))
    np.testing.assert_allclose(numbers[:, 0, 1], np.arange(7) / 10)
    for f in range(7):
        np.testing.assert_array_equal(numbers[f, :, 2], kept)
        expected = upright(result, f)[kept]
        np.testing.assert_allclose(numbers[f, :, 3:6], expected, rtol=1e-6 if dtype == np.float32 else 1e-12, atol=1e-6)
        np.testing.assert_array_equal(numbers[f, :, 6], result.groups[kept])
        np.testing.assert_allclose(numbers[f, :, 7], result.confidence[f, kept], rtol=1e-7)
        np.testing.assert_allclose(numbers[f, :, 8], result.depth_deviation[f, kept], rtol=1e-7)


def test_wide_table(holed, tmp_path):
    export.write(holed, tmp_path / "t.csv", layout="wide", axes="opencv")
    with (tmp_path / "t.csv").open() as stream:
        header = stream.readline().strip().split(",")
        numbers = np.loadtxt(stream, delimiter=",")
    assert header[:5] == ["frame", "time", "x1", "y1", "z1"]  # point 0 was not reconstructed
    assert numbers.shape == (7, 2 + 3 * 46)
    kept = np.flatnonzero(holed.reconstructed)
    np.testing.assert_allclose(numbers[5, 2:].reshape(-1, 3), upright(holed, 5)[kept] * [1, -1, -1], atol=1e-4)


def test_arrays_by_name(holed, tmp_path):
    export.write(holed, tmp_path / "t.npz", faces=f"grid:{ROWS}x{COLUMNS}", colours="confidence", reference=3)
    with np.load(tmp_path / "t.npz", allow_pickle=False) as arrays:
        found = dict(arrays)
    kept = np.flatnonzero(holed.reconstructed)
    assert found["points"].dtype == np.float32
    np.testing.assert_array_equal(found["numbers"], kept)
    np.testing.assert_array_equal(found["groups"], holed.groups[kept])
    np.testing.assert_array_equal(found["confidence"], holed.confidence[:, kept])
    assert found["colours"].shape == (46, 3)
    assert found["faces"].max() < 46
    assert json.loads(str(found["about"]))["reference_frame"] == 3
    image = holed.project()[:, kept]
    for f in range(7):
        np.testing.assert_allclose(found["points"][f], upright(holed, f, 3)[kept], atol=1e-4)
        seen = view(found["points"][f], found["camera_orientations"][f], found["camera_positions"][f])
        size = found["view_size"][f]
        # Parts of the view, from its middle: the same in the world and in the image.
        parts = (seen[:, :2] * [1, -1] / size)[1:] - (seen[:, :2] * [1, -1] / size)[0]
        pixels = image[f, 1:] - image[f, 0]
        np.testing.assert_allclose(parts * size[0] * holed.scales[f] * [1, size[1] / size[0]], pixels, atol=1e-3)


def test_a_still_camera_is_the_same_in_every_frame(result, tmp_path):
    export.write(result, tmp_path / "t.npz", frame="camera")
    with np.load(tmp_path / "t.npz") as found:
        for name in ("camera_orientations", "camera_positions", "view_size"):
            assert (found[name] == found[name][0]).all()
