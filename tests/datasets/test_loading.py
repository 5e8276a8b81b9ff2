"""The loaders on a folder made here, and on the real one where it is."""

import numpy as np
import pytest

from nrsfm import datasets
from nrsfm.errors import FileError, InputError
from nrsfm.metrics import shape_error

IN_OBJECT_FRAME = ("pickup", "yoga", "stretch", "drink", "dance", "face1")
SMALL = [i.name for i in datasets.table() if not i.name.startswith("ict-take")]


def turning(frames):
    angles = np.linspace(-0.5, 0.5, frames)
    rotations = np.tile(np.eye(3), (frames, 1, 1))
    rotations[:, 0, 0] = rotations[:, 2, 2] = np.cos(angles)
    rotations[:, 0, 2], rotations[:, 2, 0] = np.sin(angles), -np.sin(angles)
    return rotations


@pytest.fixture
def folder(tmp_path):
    generator = np.random.default_rng(0)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [4, 5, 6, 7]], np.int32)
    np.savez(tmp_path / "face_poses.npz", poses=generator.random((3, 4, 3), np.float32), faces=faces)
    np.savez(
        tmp_path / "face_sequences.npz",
        weights_3=generator.random((5, 3), np.float32),
        rotations_3=turning(5),
    )
    np.savez(
        tmp_path / "ict_face_model.npz",
        neutral=generator.random((8, 3)), expr=generator.random((2, 8, 3)), quads=quads, n_narrow=6, n_face=7,
    )  # fmt: skip
    np.savez(tmp_path / "ict_sequences.npz", weights_rom99=generator.random((5, 2)), rotations_rom99=turning(5))
    np.savez(
        tmp_path / "ict_livelink_rom_coeffs.npz",
        alex_rom_3=generator.random((9, 2)), alex_rom_4=generator.random((8, 2)),
    )  # fmt: skip
    np.savez(tmp_path / "mesh_horse_gallop.npz", S=generator.random((12, 4)), faces=faces)
    hole = generator.random((9, 6))
    hole[3:6, 2] = np.nan
    np.savez(tmp_path / "hulk_persp.npz", W=generator.random((6, 6)), S=hole, K=np.eye(3))
    return tmp_path


def test_faces_are_mixtures_seen_by_turning_cameras(folder):
    sequence = datasets.load("face-seq3", folder)
    model, motion = np.load(folder / "face_poses.npz"), np.load(folder / "face_sequences.npz")
    for f in range(5):
        shape = sum(w * p for w, p in zip(motion["weights_3"][f].astype(float), model["poses"], strict=True))
        np.testing.assert_allclose(sequence.shapes[f], shape, rtol=1e-12)
        np.testing.assert_allclose(sequence.tracks.points[f], shape @ motion["rotations_3"][f][:2].T, rtol=1e-9)
    assert sequence.tracks.points.dtype == np.float64
    assert datasets.load("face-seq3", folder, dtype="float32").tracks.points.dtype == np.float32


def test_denser_faces_move_alike(folder):
    plain, dense = datasets.load("face-seq3", folder), datasets.load("face-seq3", folder, subdivide=2)
    np.testing.assert_allclose(dense.shapes[:, :4], plain.shapes)
    assert dense.faces.shape == (32, 3)
    exact = datasets.load("face-seq3", folder, points=17, truth=False)
    assert exact.tracks.n_points == 17
    assert exact.shapes is None
    np.testing.assert_allclose(exact.tracks.points[:, :9], dense.tracks.points[:, :9])


def test_blendshapes_keep_the_quads_of_their_vertices(folder):
    sizes = {v: datasets.load("ict-rom99", folder, vertices=v) for v in ("narrow", "face", "all")}
    assert {v: (s.tracks.n_points, len(s.faces)) for v, s in sizes.items()} == {
        "narrow": (6, 2), "face": (7, 2), "all": (8, 3)
    }  # fmt: skip
    model, motion = np.load(folder / "ict_face_model.npz"), np.load(folder / "ict_sequences.npz")
    shape = model["neutral"] + np.tensordot(motion["weights_rom99"][4], model["expr"], 1)
    np.testing.assert_allclose(sizes["all"].shapes[4], shape)


@pytest.mark.parametrize(("name", "frames"), [("mesh_horse_gallop", 4), ("ict-take4", 8)])
def test_sequences_without_cameras_get_a_path_or_the_given_ones(folder, name, frames):
    sequence = datasets.load(name, folder)
    assert sequence.rotations.shape == (frames, 3, 3)
    given = turning(frames)
    other = datasets.load(name, folder, rotations=given[:, :2])
    np.testing.assert_allclose(other.rotations, given, atol=1e-12)
    np.testing.assert_allclose(other.tracks.points[1], sequence.shapes[1] @ given[1, :2].T)
    assert other.note["camera"] == "orthographic; given by the caller"
    with pytest.raises(InputError, match=f"{frames} cameras are needed, received 3"):
        datasets.load(name, folder, rotations=turning(3))


def test_unknown_truth_is_marked(folder):
    sequence = datasets.load("hulk_persp", folder)
    assert not sequence.valid[1, 2]
    assert sequence.valid.sum() == 17
    assert sequence.note["frame"] == "camera"
    assert sequence.note["K"] == np.eye(3).tolist()


def test_names_are_found_and_suggested(folder):
    assert datasets.load("FACE_SEQ3", folder).name == "face-seq3"
    with pytest.raises(InputError, match="'face-seq5' is not a data set; did you mean 'face-seq"):
        datasets.load("face-seq5", folder)
    with pytest.raises(InputError, match="known: face-seq1"):
        datasets.load("zzzzzz", folder)
    assert len(set(datasets.names())) == len(datasets.table()) == len(datasets.names())


def test_the_folder_comes_from_the_argument_or_the_variable(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("NRSFM_DATA", str(folder))
    assert datasets.load("face-seq3").tracks.n_frames == 5
    with pytest.raises(FileError, match=r"must exist, received '.*absent' .from root."):
        datasets.load("face-seq3", tmp_path / "absent")
    monkeypatch.delenv("NRSFM_DATA")
    with pytest.raises(FileError, match="environment variable NRSFM_DATA"):
        datasets.load("face-seq3")


def test_missing_files_and_arrays_are_named(folder):
    with pytest.raises(FileError, match=r"needs the file 'yoga.npz' in folder"):
        datasets.load("yoga", folder)
    with pytest.raises(FileError, match="array 'weights_1' is missing; found weights_3"):
        datasets.load("face-seq1", folder)
    with pytest.raises(FileError, match="needs the folder 'phisft_R1_video'"):
        datasets.load_cloth_video(folder)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"vertices": "face"}, "'vertices' is not an option of the data set 'face-seq3'"),
        ({"rotations": turning(5)}, "'rotations' is not an option"),
        ({"noise": -1}, "noise must be"),
        ({"subdivide": -1}, "subdivide must be"),
        ({"dtype": "int8"}, "dtype must be float32 or float64, received 'int8'"),
        ({"dtype": "apple"}, "dtype must be float32 or float64"),
    ],
)
def test_other_options_are_refused(folder, options, words):
    with pytest.raises(InputError, match=words):
        datasets.load("face-seq3", folder, **options)


def test_the_generator_is_loaded_when_used():
    assert datasets.synthetic.__name__ == "nrsfm.datasets.synthetic"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = datasets.nothing


# --- the real folder


@pytest.mark.parametrize("name", SMALL)
def test_real_sequences_are_what_the_table_says(data_root, name):
    info = next(i for i in datasets.table() if i.name == name)
    sequence = datasets.load(name, data_root)
    assert sequence.tracks.points.shape == (info.frames, info.points, 2)
    assert sequence.shapes is not None
    assert ("rotations" in info.truth) <= (sequence.rotations is not None)
    assert {"origin", "licence", "units", "camera", "frame"} <= sequence.note.keys()
    sequence.tracks.require_reconstructible()
    if sequence.faces is not None:
        assert sequence.faces.min() >= 0
        assert sequence.faces.max() < info.points
    if sequence.edges is not None:
        assert sequence.edges.max() < info.points
    if sequence.rotations is not None:
        # Centred W = R S, to 1e-6 of the largest entry.
        for f in range(info.frames):
            seen = sequence.tracks.points[f] - sequence.tracks.points[f].mean(axis=0)
            shape = sequence.shapes[f] - sequence.shapes[f].mean(axis=0)
            gap = np.abs(shape @ sequence.rotations[f, :2].T - seen).max()
            assert gap <= 1e-6 * np.abs(seen).max()
    if info.points < 2000:
        assert shape_error(sequence.shapes, sequence.shapes, valid=sequence.valid) < 1e-12


@pytest.mark.parametrize("name", ["walking", "shark"])
def test_shapes_in_the_frame_of_the_camera(data_root, name):
    sequence = datasets.load(name, data_root)
    assert sequence.note["frame"] == "camera"
    np.testing.assert_array_equal(sequence.shapes[..., :2], sequence.tracks.points)


@pytest.mark.parametrize("name", ["mat1500_persp", "flag250_persp"])
def test_perspective_truth_projects_onto_the_tracks(data_root, name):
    sequence = datasets.load(name, data_root)
    image = sequence.shapes @ np.array(sequence.note["K"]).T
    np.testing.assert_allclose(image[..., :2] / image[..., 2:], sequence.tracks.points, atol=1e-3)


def test_dense_versions_of_the_real_faces(data_root):
    dense = datasets.load("ict-rom99", data_root, subdivide=1, truth=False)
    assert dense.tracks.n_points == 26534
    exact = datasets.load("face-seq1", data_root, points=16 * 29299, truth=False)
    assert exact.tracks.n_points == 468784
    plain = datasets.load("face-seq1", data_root)
    np.testing.assert_allclose(exact.tracks.points[:, :29299], plain.tracks.points, atol=1e-6)


def test_the_real_cloth(data_root):
    cloth = datasets.load_cloth_video(data_root)
    assert len(cloth.images) == len(cloth.masks) == len(cloth.clouds) == 50
    x, y, z = cloth.clouds[0].T
    width, height = cloth.camera["size"]
    assert (np.abs(cloth.camera["fx"] * x / z + cloth.camera["cx"] - width / 2) < width / 2).mean() > 0.9
    assert (np.abs(cloth.camera["fy"] * y / z + cloth.camera["cy"] - height / 2) < height / 2).mean() > 0.9
