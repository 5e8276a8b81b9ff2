"""Tracks read in blocks: the same shapes as in memory, from any file into any file, within the memory allowed."""

import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

import nrsfm
from nrsfm.clustering import kmeans
from nrsfm.compression import compress, compress_grams, measure, spectrum, track_coordinates
from nrsfm.errors import InputError, OptionError
from nrsfm.files import load_tracks
from nrsfm.streaming.passes import Frame, cells_of_shard
from nrsfm.streaming.plan import Plan, bytes_of, plan
from nrsfm.streaming.readers import ArrayReader, FileReader, MapReader, reader_of
from nrsfm.streaming.runners import Threads
from nrsfm.streaming.stored import StoredPoints
from nrsfm.streaming.stream import Stream
from nrsfm.streaming.targets import EXTENSIONS, Target

FRAMES, POINTS = 14, 2_600


def bending(noise=0.0, points=POINTS, seed=0):
    """A sheet that bends and turns: tracks (F, P, 2) float32 in pixels, and shapes."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, points))
    shapes, tracks = np.empty((FRAMES, points, 3)), np.empty((FRAMES, points, 2))
    for f in range(FRAMES):
        z = 0.5 * np.cos(1.5 * x) + 0.15 * np.sin(0.5 * f) * x * y + 0.1 * np.cos(0.9 * f) * x**2
        angle = 0.9 * np.sin(0.4 * f)
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        shapes[f] = 100 * np.stack([x, y, z], axis=1)
        tracks[f] = (shapes[f] @ turn.T)[:, :2] + [320, 240]
    tracks += noise * rng.standard_normal(tracks.shape)
    return tracks.astype(np.float32), shapes


@pytest.fixture(scope="module")
def scene():
    return bending(noise=0.5)


def as_a_whole(points, method):
    """Not in blocks, but with the random draws for the cells that blocks have."""

    def cells(data, count, rng):
        return kmeans(data, count, np.random.default_rng([0, 5]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nrsfm.affine.kmeans", cells)
        return nrsfm.reconstruct(points, method)


@pytest.fixture(scope="module")
def whole(scene):
    return as_a_whole(scene[0], "geometry-aware")


def difference(a, b):
    return float(np.abs(np.asarray(a.shapes) - np.asarray(b.shapes)).max() / np.abs(b.shapes).max())


def test_blocks_give_what_memory_gives(scene, whole):
    streamed = nrsfm.reconstruct(scene[0], "geometry-aware", memory="2GB")
    assert difference(streamed, whole) < 1e-4
    np.testing.assert_allclose(streamed.depth_deviation, whole.depth_deviation, rtol=1e-2)
    np.testing.assert_allclose(streamed.rotations, whole.rotations, atol=1e-6)
    np.testing.assert_array_equal(streamed.groups, whole.groups)
    assert streamed.diagnostics["compression"]["sizes"] == whole.diagnostics["compression"]["sizes"]


@pytest.mark.parametrize("method", ["bmm", "grassmann", "auto", "csf2"])
def test_other_methods_on_the_compression_stream(scene, method):
    few = scene[0][:, :1200]
    streamed = nrsfm.reconstruct(few, method, memory="2GB")
    assert difference(streamed, as_a_whole(few, method)) < 1e-3


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_shapes_go_to_a_file(scene, whole, tmp_path, extension):
    pytest.importorskip("zarr") if extension == ".zarr" else None
    path = tmp_path / f"shapes ä{extension}"
    result = nrsfm.reconstruct(scene[0], "geometry-aware", shapes_file=str(path))
    assert difference(result, whole) < 1e-4
    assert isinstance(result.shapes, np.memmap) == (extension != ".zarr")
    if extension == ".npy":
        np.testing.assert_array_equal(np.load(path), result.shapes)
        np.testing.assert_array_equal(np.load(tmp_path / "shapes ä-depth-deviation.npy"), result.depth_deviation)
    elif extension == ".npz":
        assert zipfile.ZipFile(path).testzip() is None
        with np.load(path) as archive:
            np.testing.assert_array_equal(archive["shapes"], result.shapes)
    elif extension != ".zarr":
        with h5py.File(path) as file:
            np.testing.assert_array_equal(file["shapes"][()], result.shapes)
    else:
        import zarr

        np.testing.assert_array_equal(zarr.open_group(str(path), mode="r")["shapes"][...], result.shapes)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_shapes_of_tracks_that_are_worked_on_as_a_whole_go_to_a_file_too(tmp_path):
    tracks, _ = bending(points=60)
    result = nrsfm.reconstruct(tracks, "bmm", shapes_file=str(tmp_path / "s.npy"))
    np.testing.assert_array_equal(np.load(tmp_path / "s.npy"), nrsfm.reconstruct(tracks, "bmm").shapes)
    assert isinstance(result.shapes, np.memmap)


def stored(kind, points, folder):
    """The same tracks in a file of some kind, as they are read from it."""
    if kind in ("npy", "fortran"):
        np.save(folder / "t.npy", np.asfortranarray(points) if kind == "fortran" else points)
        return np.load(folder / "t.npy", mmap_mode="r")
    if kind == "int16":
        np.save(folder / "t.npy", np.round(points).astype(np.int16))
        return StoredPoints(np.load(folder / "t.npy", mmap_mode="r"))
    if kind == "zarr":
        zarr = pytest.importorskip("zarr")
        array = zarr.open_array(str(folder / "t.zarr"), mode="w", shape=points.shape, chunks=(14, 100, 2), dtype="f4")
        array[...] = points
        return array
    layouts = {"h5": points, "point-first": points.transpose(1, 0, 2)}
    layouts["matrix"] = points.transpose(0, 2, 1).reshape(2 * FRAMES, -1)
    with h5py.File(folder / "t.h5", "w") as file:
        file["a"] = layouts[kind]
    dataset = h5py.File(folder / "t.h5")["a"]
    return dataset if kind == "h5" else StoredPoints(dataset, kind)


@pytest.mark.parametrize("kind", ["npy", "fortran", "h5", "point-first", "matrix", "zarr", "int16"])
def test_tracks_stay_in_their_file(scene, whole, tmp_path, kind):
    tracks = nrsfm.Tracks(stored(kind, scene[0], tmp_path))
    assert (tracks.n_frames, tracks.n_points) == (FRAMES, POINTS)
    result = nrsfm.reconstruct(tracks, "geometry-aware", memory="2GB")
    assert difference(result, whole) < (0.02 if kind == "int16" else 1e-4)


@pytest.mark.parametrize("kind", ["h5", "point-first", "matrix", "npy", "fortran"])
def test_a_reader_gives_the_points_of_a_block(scene, tmp_path, kind):
    points = nrsfm.Tracks(stored(kind, scene[0], tmp_path)).points
    reader = reader_of(points)
    for start, stop in ((0, 1), (7, 300), (POINTS - 5, POINTS)):
        np.testing.assert_array_equal(reader.read(start, stop), scene[0][:, start:stop])
    assert isinstance(reader, {"npy": FileReader, "fortran": MapReader}.get(kind, object))
    chosen = np.array([5, 3, 2000, 3])
    np.testing.assert_array_equal(points[:, chosen], scene[0][:, chosen])
    np.testing.assert_array_equal(points[4], scene[0][4])
    np.testing.assert_array_equal(points[-1, 3:9], scene[0][-1, 3:9])
    np.testing.assert_array_equal(np.asarray(points), scene[0])


def test_a_part_of_a_map_is_read_from_its_place(scene, tmp_path):
    np.save(tmp_path / "t.npy", scene[0])
    part = np.load(tmp_path / "t.npy", mmap_mode="r")[3:9]
    reader = reader_of(part)
    assert isinstance(reader, FileReader)
    np.testing.assert_array_equal(reader.read(10, 20), scene[0][3:9, 10:20])


def test_a_private_map_is_read_as_memory(scene, tmp_path):
    np.save(tmp_path / "t.npy", scene[0])
    private = np.load(tmp_path / "t.npy", mmap_mode="c")
    private[:, 0] = 7
    assert isinstance(reader_of(private), ArrayReader)
    np.testing.assert_array_equal(reader_of(private).read(0, 2)[:, 0], 7)


def test_the_gram_matrix_is_that_of_memory(scene):
    for workers, room in ((1, None), (2, None), (3, 10**6)):
        stream = Stream(scene[0], room=room, runner=Threads(workers))
        measured, expected = stream.measure(0), measure(scene[0])
        np.testing.assert_allclose(measured.gram, expected.gram, atol=1e-9 * np.trace(expected.gram))
        np.testing.assert_allclose(measured.translations, expected.translations, rtol=1e-12)
        assert measured.count == POINTS


def test_cells_from_gram_matrices_are_those_from_columns(scene):
    measured = measure(scene[0])
    _, vectors = spectrum(measured)
    directions = vectors[:, :3]
    centres = track_coordinates(measured, directions)[[3, 500, 900]].astype(float)
    frame, walk = Frame(measured.translations, measured.unit), Plan(block=700, part=256, threads=1)
    exact = ArrayReader(scene[0].astype(np.float64))  # float32 is centred about means that are rounded
    found = cells_of_shard(exact, walk, frame, directions, centres, None, (0, POINTS))
    labels = found.labels.astype(np.int64)
    np.testing.assert_array_equal(found.sizes, np.bincount(labels))
    for noise in (0.0, 0.01):
        one = compress(measured, labels, noise=noise)
        two = compress_grams(measured, labels, found.grams / measured.unit**2, noise=noise)
        np.testing.assert_array_equal(one.offsets, two.offsets)
        for k in range(3):
            a, b = (c.factors[..., c.offsets[k] : c.offsets[k + 1]].reshape(2 * FRAMES, -1) for c in (one, two))
            np.testing.assert_allclose(a @ a.T, b @ b.T, atol=1e-9 * np.trace(a @ a.T))


def test_a_coordinate_that_is_not_finite_is_found_while_it_is_read(scene, tmp_path):
    points = scene[0].copy()
    points[5, 2000, 1] = np.inf
    points[3, 2100, 0] = np.nan
    with h5py.File(tmp_path / "t.h5", "w") as file:
        file["tracks"] = points
    with h5py.File(tmp_path / "t.h5") as file, pytest.raises(InputError, match=r"received 2 .* frame 3, point 2100"):
        nrsfm.reconstruct(file["tracks"], "bmm")


def test_nothing_is_left_of_a_file_that_was_not_finished(tmp_path):
    with Target(tmp_path / "s.npz") as target:
        target.make({"shapes": ((3, 5, 3), np.dtype(np.float32))})
    assert list(tmp_path.iterdir()) == []


def test_what_is_too_much_for_the_memory_is_refused_at_once(tmp_path):
    big = StoredPoints(np.broadcast_to(np.arange(10**7, dtype=np.uint8)[:, None], (10, 10**7, 2)))
    with pytest.raises(InputError, match="name a file for them"):
        nrsfm.reconstruct(big, "bmm", memory="900MB")
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"memory: tracks with gaps .* received 100MB"):
        nrsfm.reconstruct(rng.standard_normal((50, 50_000, 2)), "ds", memory="100MB")


@pytest.mark.parametrize(("text", "size"), [("4GB", 4 * 10**9), ("800 MiB", 800 * 2**20), ("2e9", 2 * 10**9)])
def test_amounts_of_memory(text, size):
    assert bytes_of(text) == size


@pytest.mark.parametrize("text", ["", "much", "-1GB", "4 apples", "1MB", "nan"])
def test_what_is_no_amount_of_memory(text):
    with pytest.raises(OptionError, match="option 'memory' must be"):
        bytes_of(text)


def test_another_kind_of_file_for_shapes_is_refused(scene):
    with pytest.raises(OptionError, match=r"'shapes_file' must end in \.npy"):
        nrsfm.reconstruct(scene[0], "bmm", shapes_file="shapes.mat")


@pytest.mark.parametrize(
    ("frames", "count", "cells"), [(99, 10**6, 50), (346, 10**6, 50), (3, 10, 1), (4000, 7000, 20)]
)
def test_shards_are_all_points_once(frames, count, cells):
    walk = plan(frames, count, cells, 3)
    edges = [edge for shard in walk.shards(count) for edge in shard]
    assert (edges[0], edges[-1]) == (0, count)
    assert edges[1:-1:2] == edges[2::2]
    blocks = [block for shard in walk.shards(count) for block in walk.blocks(*shard)]
    assert sum(b - a for a, b in blocks) == count


def test_the_command_line_writes_the_shapes_into_the_reconstruction(scene, whole, tmp_path):
    np.save(tmp_path / "t.npy", scene[0])
    words = [
        str(Path(sys.executable).with_name("nrsfm")),
        "reconstruct",
        str(tmp_path / "t.npy"),
        "--order",
        "frame-first",
    ]
    words += ["--method", "geometry-aware", "--memory", "2GB", "--out", str(tmp_path / "out"), "--no-pictures"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    result = nrsfm.load_reconstruction(tmp_path / "out" / "reconstruction.npz")
    assert difference(result, whole) < 1e-4
    assert result.depth_deviation is not None
    assert result.options["shapes_file"] is None
    assert zipfile.ZipFile(tmp_path / "out" / "reconstruction.npz").testzip() is None


def test_a_store_of_zarr_is_a_file_of_tracks(scene, tmp_path):
    stored("zarr", scene[0], tmp_path)
    np.testing.assert_array_equal(load_tracks(tmp_path / "t.zarr", order="frame-first").points, scene[0])


MEMORY = """
import sys, numpy as np, nrsfm
from nrsfm.streaming.memory import resident
tracks = np.load(sys.argv[1], mmap_mode="r")
nrsfm.reconstruct(np.array(tracks[:, :1200]), "bmm")
before = resident()
result = nrsfm.reconstruct(tracks, "bmm", memory=sys.argv[3], shapes_file=sys.argv[2], deviation=False)
peak = int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) * 1024
print(before, peak, nrsfm.shape_error(result.shapes, result.shapes), len(result.diagnostics["warnings"]))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory is read from /proc")
def test_memory_is_kept_to(tmp_path):
    """Tracks of 450 MB and shapes of 670 MB within 400 MB, of which about 150 are the interpreter and its libraries."""
    few, _ = bending(noise=0.1, points=4000)
    count = 4_000_000
    out = np.lib.format.open_memmap(tmp_path / "t.npy", "w+", np.float32, (FRAMES, count, 2))
    for start in range(0, count, 4000):
        out[:, start : start + 4000] = few
    out.flush()
    del out
    words = [sys.executable, "-c", MEMORY, str(tmp_path / "t.npy"), str(tmp_path / "s.npy"), "400MB"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[1]) < 400e6
