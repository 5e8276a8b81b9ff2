"""What each format means, and that nothing is lost on the way."""

import json
import logging

import h5py
import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.errors import FileError, InputError
from nrsfm.files import load_rotations, load_shapes, load_tracks, save_tracks
from nrsfm.tracks import Tracks

F, P = 5, 7


def numbers(shape, dtype=np.float64):
    return np.random.default_rng(1).standard_normal(shape).astype(dtype)


def write_matlab73(path, arrays):
    """HDF5 as MATLAB lays it out: 512 bytes before it, axes reversed, classes in attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            if scipy.sparse.issparse(array):
                array = array.tocsc()
                group = file.create_group(name)
                group.attrs["MATLAB_sparse"] = np.uint64(array.shape[0])
                group.attrs["MATLAB_class"] = np.bytes_("double")
                group["data"], group["ir"] = array.data, array.indices.astype(np.uint64)
                group["jc"] = array.indptr.astype(np.uint64)
                continue
            logical = array.dtype == bool
            data = file.create_dataset(name, data=array.T.astype(np.uint8) if logical else array.T)
            data.attrs["MATLAB_class"] = np.bytes_("logical" if logical else "double")
        file.create_dataset("#refs#/a", data=np.zeros(3))
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_hdf5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array


WRITERS = {
    "npz": lambda path, arrays: np.savez(path, **arrays),
    "compressed.npz": lambda path, arrays: np.savez_compressed(path, **arrays),
    "v5.mat": scipy.io.savemat,
    "v5-compressed.mat": lambda path, arrays: scipy.io.savemat(path, arrays, do_compression=True),
    "v7.3.mat": write_matlab73,
    "h5": write_hdf5,
    "hdf5": write_hdf5,
    "json": lambda path, arrays: path.write_text(json.dumps({k: v.tolist() for k, v in arrays.items()})),
}


@pytest.fixture(params=list(WRITERS))
def write(request, tmp_path):
    def writer(**arrays):
        path = tmp_path / f"file.{request.param}"
        WRITERS[request.param](path, arrays)
        return path

    return writer


# --- every format with names


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_matrix_of_the_paper(write, dtype):
    matrix = numbers((2 * F, P), dtype)
    tracks = load_tracks(write(W=matrix, S=numbers((3 * F, P)), R=np.zeros(3)))
    np.testing.assert_array_equal(tracks.measurement_matrix(), matrix)
    assert tracks.visible is None


@pytest.mark.parametrize("flags", ["visible", "visibility", "pred_visibility"])
def test_frame_first_tracks_with_visibility(write, flags):
    points, visible = numbers((F, P, 2)), numbers((F, P)) > 0
    tracks = load_tracks(write(tracks=points, **{flags: visible}))
    np.testing.assert_array_equal(tracks.points, points)
    np.testing.assert_array_equal(tracks.visible, visible)


def test_point_first_points_with_occlusion(write):
    points, occluded = numbers((P, F, 2)), numbers((P, F)) > 0
    tracks = load_tracks(write(points=points, occluded=occluded))
    np.testing.assert_array_equal(tracks.points, points.transpose(1, 0, 2))
    np.testing.assert_array_equal(tracks.visible, ~occluded.T)


def test_true_shapes_and_cameras_beside_the_tracks(write):
    shapes, valid = numbers((3 * F, P)), numbers((F, P)) > -1
    rotations = rotation_stack(F)
    path = write(W=numbers((2 * F, P)), S=shapes, S_valid=valid, R=rotations[:, :2].reshape(-1, 3))
    truth = load_shapes(path)
    for f in range(F):
        np.testing.assert_array_equal(truth.shapes[f].T, shapes[3 * f : 3 * f + 3])
    np.testing.assert_array_equal(truth.valid, valid)
    np.testing.assert_allclose(load_rotations(path), rotations, atol=1e-12)
    assert load_tracks(path).n_missing == 0


def test_shapes_by_frame(write):
    shapes = numbers((F, P, 3))
    np.testing.assert_array_equal(load_shapes(write(shapes=shapes)).shapes, shapes)


def test_a_file_without_the_expected_names_lists_those_found(write):
    path = write(foo=numbers((2 * F, P)), bar=np.zeros((2, 2)))
    for load, words in (
        (load_tracks, "tracks, pred_tracks, W or points"),
        (load_shapes, "S"),
        (load_rotations, "R"),
    ):
        with pytest.raises(FileError) as caught:
            load(path)
        text = str(caught.value)
        assert str(path) in text
        assert "foo (" in text
        assert "10×7" in text
        assert "bar (" in text
        assert words in text
        assert "\n" not in text


def test_any_name_and_order_can_be_stated(write):
    points = numbers((F, P, 2))
    path = write(foo=points, W=np.zeros((2, 2)))
    np.testing.assert_array_equal(load_tracks(path, name="foo", order="frame-first").points, points)
    swapped = load_tracks(path, name="foo", order="point-first").points
    np.testing.assert_array_equal(swapped, points.transpose(1, 0, 2))
    with pytest.raises(FileError, match=r"order of axes of foo .*ambiguous.*frame-first.*point-first"):
        load_tracks(path, name="foo")
    with pytest.raises(FileError, match="no array 'fo'; did you mean 'foo'"):
        load_tracks(path, name="fo")


def test_odd_rows_nan_and_complex_are_refused_with_the_file_named(write):
    with pytest.raises(FileError, match=r"file\..*W: an even number of rows is needed, received 5"):
        load_tracks(write(W=numbers((5, P))))
    matrix = numbers((2 * F, P))
    matrix[3, 2] = np.nan
    with pytest.raises(FileError, match=r"file\..*1 that are NaN .*frame 1, point 2"):
        load_tracks(write(W=matrix))


# --- what only some formats or trackers do


def test_a_batch_axis_of_one_is_dropped_and_of_more_refused(tmp_path):
    points, visible = numbers((1, F, P, 2)), numbers((1, F, P)) > 0
    np.savez(tmp_path / "a.npz", pred_tracks=points, pred_visibility=visible[..., None])
    tracks = load_tracks(tmp_path / "a.npz")
    np.testing.assert_array_equal(tracks.points, points[0])
    np.testing.assert_array_equal(tracks.visible, visible[0])
    np.savez(tmp_path / "a.npz", tracks=np.repeat(points, 2, axis=0))
    with pytest.raises(FileError, match="one sequence is needed, received a batch of 2"):
        load_tracks(tmp_path / "a.npz")


def test_ambiguous_orders_are_refused_and_the_error_says_what_to_state(tmp_path):
    points, flags = numbers((F, F, 2)), np.ones((F, F), bool)
    for arrays in (
        {"points": points},
        {"tracks": points, "visibles": flags},
        {"tracks": points, "occluded": flags},
    ):
        np.savez(tmp_path / "a.npz", **arrays)
        with pytest.raises(FileError, match=r"ambiguous: state it .order= or --order.: frame-first for"):
            load_tracks(tmp_path / "a.npz")
        stated = load_tracks(tmp_path / "a.npz", order="point-first")
        np.testing.assert_array_equal(stated.points, points.transpose(1, 0, 2))
    np.savez(tmp_path / "a.npz", points=points, visible=flags)
    np.testing.assert_array_equal(load_tracks(tmp_path / "a.npz").points, points)


def test_npy_holds_the_matrix_or_needs_an_order(tmp_path):
    path = tmp_path / "a.npy"
    matrix, points = numbers((2 * F, P)), numbers((F, P, 2))
    np.save(path, matrix)
    loaded = load_tracks(path)
    np.testing.assert_array_equal(loaded.measurement_matrix(), matrix)
    np.save(path, points)
    with pytest.raises(FileError, match=r"without a name with shape \(5, 7, 2\) is ambiguous"):
        load_tracks(path)
    np.testing.assert_array_equal(load_tracks(path, order="frame-first").points, points)
    np.save(path, points[None])
    np.testing.assert_array_equal(load_tracks(path).points, points)
    np.save(path, numbers((3 * F, P)))
    assert load_shapes(path).shapes.shape == (F, P, 3)


def test_npy_tracks_stay_on_disk(tmp_path):
    np.save(tmp_path / "a.npy", numbers((2 * F, P)))
    base = load_tracks(tmp_path / "a.npy").points
    while base is not None and not isinstance(base, np.memmap):
        base = base.base
    assert base is not None


def test_two_candidates_must_be_told_apart(tmp_path):
    np.savez(tmp_path / "a.npz", W=numbers((2 * F, P)), tracks=numbers((F, P, 2)))
    with pytest.raises(FileError, match="tracks and W could all be the tracks: say which"):
        load_tracks(tmp_path / "a.npz")
    assert load_tracks(tmp_path / "a.npz", name="W").n_frames == F


@pytest.mark.parametrize("flags", [np.full((F, P), 0.5), np.full((F, P), 2), np.full((F, P), "yes")])
def test_flags_must_be_true_or_false(tmp_path, flags):
    np.savez(tmp_path / "a.npz", tracks=numbers((F, P, 2)), visible=flags)
    with pytest.raises(FileError, match="visible: true and false, or 1 and 0"):
        load_tracks(tmp_path / "a.npz")


def test_flags_of_another_size_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", tracks=numbers((F, P, 2)), visible=np.ones((P, F), bool))
    with pytest.raises(FileError, match=r"visible: shape \(5, 7\) is needed"):
        load_tracks(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", points=numbers((P, F, 2)), occluded=np.ones((P, F), bool), visible=np.ones((P, F)))
    with pytest.raises(FileError, match="one array of flags"):
        load_tracks(tmp_path / "a.npz")


def test_coordinates_relative_to_the_image_are_scaled_on_request_and_noticed(tmp_path, caplog):
    points = np.random.default_rng(0).random((P, F, 2))
    np.savez(tmp_path / "a.npz", points=points, occluded=np.zeros((P, F), bool))
    with caplog.at_level(logging.WARNING):
        load_tracks(tmp_path / "a.npz")
    assert "if relative to the image, give its size" in caplog.text
    tracks = load_tracks(tmp_path / "a.npz", image_size=(640, 480))
    np.testing.assert_allclose(tracks.points, points.transpose(1, 0, 2) * [640, 480])
    for bad in ((0, 1), (1,), "ab", (np.nan, 1)):
        with pytest.raises((InputError, FileError), match="image_size"):
            load_tracks(tmp_path / "a.npz", image_size=bad)


def test_an_unknown_order_suggests_the_nearest():
    with pytest.raises(InputError, match="received 'frames-first'; did you mean 'frame-first'"):
        load_tracks("anything.npz", order="frames-first")


def test_whole_numbers_of_matlab_are_numbers(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"W": np.arange(2 * F * P, dtype=np.uint8).reshape(2 * F, P)})
    assert load_tracks(tmp_path / "a.mat").points.dtype == np.float64


def test_hdf5_groups_are_reached_by_path(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["run/tracks"] = numbers((F, P, 2))
    with pytest.raises(FileError, match=r"found run/tracks \(float64 5×7×2\)"):
        load_tracks(tmp_path / "a.h5")
    assert load_tracks(tmp_path / "a.h5", name="run/tracks", order="frame-first").n_points == P


# --- text


def test_long_form_with_absent_rows_and_flags(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# tracks\nframe,point,x,y,visible\n1,1,10,20,1\n1,2,nan,nan,0\n2,2,30,40.5,1\n")
    tracks = load_tracks(path)
    np.testing.assert_array_equal(tracks.visible, [[True, False], [False, True]])
    np.testing.assert_array_equal(tracks.points[0, 0], [10, 20])
    np.testing.assert_array_equal(tracks.points[1, 1], [30, 40.5])


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "  "])
@pytest.mark.parametrize("extension", ["csv", "txt", "tsv"])
def test_wide_form_in_any_delimiter(tmp_path, delimiter, extension):
    matrix = numbers((2 * F, P))
    path = tmp_path / f"a.{extension}"
    np.savetxt(path, matrix, delimiter=delimiter, fmt="%.17g")
    np.testing.assert_array_equal(load_tracks(path).measurement_matrix(), matrix)


def test_columns_may_come_in_any_order_with_others_between(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Y, Frame, score, X, Point\n1,0,0.5,2,0\n3,0,0.5,4,1\n")
    np.testing.assert_array_equal(load_tracks(path).points, [[[2, 1], [4, 3]]])


def test_long_form_of_shapes(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("frame,point,x,y,z\n0,0,1,2,3\n0,1,4,5,6\n1,1,7,8,9\n")
    truth = load_shapes(path)
    np.testing.assert_array_equal(truth.valid, [[True, True], [False, True]])
    np.testing.assert_array_equal(truth.shapes[1, 1], [7, 8, 9])
    with pytest.raises(FileError, match="found shapes"):
        load_tracks(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,point,x\n0,0,1\n", "y missing, found frame, point, x"),
        ("frame,point,x,y\n", "holds no numbers"),
        ("# nothing\n\n", "holds no numbers"),
        ("frame,point,x,y\n0,0,1,2\n0,0,1,2\n", "several of frame 0, point 0"),
        ("frame,point,x,y\n0,0,1,2\n2,0,1,2\n", "frame 1 is missing"),
        ("frame,point,x,y\n0,7,1,2\n", "the first is 7"),
        ("frame,point,x,y\n0,0.5,1,2\n", "point must be a whole number from 0, received 0.5 in row 1"),
        ("frame,point,x,y\n-1,0,1,2\n", "frame must be a whole number from 0, received -1"),
        ("frame,point,x,y\n0,0,1\n", "as|number|column"),
        ("frame,point,x,y,visible\n0,0,1,2,0.5\n", "visible must be 0 or 1, received 0.5 in row 1"),
        ("frame,point,x,y\n0,0,1,inf\n", "1 that are NaN or infinite"),
        ("1,2\n3\n", "column"),
        ("1,2\n3,apple\n", "apple"),
        ("1,2\n3,4\n5,6\n", "even number of rows"),
        ("\0\0\0", "not a text file"),
    ],
)
def test_text_that_breaks_a_rule(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        load_tracks(path)
    assert "\n" not in str(caught.value)


def test_a_text_whose_numbering_would_fill_the_memory(tmp_path):
    path = tmp_path / "a.csv"
    rows = np.column_stack([np.arange(20_000), np.arange(20_000), np.zeros((20_000, 2))])
    np.savetxt(path, rows, fmt="%d", delimiter=",", header="frame,point,x,y", comments="")
    with pytest.raises(FileError, match="20000 rows for 20000 frames of 20000 points"):
        load_tracks(path)


# --- shapes


def test_nan_without_a_mask_means_not_known_and_is_said(tmp_path, caplog):
    shapes = numbers((F, P, 3))
    shapes[2, 3, 1] = np.nan
    np.savez(tmp_path / "a.npz", shapes=shapes)
    with caplog.at_level(logging.WARNING):
        truth = load_shapes(tmp_path / "a.npz")
    assert "1 of 35 true points are NaN" in caplog.text
    assert not truth.valid[2, 3]
    assert truth.valid.sum() == F * P - 1
    np.savez(tmp_path / "a.npz", shapes=shapes, valid=np.ones((F, P), bool))
    with pytest.raises(FileError, match="1 points that are not, the first at frame 2, point 3"):
        load_shapes(tmp_path / "a.npz")
    shapes[2, 3, 1] = np.inf
    np.savez(tmp_path / "a.npz", shapes=shapes)
    with pytest.raises(FileError, match="infinite, received one in frame 2"):
        load_shapes(tmp_path / "a.npz")


def test_shapes_point_first(tmp_path):
    shapes = numbers((P, F, 3), np.float32)
    np.savez(tmp_path / "a.npz", foo=shapes, valid=np.ones((P, F), bool))
    truth = load_shapes(tmp_path / "a.npz", name="foo", order="point-first")
    np.testing.assert_array_equal(truth.shapes, shapes.transpose(1, 0, 2))
    assert truth.valid.shape == (F, P)


# --- cameras


def rotation_stack(count, seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((count, 3, 3)))
    return q * np.linalg.det(q)[:, None, None]


def test_block_diagonal_cameras_of_the_dense_benchmark_dense_or_sparse(tmp_path):
    rotations = rotation_stack(F)
    full = scipy.sparse.block_diag(rotations)
    for path, value in (
        ("dense.mat", full.toarray()),
        ("sparse.mat", full.tocsc()),
    ):
        scipy.io.savemat(tmp_path / path, {"R_GT": value})
        np.testing.assert_allclose(load_rotations(tmp_path / path), rotations, atol=1e-15)
    write_matlab73(tmp_path / "new.mat", {"R_GT": full})
    np.testing.assert_allclose(load_rotations(tmp_path / "new.mat"), rotations, atol=1e-15)


# --- saving


@pytest.mark.parametrize("extension", ["npz", "h5", "hdf5", "csv", "NPZ"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("holes", [False, True])
def test_saved_tracks_come_back_bit_by_bit(tmp_path, extension, dtype, holes):
    points = numbers((F, P, 2), dtype) * dtype(1e3)
    visible = None
    if holes:
        visible = np.arange(F * P).reshape(F, P) % 3 > 0
        points[~visible] = np.nan
    path = tmp_path / f"a.{extension}"
    save_tracks(Tracks(points, visible), path)
    again = load_tracks(path)
    np.testing.assert_array_equal(again.points.astype(dtype), points)
    assert again.points.dtype == (np.float64 if extension == "csv" else dtype)
    if holes:
        np.testing.assert_array_equal(again.visible, visible)
    else:
        assert again.complete
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_saving_refuses_other_names_and_existing_files(tmp_path):
    tracks = Tracks(numbers((F, P, 2)))
    for name in ("a.npy", "a", "a.mat"):
        with pytest.raises(FileError, match=r"must end in \.npz, \.h5, \.hdf5, \.csv"):
            save_tracks(tracks, tmp_path / name)
    (tmp_path / "a.npz").write_text("mine")
    with pytest.raises(FileError, match="it exists"):
        save_tracks(tracks, tmp_path / "a.npz", overwrite=False)
    assert (tmp_path / "a.npz").read_text() == "mine"
    with pytest.raises(InputError, match="a Tracks object is needed, received ndarray"):
        save_tracks(numbers((F, P, 2)), tmp_path / "b.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


@given(
    points=hnp.arrays(
        st.sampled_from([np.float32, np.float64]),
        st.tuples(st.integers(1, 4), st.integers(1, 4), st.just(2)),
        elements={"allow_nan": False, "allow_infinity": False},
    ),
    extension=st.sampled_from(["npz", "h5", "csv"]),
)
def test_any_numbers_survive_any_format(tmp_path_factory, points, extension):
    path = tmp_path_factory.mktemp("any") / f"a.{extension}"
    save_tracks(Tracks(points), path)
    np.testing.assert_array_equal(load_tracks(path).points.astype(points.dtype), points)


def test_errors_call_the_array_as_the_file_does(tmp_path):
    np.savez(tmp_path / "a.npz", tracks=np.zeros((5, 4, 3)))
    with pytest.raises(FileError, match=r": tracks: shape \(frames, points, 2\) is needed, received \(5, 4, 3\)"):
        load_tracks(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", W=np.full((6, 4), np.nan))
    with pytest.raises(FileError, match=r": W: every visible coordinate must be finite, received 24"):
        load_tracks(tmp_path / "b.npz")


@pytest.mark.parametrize("text", ['"words"', "[[1, 2], [3]]", "[1, 2]"])
def test_a_shape_that_fits_no_order_is_not_called_ambiguous(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(FileError, match=r"real numbers of shape .* are needed, received dtype"):
        load_tracks(tmp_path / "a.json")


def test_rows_of_different_length_are_named_without_options_of_numpy(tmp_path):
    (tmp_path / "a.csv").write_text("1,2,3\n4,5\n")
    with pytest.raises(FileError, match=r"columns changed from 3 to 2 at row 2$"):
        load_tracks(tmp_path / "a.csv")
