import contextlib
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.errors import FileError, InputError
from nrsfm.reconstruction import Reconstruction, load_reconstruction
from nrsfm.tracks import Tracks


def rotations(frames, rng):
    q, _ = np.linalg.qr(rng.standard_normal((frames, 3, 3)))
    return q * np.sign(np.linalg.det(q))[:, None, None]


def make(frames=4, points=7, seed=0, dtype=np.float32, labelled=True, **changes):
    rng = np.random.default_rng(seed)
    values = {
        "shapes": (100 * rng.standard_normal((frames, points, 3))).astype(dtype),
        "rotations": rotations(frames, rng),
        "translations": 50 * rng.standard_normal((frames, 2)),
        "scales": rng.uniform(0.5, 2.0, frames),
        "groups": rng.integers(0, 3, points) if labelled else None,
        "diagnostics": {"warnings": ["the camera hardly turns"], "ranks": [1, 2], "gap": 1e-9},
        "method": "bmm",
        "options": {"tolerance": 1e-10, "rank": None},
    }
    return Reconstruction(**{**values, **changes})


sizes = st.tuples(st.integers(1, 6), st.integers(1, 9), st.integers(0, 2**32 - 1))
dtypes = st.sampled_from([np.float32, np.float64])


@given(sizes, dtypes)
def test_projection_is_that_of_the_contract(size, dtype):
    result = make(*size, dtype=dtype)
    expected = [
        s * (r @ shape.T)[:2].T + t
        for shape, r, s, t in zip(result.shapes, result.rotations, result.scales, result.translations, strict=True)
    ]
    np.testing.assert_allclose(result.project(), expected, rtol=1e-5 if dtype is np.float32 else 1e-12, atol=1e-3)
    assert result.project().dtype == dtype


@given(sizes, dtypes)
def test_projection_is_the_scaled_and_moved_camera_shape(size, dtype):
    result = make(*size, dtype=dtype)
    seen = result.scales[:, None, None] * result.camera_shapes()[..., :2] + result.translations[:, None]
    np.testing.assert_allclose(result.project(), seen, rtol=1e-4, atol=1e-2)


def make_holed(frames=4, points=7, seed=0, lost=None, **changes):
    """A reconstruction with confidence and deviation in which the points ``lost`` have no shape."""
    rng = np.random.default_rng(seed)
    lost = rng.random(points) < 0.4 if lost is None else lost
    lost[:4] = False
    shapes = 100 * rng.standard_normal((frames, points, 3))
    confidence, deviation = rng.random((frames, points)), rng.exponential(size=(frames, points))
    shapes[:, lost], confidence[:, lost], deviation[:, lost] = np.nan, 0.0, np.nan
    values = {"confidence": confidence, "depth_deviation": deviation, **changes}
    return make(frames, points, seed, shapes=shapes, **values), ~lost


holed = st.tuples(st.integers(1, 6), st.integers(4, 12), st.integers(0, 2**32 - 1))


@given(holed)
def test_what_is_computed_from_points_without_a_shape_is_nan_and_the_others_do_not_feel_it(size):
    result, known = make_holed(*size)
    alone = make(
        *size,
        shapes=result.shapes[:, known],
        rotations=result.rotations,
        translations=result.translations,
        scales=result.scales,
        labelled=False,
    )
    np.testing.assert_array_equal(result.reconstructed, known)
    assert result.n_missing == np.count_nonzero(~known)
    assert (f"{result.n_missing} not reconstructed" in repr(result)) == (not known.all())
    tracks = Tracks(np.zeros((size[0], size[1], 2)))
    pairs = [
        (result.project(), alone.project()),
        (result.camera_shapes(), alone.camera_shapes()),
        (result.camera_depths(), alone.camera_depths()),
        (result.mirrored().shapes, alone.mirrored().shapes),
        (result.reprojection_errors(tracks), alone.reprojection_errors(Tracks(tracks.points[:, known]))),
    ]
    for whole, part in pairs:
        np.testing.assert_allclose(whole[:, known], part, rtol=1e-12, atol=1e-9)
        assert np.isnan(whole[:, ~known]).all()


@given(holed)
def test_depth_is_the_third_coordinate_in_the_camera_and_the_mirror_turns_it_around(size):
    result, _ = make_holed(*size)
    depths = result.camera_depths()
    np.testing.assert_allclose(depths, result.camera_shapes()[..., 2], rtol=1e-12, atol=1e-9)
    other = result.mirrored()
    np.testing.assert_allclose(other.camera_depths(), -depths, rtol=1e-12, atol=1e-9)
    for name in ("confidence", "depth_deviation"):
        np.testing.assert_array_equal(getattr(other, name), getattr(result, name))
        assert getattr(result, name).dtype == np.float32


@settings(max_examples=25)
@given(holed, st.booleans(), st.booleans())
def test_save_and_load_keep_confidence_deviation_and_holes(tmp_path_factory, size, trusted, measured):
    changes = {} if trusted else {"confidence": None}
    result, known = make_holed(*size, **changes, **({} if measured else {"depth_deviation": None}))
    path = tmp_path_factory.mktemp("saved") / "r.npz"
    result.save(path)
    again = load_reconstruction(path)
    np.testing.assert_array_equal(again.reconstructed, known)
    np.testing.assert_array_equal(again.shapes, result.shapes)
    for name in ("confidence", "depth_deviation"):
        assert (getattr(again, name) is None) == (getattr(result, name) is None)
        if getattr(result, name) is not None:
            np.testing.assert_array_equal(getattr(again, name), getattr(result, name))


@settings(max_examples=50)
@given(
    st.integers(0, 5), st.integers(0, 8), st.integers(0, 2), st.sampled_from([np.nan, np.inf, -np.inf]), st.booleans()
)
def test_one_number_that_is_not_finite_is_refused_wherever_it_is(frame, point, axis, value, holes):
    result, known = make_holed(6, 9, 3, np.arange(9) >= 7 if holes else np.zeros(9, dtype=bool))
    shapes = result.shapes.copy()
    if not known[point]:
        value = 1.0
    shapes[frame, point, axis] = value
    with pytest.raises(InputError, match=f"shapes: a point must be finite in every frame.* received point {point} "):
        make(6, 9, shapes=shapes)


def test_fewer_than_four_points_may_be_all_but_not_what_is_left():
    assert make(points=2).reconstructed.all()
    shapes = make(points=7).shapes.copy()
    shapes[:, 3:] = np.nan
    with pytest.raises(InputError, match="at least 4 points must be finite, received 3 of 7"):
        make(shapes=shapes)


@pytest.mark.parametrize(
    ("name", "frame", "point", "value", "text"),
    [
        ("confidence", 2, 1, 1.5, "numbers from 0 to 1 are needed, received 1.5 in frame 2, point 1"),
        ("confidence", 2, 1, -0.1, "numbers from 0 to 1 are needed, received -0.1 in frame 2, point 1"),
        ("confidence", 2, 6, np.nan, "numbers from 0 to 1 are needed, received nan in frame 2, point 6"),
        (
            "confidence",
            1,
            6,
            0.5,
            "0 is needed for points that were not reconstructed, received 0.5 in frame 1, point 6",
        ),
        ("depth_deviation", 3, 0, -1.0, "at least 0 is needed for point 0, received -1 in frame 3"),
        ("depth_deviation", 3, 0, np.nan, "at least 0 is needed for point 0, received nan in frame 3"),
        ("depth_deviation", 0, 0, np.inf, "at least 0 is needed for point 0, received inf in frame 0"),
        (
            "depth_deviation",
            0,
            6,
            1.0,
            "NaN, as it was not reconstructed, is needed for point 6, received 1 in frame 0",
        ),
    ],
)
def test_confidence_and_deviation_have_rules(name, frame, point, value, text):
    result, _ = make_holed(lost=np.arange(7) == 6)
    array = getattr(result, name).copy()
    array[frame, point] = value
    with pytest.raises(InputError, match=f"^{name}: .*{text}"):
        make_holed(lost=np.arange(7) == 6, **{name: array})


@pytest.mark.parametrize("name", ["confidence", "depth_deviation"])
def test_confidence_and_deviation_have_a_shape_and_a_type(name):
    with pytest.raises(InputError, match=rf"{name}: shape \(4, 7\) is needed, received \(7, 4\)"):
        make(**{name: np.zeros((7, 4))})
    with pytest.raises(InputError, match=f"{name}: real numbers are needed, received dtype bool"):
        make(**{name: np.zeros((4, 7), dtype=bool)})


def test_files_of_older_versions_still_load(tmp_path):
    """Such a file has no confidence and no deviation, and perhaps no groups."""
    make(labelled=False).save(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as archive:
        assert set(archive.files) == {"shapes", "rotations", "translations", "scales", "about"}
        assert json.loads(str(archive["about"]))["format"] == "nrsfm-reconstruction-1"
    again = load_reconstruction(tmp_path / "r.npz")
    assert again.confidence is None
    assert again.depth_deviation is None


@given(sizes, dtypes)
def test_mirrored_twice_is_the_same(size, dtype):
    result = make(*size, dtype=dtype)
    again = result.mirrored().mirrored()
    for name in ("shapes", "rotations", "translations", "scales", "groups"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
    assert again.diagnostics == result.diagnostics
    assert again.shapes.dtype == result.shapes.dtype


@given(sizes, dtypes)
def test_mirrored_is_seen_the_same_with_the_depth_reversed(size, dtype):
    result = make(*size, dtype=dtype)
    other = result.mirrored()
    tolerance = {"rtol": 1e-4, "atol": 1e-3}
    np.testing.assert_allclose(other.project(), result.project(), **tolerance)
    np.testing.assert_allclose(other.camera_shapes(), result.camera_shapes() * [1, 1, -1], **tolerance)
    np.testing.assert_allclose(np.linalg.det(other.rotations), 1.0)
    assert other.diagnostics["mirrored"] is True
    assert "mirrored" not in result.diagnostics


@settings(max_examples=25)
@given(sizes, dtypes, st.booleans())
def test_save_and_load_give_the_same(tmp_path_factory, size, dtype, labelled):
    result = make(*size, dtype=dtype, labelled=labelled)
    path = tmp_path_factory.mktemp("saved") / "r.npz"
    result.save(path)
    again = load_reconstruction(path)
    for name in ("shapes", "rotations", "translations", "scales"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))
        assert getattr(again, name).dtype == getattr(result, name).dtype
    assert (again.groups is None) == (result.groups is None)
    if labelled:
        np.testing.assert_array_equal(again.groups, result.groups)
    assert (again.method, again.options, again.diagnostics) == (
        result.method,
        result.options,
        result.diagnostics,
    )


def test_reprojection_error_is_the_distance_and_nan_where_not_seen():
    result = make(dtype=np.float64)
    points = result.project() + np.array([3.0, 4.0])
    np.testing.assert_allclose(result.reprojection_errors(Tracks(points)), 5.0)
    visible = np.ones(points.shape[:2], dtype=bool)
    visible[1, 2] = False
    errors = result.reprojection_errors(Tracks(points, visible))
    assert np.isnan(errors[1, 2])
    assert np.count_nonzero(np.isnan(errors)) == 1


def test_reprojection_error_refuses_tracks_of_another_size():
    with pytest.raises(InputError, match=r"\(4, 7, 2\) are needed, received \(4, 6, 2\)"):
        make().reprojection_errors(Tracks(np.zeros((4, 6, 2))))


def test_shapes_keep_their_memory_and_order():
    shapes = np.asfortranarray(np.zeros((4, 7, 3), dtype=np.float32))
    shapes.setflags(write=False)
    assert make(shapes=shapes).shapes is shapes


def test_attributes_cannot_be_set():
    with pytest.raises(AttributeError):
        make().shapes = np.zeros((4, 7, 3))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"shapes": np.zeros((4, 7, 2))}, r"shapes: shape \(frames, points, 3\) is needed"),
        ({"shapes": np.zeros((0, 7, 3))}, "shapes: shape"),
        (
            {"shapes": np.zeros((4, 7, 3), dtype=complex)},
            "real numbers are needed, received dtype complex128",
        ),
        ({"shapes": np.full((4, 7, 3), np.nan)}, "at least 4 points must be finite, received 0 of 7"),
        ({"shapes": np.full((4, 7, 3), np.inf)}, r"received point 0 with \(inf, inf, inf\) in frame 0"),
        ({"translations": np.full((4, 2), np.nan)}, "translations: every number must be finite, received 8"),
        ({"rotations": np.zeros((3, 3, 3))}, r"rotations: shape \(4, 3, 3\) is needed"),
        ({"rotations": 2 * np.stack([np.eye(3)] * 4)}, "orthonormal"),
        ({"rotations": np.stack([np.diag([1.0, 1.0, -1.0])] * 4)}, "determinant must be 1"),
        ({"translations": np.zeros((4, 3))}, r"translations: shape \(4, 2\) is needed"),
        ({"scales": np.array([1.0, 1.0, -1.0, 1.0])}, "scales: every scale must be positive, received -1"),
        ({"groups": np.zeros(7)}, "groups: 7 integers are needed"),
        ({"groups": np.zeros(6, dtype=int)}, "groups: 7 integers are needed"),
        ({"options": None}, "options: a dict is needed, received NoneType"),
        ({"method": 3}, "method: a name is needed"),
    ],
)
def test_broken_rules_are_input_errors_of_one_line(changes, text):
    with pytest.raises(InputError, match=text) as caught:
        make(**changes)
    assert "\n" not in str(caught.value)


def test_integer_shapes_become_float64():
    assert make(shapes=np.ones((4, 7, 3), dtype=np.int32)).shapes.dtype == np.float64


def test_numpy_values_in_diagnostics_are_saved_as_plain_ones(tmp_path):
    make(diagnostics={"gap": np.float64(0.5), "ranks": np.arange(3)}).save(tmp_path / "r.npz")
    assert load_reconstruction(tmp_path / "r.npz").diagnostics == {"gap": 0.5, "ranks": [0, 1, 2]}


def test_what_does_not_fit_json_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="do not fit JSON"):
        make(diagnostics={"what": object()}).save(tmp_path / "r.npz")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["r.npy", "r.mat", "r", "r.npz.txt"])
def test_save_refuses_other_extensions(tmp_path, name):
    with pytest.raises(FileError, match=r"must end in \.npz"):
        make().save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_save_refuses_to_overwrite_when_asked_to(tmp_path):
    make(seed=1).save(tmp_path / "r.npz")
    before = (tmp_path / "r.npz").read_bytes()
    with pytest.raises(FileError, match="it exists"):
        make(seed=2).save(tmp_path / "r.npz", overwrite=False)
    assert (tmp_path / "r.npz").read_bytes() == before


def test_file_holds_no_pickles_and_json_text(tmp_path):
    make().save(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz", allow_pickle=False) as archive:
        assert set(archive.files) == {"shapes", "rotations", "translations", "scales", "groups", "about"}
        assert json.loads(str(archive["about"]))["method"] == "bmm"


def rewrite(path, **changes):
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays.update(changes)
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def test_load_names_the_missing_file(tmp_path):
    with pytest.raises(FileError, match=r"cannot read '.*none\.npz': No such file"):
        load_reconstruction(tmp_path / "none.npz")


def test_load_refuses_a_folder(tmp_path):
    with pytest.raises(FileError, match="cannot read"):
        load_reconstruction(tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_load_refuses_a_truncated_file(tmp_path, share):
    path = tmp_path / "r.npz"
    make(points=50).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileError, match="is not a reconstruction"):
        load_reconstruction(path)


@settings(max_examples=60)
@given(st.data())
def test_load_of_a_damaged_file_is_a_file_error_or_gives_a_valid_result(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("damaged") / "r.npz"
    make().save(path)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with contextlib.suppress(FileError):
        load_reconstruction(path)


def test_load_says_what_is_missing_and_what_was_found(tmp_path):
    np.savez(tmp_path / "w.npz", W=np.zeros((4, 5)), R=np.zeros(3))
    with pytest.raises(FileError, match="shapes, rotations, translations, scales, about missing, found R, W"):
        load_reconstruction(tmp_path / "w.npz")


def test_load_never_unpickles(tmp_path):
    path = tmp_path / "r.npz"
    make().save(path)
    rewrite(path, shapes=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileError, match="is not a reconstruction"):
        load_reconstruction(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"shapes": np.zeros((4, 7))},
        {"rotations": np.zeros((4, 3, 3))},
        {"translations": np.zeros((3, 2))},
        {"scales": None},
        {"groups": np.zeros(3, dtype=int)},
        {"confidence": np.full((4, 7), 2.0)},
        {"depth_deviation": np.zeros((3, 7))},
        {"about": np.array("{")},
        {"about": np.array("[]")},
        {"about": np.arange(3)},
        {"about": np.array('{"format": "other", "method": "", "options": {}, "diagnostics": {}}')},
        {"about": np.array('{"format": "nrsfm-reconstruction-1", "method": 1, "options": {}, "diagnostics": {}}')},
    ],
)
def test_load_refuses_wrong_content(tmp_path, changes):
    path = tmp_path / "r.npz"
    make().save(path)
    rewrite(path, **changes)
    with pytest.raises(FileError, match=r"reconstruction|format"):
        load_reconstruction(path)


def test_load_refuses_a_zip_of_something_else(tmp_path):
    with zipfile.ZipFile(tmp_path / "r.npz", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(FileError, match="missing, found readme"):
        load_reconstruction(tmp_path / "r.npz")


def test_reprojection_errors_of_far_away_tracks_keep_their_digits():
    shapes = np.random.default_rng(0).standard_normal((3, 5, 3)).astype(np.float32)
    rotations = np.repeat(np.eye(3)[None], 3, axis=0)
    far = np.full((3, 2), 1e9)
    result = Reconstruction(shapes, rotations, far, np.ones(3))
    points = shapes[..., :2].astype(np.float64) + far[:, None]
    assert result.reprojection_errors(Tracks(points)).max() < 1e-6
