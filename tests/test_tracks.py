import pickle

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm import tracks as module
from nrsfm.errors import InputError, NrsfmError
from nrsfm.tracks import Tracks, shapes_from_matrix, shapes_to_matrix

SIZES = st.tuples(st.integers(1, 6), st.integers(1, 7))


def numbers(shape, dtype=np.float64):
    return np.random.default_rng(0).standard_normal(shape).astype(dtype)


def layouts(array):
    """The same values in other memory layouts."""
    padded = np.empty((*array.shape[:-1], array.shape[-1] + 1), dtype=array.dtype)
    padded[..., :-1] = array
    return [
        np.ascontiguousarray(array),
        np.asfortranarray(array),
        padded[..., :-1],
        array[::-1, ::-1][::-1, ::-1],
    ]


# --- laws


@given(size=SIZES, dtype=st.sampled_from([np.float32, np.float64]), layout=st.integers(0, 3))
def test_floats_of_any_layout_are_kept_without_a_copy(size, dtype, layout):
    points = layouts(numbers((*size, 2), dtype))[layout]
    points.flags.writeable = False
    tracks = Tracks(points)
    assert np.shares_memory(tracks.points, points)
    assert tracks.points.dtype == dtype
    np.testing.assert_array_equal(tracks.points, points)
    assert (tracks.n_frames, tracks.n_points, tracks.n_missing) == (*size, 0)


@given(size=SIZES, dtype=st.sampled_from([np.float32, np.float64]), layout=st.integers(0, 3))
def test_measurement_matrix_there_and_back_is_the_identity_and_a_view(size, dtype, layout):
    frames, count = size
    matrix = layouts(numbers((2 * frames, count), dtype))[layout]
    tracks = Tracks.from_measurement_matrix(matrix)
    assert np.shares_memory(tracks.points, matrix)
    np.testing.assert_array_equal(tracks.measurement_matrix(), matrix)
    for f in range(frames):
        np.testing.assert_array_equal(tracks.points[f, :, 0], matrix[2 * f])
        np.testing.assert_array_equal(tracks.points[f, :, 1], matrix[2 * f + 1])


@given(size=SIZES, layout=st.integers(0, 3))
def test_shape_matrix_there_and_back_is_the_identity(size, layout):
    frames, count = size
    matrix = layouts(numbers((3 * frames, count)))[layout]
    shapes = shapes_from_matrix(matrix)
    assert shapes.shape == (frames, count, 3)
    np.testing.assert_array_equal(shapes[-1, :, 2], matrix[-1])
    np.testing.assert_array_equal(shapes_to_matrix(shapes), matrix)


@given(size=SIZES, data=st.data())
def test_point_first_is_the_transpose_with_flags_negated(size, data):
    points = numbers((*size, 2))
    occluded = data.draw(hnp.arrays(bool, size))
    tracks = Tracks.from_point_first(points, occluded)
    assert np.shares_memory(tracks.points, points)
    np.testing.assert_array_equal(tracks.points, points.transpose(1, 0, 2))
    np.testing.assert_array_equal(tracks.visible, ~occluded.T)
    assert tracks.n_missing == occluded.sum()


@given(size=SIZES, data=st.data(), value=st.sampled_from([np.nan, np.inf, -np.inf]), point_first=st.booleans())
def test_what_is_not_finite_is_allowed_exactly_where_not_visible(size, data, value, point_first):
    frames, count = size
    points = numbers((count, frames, 2)).transpose(1, 0, 2) if point_first else numbers((*size, 2))
    visible = data.draw(hnp.arrays(bool, size))
    holes = data.draw(hnp.arrays(bool, (*size, 2)))
    points[holes] = value
    wrong = holes & visible[:, :, None]
    if not wrong.any():
        assert Tracks(points, visible).n_missing == np.count_nonzero(~visible)
        return
    with pytest.raises(InputError) as caught:
        Tracks(points, visible)
    frame, point = np.argwhere(wrong.any(axis=2))[0]
    assert f"received {wrong.sum()} that" in str(caught.value)
    assert f"frame {frame}, point {point}:" in str(caught.value)


BAD_DTYPES = [np.complex64, np.complex128, bool, object, "U3", "S3", "datetime64[s]"]


@given(
    points=st.one_of(
        hnp.arrays(
            st.sampled_from([np.float16, np.float32, np.float64, np.int8, np.uint64, *map(np.dtype, BAD_DTYPES)]),
            hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
        ),
        st.none(),
        st.text(max_size=5),
        st.lists(st.lists(st.floats() | st.integers(), max_size=3), max_size=3),
    ),
    visible=st.one_of(
        st.none(),
        st.none(),
        hnp.arrays(st.sampled_from([bool, np.int8, np.float64]), hnp.array_shapes(max_dims=3, max_side=4)),
    ),
)
def test_any_input_is_tracks_or_an_error_of_one_line(points, visible):
    try:
        tracks = Tracks(points, visible)
    except InputError as error:
        text = str(error)
        assert "\n" not in text
        assert "received" in text
        return
    assert tracks.points.ndim == 3
    assert tracks.points.shape[2] == 2
    assert tracks.points.size
    assert tracks.points.dtype in (np.float32, np.float64)
    seen = np.ones(tracks.points.shape[:2], bool) if tracks.visible is None else tracks.visible
    assert np.isfinite(tracks.points[seen]).all()


# --- cases


@pytest.mark.parametrize("dtype", BAD_DTYPES)
def test_types_that_are_not_real_numbers_are_refused(dtype):
    with pytest.raises(InputError, match=f"dtype {np.dtype(dtype)}".replace("[", r"\[")):
        Tracks(np.zeros((3, 4, 2), dtype=dtype))


@pytest.mark.parametrize("dtype", [np.float16, np.int32, np.uint8, ">f8", ">f4", np.longdouble])
def test_other_real_types_become_float64(dtype):
    tracks = Tracks(np.arange(24).reshape(3, 4, 2).astype(dtype))
    assert tracks.points.dtype == np.float64
    np.testing.assert_array_equal(tracks.points.ravel(), np.arange(24))


@pytest.mark.parametrize("shape", [(), (4,), (4, 2), (3, 4, 3), (1, 3, 4, 2), (2, 3, 4)])
def test_other_shapes_are_refused_with_the_shape_received(shape):
    with pytest.raises(InputError) as caught:
        Tracks(np.zeros(shape))
    assert f"(frames, points, 2) is needed, received {shape}" in str(caught.value)


@pytest.mark.parametrize("shape", [(0, 4, 2), (3, 0, 2), (0, 0, 2)])
def test_nothing_is_refused(shape):
    with pytest.raises(InputError, match="at least one frame and one point"):
        Tracks(np.zeros(shape))


def test_lists_are_taken_and_ragged_lists_refused():
    assert Tracks([[[1, 2]], [[3, 4]]]).points.dtype == np.float64
    with pytest.raises(InputError, match="points: an array is needed, received list"):
        Tracks([[[1, 2]], [[3, 4], [5, 6]]])


def test_a_masked_array_is_refused_because_its_mask_would_be_lost():
    with pytest.raises(InputError, match="masked array"):
        Tracks(np.ma.masked_array(np.zeros((3, 4, 2)), mask=True))


@pytest.mark.parametrize(
    ("visible", "words"),
    [(np.ones((3, 4)), "dtype float64"), (np.ones((4, 3), bool), r"received \(4, 3\)"), ("yes", "dtype <U3")],
)
def test_visibility_of_another_type_or_shape_is_refused(visible, words):
    with pytest.raises(InputError, match=f"visible: .*{words}"):
        Tracks(np.zeros((3, 4, 2)), visible)


def test_a_memory_map_stays_on_disk(tmp_path):
    np.save(tmp_path / "points.npy", numbers((3, 4, 2)))
    mapped = np.load(tmp_path / "points.npy", mmap_mode="r")
    assert np.shares_memory(Tracks(mapped).points, mapped)


def test_tracks_cannot_be_changed():
    points = numbers((3, 4, 2))
    tracks = Tracks(points, np.ones((3, 4), bool))
    with pytest.raises(ValueError, match="read-only"):
        tracks.points[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        tracks.visible[0] = False
    with pytest.raises(AttributeError):
        tracks.points = points
    points[0] = 0  # the caller's own array stays as it was


def test_the_first_bad_point_is_found_across_chunks_in_both_orders(monkeypatch):
    monkeypatch.setattr(module, "_CHUNK", 8)
    for points in (numbers((7, 5, 2)), numbers((5, 7, 2)).transpose(1, 0, 2), numbers((2, 5, 7)).T):
        points[2, 4, 1] = points[5, 0, 0] = points[5, 0, 1] = np.nan
        with pytest.raises(InputError, match=r"received 3 .* in 2 of 35 entries, the first at frame 2, point 4"):
            Tracks(points)


def test_the_check_makes_no_copy_of_large_tracks():
    import tracemalloc

    points = np.zeros((4, 1_000_000, 2), dtype=np.float32)
    tracemalloc.start()
    Tracks(points)
    Tracks(points.transpose(1, 0, 2))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < points.nbytes / 4


def test_an_odd_number_of_rows_is_refused():
    with pytest.raises(InputError, match=r"W: an even number of rows is needed, received 5 rows \(shape \(5, 4\)\)"):
        Tracks.from_measurement_matrix(np.zeros((5, 4)))
    with pytest.raises(InputError, match="S: a number of rows that is a multiple of 3 is needed, received 4"):
        shapes_from_matrix(np.zeros((4, 4)))


@pytest.mark.parametrize("bad", [np.zeros((3, 4, 2)), np.zeros((0, 4)), np.zeros((4, 4), complex), "W"])
def test_what_is_not_a_matrix_is_refused(bad):
    with pytest.raises(InputError, match=r"^W: "):
        Tracks.from_measurement_matrix(bad)
    with pytest.raises(InputError, match=r"^S: "):
        shapes_from_matrix(bad)


def test_shapes_to_matrix_refuses_other_shapes():
    with pytest.raises(InputError, match=r"shapes: shape \(frames, points, 3\)"):
        shapes_to_matrix(np.zeros((3, 4, 2)))


def test_point_first_flags_must_fit():
    with pytest.raises(InputError, match=r"occluded: a bool array of shape \(4, 3\)"):
        Tracks.from_point_first(np.zeros((4, 3, 2)), np.zeros((3, 4), bool))
    with pytest.raises(InputError, match=r"\(points, frames, 2\)"):
        Tracks.from_point_first(np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (numbers((2, 9, 2)), "at least 3 frames are needed, received 2"),
        (numbers((9, 3, 2)), "at least 4 points are needed, received 3"),
        (np.full((5, 6, 2), 3.0), "points at different places"),
        (np.repeat(numbers((5, 1, 2)), 6, axis=1), "points at different places"),
    ],
)
def test_what_cannot_be_reconstructed_is_legal_tracks_but_says_so(points, words):
    with pytest.raises(InputError, match=words):
        Tracks(points).require_reconstructible()


def test_points_that_differ_only_where_not_seen_count_as_equal():
    points, visible = np.zeros((3, 4, 2)), np.ones((3, 4), bool)
    points[1, 2], visible[1, 2] = 9, False
    with pytest.raises(InputError, match="all equal"):
        Tracks(points, visible).require_reconstructible()
    visible[1, 2] = True
    Tracks(points, visible).require_reconstructible()


def test_degenerate_but_legal_tracks_pass():
    Tracks(np.repeat(numbers((1, 4, 2)), 3, axis=0)).require_reconstructible()


def test_printing_is_short_and_pickling_works():
    tracks = Tracks(numbers((3, 4, 2)), np.eye(3, 4) == 1)
    assert repr(tracks) == "Tracks(3 frames, 4 points, float64, 9 of 12 missing)"
    again = pickle.loads(pickle.dumps(tracks))
    np.testing.assert_array_equal(again.points, tracks.points)
    assert issubclass(InputError, NrsfmError)
