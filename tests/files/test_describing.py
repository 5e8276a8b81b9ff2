import json

import numpy as np
import pytest

from nrsfm.errors import FileError
from nrsfm.files import describe, load_shapes
from nrsfm.reconstruction import Reconstruction


def numbers(shape):
    return np.random.default_rng(2).standard_normal(shape)


def test_tracks_with_truth(tmp_path):
    points, visible = numbers((5, 7, 2)), np.ones((5, 7), bool)
    points[1, 2], visible[1, 2] = np.nan, False
    np.savez(tmp_path / "a.npz", tracks=points, visible=visible, S=numbers((15, 7)), name=np.array("x"))
    found = describe(tmp_path / "a.npz")
    assert json.loads(json.dumps(found)) == found
    assert (found["kind"], found["format"], found["holds"]) == ("tracks", "npz", ["tracks", "shapes"])
    assert (found["frames"], found["points"], found["missing"]) == (5, 7, 1)
    assert found["missing_share"] == pytest.approx(1 / 35)
    assert found["range"]["y"] == [np.nanmin(points[..., 1]), np.nanmax(points[..., 1])]
    assert {"name": "S", "shape": [15, 7], "dtype": "float64"} in found["arrays"]
    assert found["problem"] is None
    assert found["bytes"] == (tmp_path / "a.npz").stat().st_size


def test_a_reconstruction(tmp_path):
    path = tmp_path / "reconstruction.npz"
    shapes = numbers((5, 7, 3))
    Reconstruction(shapes, np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 2)), np.ones(5)).save(path)
    found = describe(path)
    assert (found["kind"], found["frames"], found["points"]) == ("reconstruction", 5, 7)
    assert found["range"]["z"] == [shapes[..., 2].min(), shapes[..., 2].max()]


def test_a_reconstruction_of_real_tracks(tmp_path):
    path = tmp_path / "reconstruction.npz"
    shapes, confidence, deviation = numbers((5, 7, 3)), np.ones((5, 7)), np.full((5, 7), 0.5)
    shapes[:, 6], confidence[:, 6], deviation[:, 6], confidence[1, 2] = np.nan, 0, np.nan, 0
    cameras = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 2)), np.ones(5)
    groups = np.array([0, 0, 1, 1, 1, 1, -1])
    Reconstruction(
        shapes, *cameras, groups, {"iterations": 3}, "auto", {"k": 1}, confidence=confidence, depth_deviation=deviation
    ).save(path)
    found = describe(path)
    assert json.loads(json.dumps(found)) == found
    assert (found["kind"], found["points"], found["not_reconstructed"], found["missing"]) == ("reconstruction", 7, 1, 6)
    assert found["missing_share"] == pytest.approx(6 / 35)
    assert found["range"]["x"] == [np.nanmin(shapes[..., 0]), np.nanmax(shapes[..., 0])]
    assert found["depth_deviation"] == {"median": 0.5, "percentile_95": 0.5}
    assert (found["method"], found["groups"], found["options"]) == ("auto", 2, {"k": 1})
    assert found["diagnostics"] == {"iterations": 3}


def test_a_reconstruction_is_true_shapes_for_others(tmp_path):
    shapes = numbers((5, 7, 3))
    shapes[:, 6] = np.nan
    Reconstruction(shapes, np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 2)), np.ones(5)).save(tmp_path / "r.npz")
    truth = load_shapes(tmp_path / "r.npz")
    np.testing.assert_array_equal(truth.valid, np.isfinite(shapes[..., 0]))


def test_shapes_cameras_and_the_unknown(tmp_path):
    np.savez(tmp_path / "s.npz", shapes=numbers((5, 7, 3)))
    assert describe(tmp_path / "s.npz")["kind"] == "shapes"
    np.savez(tmp_path / "c.npz", R=np.tile(np.eye(3), (4, 1, 1)))
    found = describe(tmp_path / "c.npz")
    assert (found["kind"], found["frames"]) == ("cameras", 4)
    np.savez(tmp_path / "u.npz", foo=numbers(3))
    found = describe(tmp_path / "u.npz")
    assert found["kind"] == "unknown"
    assert "foo (float64 3)" in found["problem"]


def test_an_order_can_be_stated(tmp_path):
    np.save(tmp_path / "a.npy", numbers((5, 7, 2)))
    found = describe(tmp_path / "a.npy")
    assert found["kind"] == "unknown"
    assert "ambiguous" in found["problem"]
    assert describe(tmp_path / "a.npy", order="point-first")["frames"] == 7


def test_what_cannot_be_read_is_an_error(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04broken")
    with pytest.raises(FileError, match=r"not a valid \.npz file, or it is truncated"):
        describe(tmp_path / "a.npz")
