"""Whatever bytes a file holds, and whatever its name says, it is read or refused with one line."""

import io
import json
import pickle

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.errors import FileError
from nrsfm.files import describe, known_extensions, load_rotations, load_shapes, load_tracks
from nrsfm.tracks import Tracks


def good_files():
    """The bytes of one valid file of each kind."""
    matrix = np.random.default_rng(0).standard_normal((10, 6))
    files = {}
    for name, save in (
        (".npz", lambda b: np.savez_compressed(b, W=matrix, S_valid=np.ones((5, 6), bool))),
        (".npy", lambda b: np.save(b, matrix)),
        (".mat", lambda b: scipy.io.savemat(b, {"W": matrix}, do_compression=True)),
        (".csv", lambda b: np.savetxt(b, matrix, delimiter=",")),
        (".json", lambda b: b.write(json.dumps({"W": matrix.tolist()}).encode())),
    ):
        stream = io.BytesIO()
        save(stream)
        files[name] = stream.getvalue()
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file["W"] = matrix
    files[".h5"] = stream.getvalue()
    return files


GOOD = good_files()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged")


def read_or_refuse(path):
    """Load the file every way; return the tracks, or the error."""
    results = []
    for load in (load_tracks, load_shapes, load_rotations, describe):
        try:
            results.append(load(path))
        except FileError as error:
            text = str(error)
            assert "\n" not in text
            assert str(path) in text
            assert len(text) < 2000
            results.append(error)
    return results[0]


def lost_but_described(path):
    """Whether ``describe`` has an answer although an array that it looked at cannot be read."""
    try:
        problem = describe(path)["problem"]
    except FileError:
        return False
    return problem is not None and "cannot read" in problem and "pickled" not in problem


def damaged_files():
    """Each kind of file with its array's last bytes changed, or gone: what its header promises is not there."""
    shape = (30, 40)
    matrix = np.random.default_rng(0).standard_normal(shape)
    streams = {name: io.BytesIO() for name in (".npz", ".npy", ".h5", ".mat")}
    np.savez(streams[".npz"], W=matrix)
    np.save(streams[".npy"], matrix)
    with h5py.File(streams[".h5"], "w") as file:
        file.create_dataset("W", data=matrix, chunks=shape, fletcher32=True)
    scipy.io.savemat(streams[".mat"], {"W": matrix}, do_compression=True)
    files = {name: bytearray(stream.getvalue()) for name, stream in streams.items()}
    for name, place in ((".npz", 5000), (".h5", len(files[".h5"]) - 100), (".mat", 5000)):
        files[name][place] ^= 0xFF
    files[".npy"] = files[".npy"][:-8]
    return {name: bytes(content) for name, content in files.items()}


@pytest.mark.parametrize(("extension", "content"), damaged_files().items())
def test_a_damaged_array_is_an_error_and_not_something_unknown(tmp_path, extension, content):
    path = tmp_path / f"a{extension}"
    path.write_bytes(content)
    with pytest.raises(FileError, match="cannot read") as caught:
        describe(path)
    assert "\n" not in str(caught.value)


def test_a_file_of_nothing_holds_nothing(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w"):
        pass
    with pytest.raises(FileError, match="it holds no arrays"):
        describe(tmp_path / "a.h5")


@given(extension=st.sampled_from(sorted(GOOD)), share=st.floats(0, 0.999))
def test_a_truncated_file(folder, extension, share):
    path = folder / f"cut{extension}"
    content = GOOD[extension]
    path.write_bytes(content[: int(len(content) * share)])
    result = read_or_refuse(path)
    if extension != ".csv":  # half a table of numbers is a table of numbers
        assert isinstance(result, FileError)


@given(
    extension=st.sampled_from(sorted(GOOD)),
    places=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=20),
)
def test_a_file_with_changed_bytes(folder, extension, places):
    path = folder / f"changed{extension}"
    content = bytearray(GOOD[extension])
    for share, value in places:
        content[int(share * len(content))] = value
    path.write_bytes(bytes(content))
    result = read_or_refuse(path)
    assert isinstance(result, (Tracks, FileError))
    assert not lost_but_described(path)


@given(extension=st.sampled_from(known_extensions()), content=st.binary(max_size=300))
def test_a_file_of_noise(folder, extension, content):
    path = folder / f"noise{extension}"
    path.write_bytes(content)
    read_or_refuse(path)


@given(
    extension=st.sampled_from([".csv", ".txt", ".json"]),
    content=st.text(alphabet='0123456789.,;-+e \n\t[]{}":frampointxyNa#', max_size=200),
)
def test_a_text_of_noise(folder, extension, content):
    path = folder / f"text{extension}"
    path.write_text(content, encoding="utf-8")
    read_or_refuse(path)


@pytest.mark.parametrize("extension", sorted(GOOD))
@pytest.mark.parametrize("content", sorted(GOOD))
def test_a_mislabelled_file(tmp_path, extension, content):
    path = tmp_path / f"file{extension}"
    path.write_bytes(GOOD[content])
    result = read_or_refuse(path)
    # MATLAB 7.3 files are HDF5, so an HDF5 file may be called .mat.
    if content == extension or (extension, content) == (".mat", ".h5"):
        assert isinstance(result, Tracks)
    else:
        assert isinstance(result, FileError)


def test_the_error_says_what_the_content_is(tmp_path):
    path = tmp_path / "file.npz"
    path.write_bytes(GOOD[".npy"])
    with pytest.raises(FileError, match=r"its name says \.npz, its content is a NumPy \.npy array"):
        load_tracks(path)
    path.write_bytes(b"hello")
    with pytest.raises(FileError, match="content is something else"):
        load_tracks(path)


@pytest.mark.parametrize("extension", known_extensions())
def test_empty_absent_and_folders(tmp_path, extension):
    path = tmp_path / f"file{extension}"
    with pytest.raises(FileError, match="No such file"):
        load_tracks(path)
    path.touch()
    with pytest.raises(FileError, match="the file is empty"):
        load_tracks(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(FileError, match="it is a folder"):
        load_tracks(path)


@pytest.mark.parametrize("name", ["tracks", "tracks.docx"])
def test_unknown_extensions_list_the_known(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FileError, match=r"extensions \.npz, .* are known, received"):
        load_tracks(tmp_path / name)


class Bomb:
    """Unpickling this would be noticed."""

    def __reduce__(self):
        return (pytest.fail, ("unpickled",))


def test_pickled_objects_are_never_unpickled(tmp_path):
    bombs = np.array([Bomb(), Bomb()], dtype=object)
    np.savez(tmp_path / "a.npz", W=bombs)
    np.save(tmp_path / "a.npy", bombs, allow_pickle=True)
    for name in ("a.npz", "a.npy"):
        with pytest.raises(FileError, match="pickled objects, which are never unpickled"):
            load_tracks(tmp_path / name)
        assert describe(tmp_path / name)["kind"] == "unknown"
    (tmp_path / "b.npz").write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(FileError, match="its name says"):
        load_tracks(tmp_path / "b.npz")
    # Objects beside the tracks do no harm: they are not touched.
    np.savez(tmp_path / "a.npz", W=np.ones((6, 4)), video=bombs)
    assert load_tracks(tmp_path / "a.npz").n_frames == 3


def test_a_header_that_promises_more_than_the_file_holds(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)})
    (tmp_path / "a.npy").write_bytes(header.getvalue() + b"\0" * 64)
    with pytest.raises(FileError, match="should have 8000000000000 bytes, the file holds 64"):
        load_tracks(tmp_path / "a.npy")


@pytest.mark.parametrize(
    "array", [np.ones((6, 4), complex), np.full((6, 4), "a"), np.ones((6, 4), "f8,f8"), np.ones((6, 4), bool)]
)
def test_arrays_that_are_not_real_numbers(tmp_path, array):
    np.savez(tmp_path / "a.npz", W=array)
    with pytest.raises(FileError, match="W: real numbers are needed, received dtype"):
        load_tracks(tmp_path / "a.npz")


def test_matlab_cells_and_structs_are_refused(tmp_path):
    cell = np.empty(3, dtype=object)
    cell[:] = [np.zeros(2), np.zeros(3), "x"]
    for value in (cell, {"a": np.zeros(3)}, "text"):
        scipy.io.savemat(tmp_path / "a.mat", {"W": value})
        with pytest.raises(FileError, match="W: "):
            load_tracks(tmp_path / "a.mat")
