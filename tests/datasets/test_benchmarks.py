"""Files laid out as the owners of the dense benchmark publish them, made here."""

import logging

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg

from nrsfm.datasets import KINECT_WINDOWS, Window, crop_to_window, load_benchmark_mat
from nrsfm.errors import FileError, InputError

F, P = 6, 40


@pytest.fixture
def parts():
    generator = np.random.default_rng(5)
    q, _ = np.linalg.qr(generator.standard_normal((F, 3, 3)))
    rotations = q * np.linalg.det(q)[:, None, None]
    shapes = generator.standard_normal((F, P, 3))
    matrix = np.concatenate([r[:2] @ s.T for r, s in zip(rotations, shapes, strict=True)])
    stacked = np.concatenate([s.T for s in shapes])
    return {"W": matrix, "S": stacked, "R_GT": scipy.linalg.block_diag(*rotations)}, shapes, rotations


def write_new(path, arrays):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array.T).attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("write", [scipy.io.savemat, write_new])
def test_a_face_file(tmp_path, parts, write):
    arrays, shapes, rotations = parts
    write(tmp_path / "face3.mat", arrays)
    sequence = load_benchmark_mat(tmp_path / "face3.mat")
    assert sequence.name == "face3"
    np.testing.assert_array_equal(sequence.tracks.measurement_matrix(), arrays["W"])
    np.testing.assert_array_equal(sequence.shapes, shapes)
    np.testing.assert_allclose(sequence.rotations, rotations, atol=1e-12)
    assert sequence.note["mismatch"] < 1e-12
    assert load_benchmark_mat(tmp_path / "face3.mat", dtype=np.float32).shapes.dtype == np.float32


def test_shapes_with_cameras_and_no_tracks_are_projected(tmp_path, parts):
    arrays, *_ = parts
    scipy.io.savemat(tmp_path / "actor.mat", {"S": arrays["S"], "R_GT": arrays["R_GT"]})
    sequence = load_benchmark_mat(tmp_path / "actor.mat")
    np.testing.assert_allclose(sequence.tracks.measurement_matrix(), arrays["W"], atol=1e-12)
    assert "made from S" in sequence.note["camera"]


def test_tracks_alone(tmp_path, parts):
    scipy.io.savemat(tmp_path / "a.mat", {"W": parts[0]["W"]})
    sequence = load_benchmark_mat(tmp_path / "a.mat")
    assert sequence.shapes is None
    assert sequence.rotations is None


def test_arrays_that_do_not_belong_together_are_noticed(tmp_path, parts, caplog):
    arrays, *_ = parts
    scipy.io.savemat(tmp_path / "a.mat", {**arrays, "S": arrays["S"][:, ::-1]})
    with caplog.at_level(logging.WARNING):
        assert load_benchmark_mat(tmp_path / "a.mat").note["mismatch"] > 0.1
    assert "W differs from R S" in caplog.text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"S": np.zeros((3 * F, P + 1))}, "W has 6 frames of 40 points, S has 6 of 41"),
        ({"R_GT": np.eye(3 * F - 3)}, "W has 6 frames, the cameras have 5"),
        ({"R_GT": np.zeros((3 * F, 3 * F))}, "orthonormal"),
        ({"W": np.zeros((5, P))}, "even number of rows"),
    ],
)
def test_arrays_of_different_sequences_are_refused(tmp_path, parts, change, words):
    scipy.io.savemat(tmp_path / "a.mat", {**parts[0], **change})
    with pytest.raises(FileError, match=words):
        load_benchmark_mat(tmp_path / "a.mat")


def test_a_file_with_neither_lists_what_it_has(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"S": np.zeros((9, 4)), "other": np.zeros(3)})
    with pytest.raises(FileError, match=r"W, or S and R_GT, are needed; found S .double 9×4., other"):
        load_benchmark_mat(tmp_path / "a.mat")


def test_windows_keep_the_points_of_the_first_frame(tmp_path, parts, caplog):
    arrays, shapes, _ = parts
    scipy.io.savemat(tmp_path / "a.mat", arrays)
    first = arrays["W"][:2].T
    inside = (first[:, 0] >= -0.5) & (first[:, 0] <= 1) & (first[:, 1] >= -1) & (first[:, 1] <= 1)
    with caplog.at_level(logging.WARNING):
        cut = load_benchmark_mat(tmp_path / "a.mat", window=Window((-0.5, 1), (-1, 1), frames=9))
    assert "9 frames belong to the window, 6 found" in caplog.text
    np.testing.assert_array_equal(cut.tracks.points[0], first[inside])
    np.testing.assert_array_equal(cut.shapes, shapes[:, inside])


def test_windows_by_name(tmp_path):
    columns, rows = np.meshgrid(np.arange(0, 640), np.arange(0, 480))
    first = np.stack([columns.ravel(), rows.ravel()])
    scipy.io.savemat(tmp_path / "a.mat", {"W": np.concatenate([first, first + 1, first + 2]).astype(np.float32)})
    sequence = load_benchmark_mat(tmp_path / "a.mat", window="kinect-paper")
    assert sequence.tracks.n_points == (508 - 253 + 1) * (363 - 132 + 1)
    assert KINECT_WINDOWS["kinect-tshirt"].frames == 313
    with pytest.raises(InputError, match="did you mean 'kinect-paper'"):
        crop_to_window(sequence, "kinect_paper")
    with pytest.raises(InputError, match="holds no point; the first frame spans x 253 to 508"):
        crop_to_window(sequence, Window((0, 9), (0, 9)))
