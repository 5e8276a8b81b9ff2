"""Points on a cluster: the answer of one process, also after a worker was killed; errors say what is wrong."""

import json
import os
import pickle
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import h5py
import numpy as np
import pytest

import nrsfm
from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.streaming import cluster as clusters
from nrsfm.streaming import connecting, jobs
from nrsfm.streaming.cluster import runner_of
from nrsfm.streaming.connecting import ClusterError, addressed
from nrsfm.streaming.jobs import depth, groups
from nrsfm.streaming.readers import FileReader, MapReader, StoredReader, reader_of
from nrsfm.streaming.stored import StoredPoints
from nrsfm.streaming.stream import Stream

distributed = pytest.importorskip("distributed")

FRAMES, POINTS = 12, 2_500
PASSES = ("gram_of_shard", "cells_of_shard", "expand_shard")
# What a killed worker leaves behind in this process: its half of a connection, and a log line.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed (socket|transport):ResourceWarning")


def bending(noise=0.5):
    """A sheet that bends and turns: tracks (F, P, 2) float32 in pixels."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, (2, POINTS))
    f = np.arange(FRAMES)[:, None]
    z = 0.5 * np.cos(1.5 * x) + 0.15 * np.sin(0.5 * f) * x * y + 0.1 * np.cos(0.9 * f) * x**2
    angle = 0.9 * np.sin(0.4 * f)
    tracks = np.stack([np.cos(angle) * x + np.sin(angle) * z, np.broadcast_to(y, z.shape)], axis=2)
    tracks = 100 * tracks + [320, 240] + noise * rng.standard_normal(tracks.shape)
    return tracks.astype(np.float32)


@pytest.fixture(scope="module")
def tracks():
    return bending()


@pytest.fixture(scope="module")
def files(tracks, tmp_path_factory):
    """The tracks in files of every kind: the name of the kind, and how they are opened."""
    zarr = pytest.importorskip("zarr")
    folder = tmp_path_factory.mktemp("tracks")
    np.save(folder / "t.npy", tracks)
    np.save(folder / "f.npy", np.asfortranarray(tracks))
    with h5py.File(folder / "t.h5", "w") as file:
        file["a/tracks"] = tracks.transpose(1, 0, 2)
    zarr.create_array(str(folder / "t.zarr"), data=tracks, chunks=(FRAMES, 200, 2))
    return folder


def opened(kind, folder, tracks):
    if kind == "memory":
        return tracks
    if kind == ".h5":
        return nrsfm.Tracks(StoredPoints(h5py.File(folder / "t.h5", "r")["a/tracks"], "point-first"))
    if kind == ".zarr":
        import zarr

        return zarr.open_array(str(folder / "t.zarr"), mode="r")
    return np.load(folder / ("f.npy" if kind == "fortran" else "t.npy"), mmap_mode="r")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs="CRITICAL"
    ) as found:
        yield found


@pytest.fixture(scope="module")
def connected(cluster):
    with distributed.Client(cluster, set_as_default=False) as found:
        yield found


@pytest.fixture
def client(connected):
    """With both workers: one that a test before has killed comes back."""
    connected.wait_for_workers(2)
    return connected


@pytest.fixture(scope="module")
def whole(tracks, tmp_path_factory):
    """By one process, in blocks, from a file."""
    path = tmp_path_factory.mktemp("whole") / "t.npy"
    np.save(path, tracks)
    return reconstructed(np.load(path, mmap_mode="r"), memory="2GB")


def reconstructed(points, **options):
    return nrsfm.reconstruct(points, "geometry-aware", precision="float64", max_iterations=30, **options)


def assert_same(result, whole):
    """To 1e-6 of the size of the shapes."""
    size = np.abs(whole.shapes).max()
    assert np.abs(np.asarray(result.shapes) - np.asarray(whole.shapes)).max() < 1e-6 * size
    np.testing.assert_allclose(result.depth_deviation, whole.depth_deviation, rtol=1e-4)


@pytest.mark.parametrize("kind", [".npy", "fortran", ".h5", ".zarr"])
def test_two_workers_give_what_one_process_gives(kind, files, tracks, client, whole):
    assert_same(reconstructed(opened(kind, files, tracks), cluster=client), whole)


def test_tracks_in_memory_are_sent(tracks, client):
    result = reconstructed(tracks, cluster=client)
    assert_same(result, reconstructed(tracks, memory="2GB"))
    assert client.status == "running"
    assert not any("cluster" in text for text in result.diagnostics["warnings"])


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".h5", ".zarr"])
def test_workers_write_into_the_file(suffix, files, tracks, client, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # workers have another folder: they must be told the whole path
    result = reconstructed(opened(".npy", files, tracks), cluster=client, shapes_file=f"shapes{suffix}")
    assert_same(result, whole)
    assert not list(tmp_path.glob(".*"))


def test_an_address_is_enough_and_is_recorded(files, tracks, cluster, client, whole, tmp_path):
    own = set(client.scheduler_info()["workers"]), len(cluster.scheduler.clients)
    result = reconstructed(opened(".npy", files, tracks), cluster=cluster.scheduler_address)
    assert_same(result, whole)
    assert (set(client.scheduler_info()["workers"]), len(cluster.scheduler.clients)) == own  # ours was closed
    given = reconstructed(opened(".npy", files, tracks), cluster=client)
    for one in (result, given):
        assert type(one.options["cluster"]) is str
        assert one.options["cluster"] == cluster.scheduler_address
        json.dumps(one.options)
    given.save(tmp_path / "r.npz")
    assert nrsfm.load_reconstruction(tmp_path / "r.npz").options["cluster"] == cluster.scheduler_address


def killer(prefix, marker):
    """A plugin that kills the worker that first begins a task whose name begins so."""

    class Killer(distributed.WorkerPlugin):
        name = f"killer-{prefix}"

        def transition(self, key, start, finish, **_):
            if finish == "executing" and str(key).startswith(prefix):
                try:
                    os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
                except FileExistsError:
                    return
                os.kill(os.getpid(), signal.SIGKILL)

    return Killer()


@pytest.mark.parametrize("name", PASSES)
def test_a_killed_worker_loses_nothing(name, files, tracks, client, whole, tmp_path):
    marker = str(tmp_path / "killed")
    client.register_plugin(killer(f"{name}-5", marker))  # a shard in the middle of the pass
    try:
        result = reconstructed(opened(".npy", files, tracks), cluster=client, shapes_file=str(tmp_path / "s.npy"))
    finally:
        client.unregister_worker_plugin(f"killer-{name}-5")
    assert os.path.exists(marker)
    assert_same(result, whole)


def test_the_only_worker_may_be_killed_too(files, tracks, whole, tmp_path):
    marker = str(tmp_path / "killed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=True, dashboard_address=":0", silence_logs="CRITICAL"
        ) as small,
        distributed.Client(small, set_as_default=False) as alone,
    ):
        alone.register_plugin(killer("cells_of_shard-3", marker))
        assert_same(reconstructed(opened(".npy", files, tracks), cluster=alone), whole)
    assert os.path.exists(marker)


def test_a_pass_is_told_shard_by_shard(files, tracks, client):
    told = []
    with runner_of(addressed(client)) as runner:
        stream = Stream(opened(".npy", files, tracks), runner=runner, cells=4)
        stream.measure(0, told.append)
    assert told == sorted(told)
    assert len(told) == 8  # four a worker
    assert told[-1] == pytest.approx(1.0)


def test_the_number_of_shards_decides_every_digit(files, tracks, client):
    class Shuffled(clusters.Cluster):
        def _places(self, count):
            return super()._places(count)[::-1]

    found = []
    for kind in (clusters.Cluster, Shuffled):
        measured = Stream(opened(".npy", files, tracks), runner=kind(client)).measure(0)
        found.append(measured.gram)
    np.testing.assert_array_equal(*found)


def test_an_error_of_a_worker_is_that_of_one_process(tracks, client, tmp_path):
    wrong = tracks.copy()
    wrong[3, 1_700] = np.nan
    np.save(tmp_path / "w.npy", wrong)
    stored = StoredPoints(np.load(tmp_path / "w.npy", mmap_mode="r"))
    texts = []
    for more in ({}, {"cluster": client}):
        with pytest.raises(InputError) as caught:
            reconstructed(stored, **more)
        texts.append(str(caught.value))
    assert texts[0] == texts[1]
    assert "frame 3, point 1700" in texts[0]


def test_a_file_that_workers_do_not_see_is_named(files, tracks, client):
    reader = reader_of(opened(".npy", files, tracks))
    stream = Stream(tracks, runner=clusters.Cluster(client))
    stream.reader = _Elsewhere(str(reader.path) + ".gone", reader.offset, reader.size, reader.kind)
    with pytest.raises(FileError, match=r"cannot read or write points \d+ to \d+ on .*t\.npy\.gone"):
        stream.measure(0)


class _Elsewhere(FileReader):
    """What only the caller sees."""

    def read(self, start, stop):
        return np.zeros((self.shape[0], stop - start, 2))

    def __reduce__(self):
        return FileReader, (self.path, self.offset, self.size, self.kind)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "word"])
def test_a_cluster_that_does_not_answer(address, tracks, monkeypatch):
    monkeypatch.setattr(connecting, "CONNECTING", 0.5)
    with pytest.raises(ClusterError, match="no scheduler answers at") as caught:
        reconstructed(tracks, cluster=address)
    assert "\n" not in str(caught.value)


def test_a_cluster_without_workers(tracks, monkeypatch):
    monkeypatch.setattr(connecting, "WAITING", 0.3)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0", protocol="tcp://") as empty,
        pytest.raises(ClusterError, match=r"has no workers, and none came within 0\.3 s"),
    ):
        reconstructed(tracks, cluster=empty.scheduler_address)


def test_workers_of_another_version_are_refused(tracks, client, monkeypatch):
    monkeypatch.setattr(nrsfm, "__version__", "99.0", raising=False)
    with pytest.raises(ClusterError, match=r"every worker needs nrsfm 99\.0"):
        reconstructed(tracks, cluster=client)


def test_what_cannot_be_a_cluster(tracks, client, monkeypatch):
    with pytest.raises(OptionError, match="option 'cluster' must be an address"):
        reconstructed(tracks, cluster=3)
    monkeypatch.setattr(jobs, "LARGEST", 1000)
    with pytest.raises(InputError, match="in memory are too much to be sent"):
        reconstructed(tracks, cluster=client)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OptionError, match=r"needs the package distributed: pip install 'nrsfm\[cluster\]'"):
        reconstructed(tracks, cluster="tcp://127.0.0.1:1")


def test_what_is_not_done_on_a_cluster_is_said(tracks, client):
    visible = np.ones(tracks.shape[:2], dtype=bool)
    visible[0, :300] = False
    holes = nrsfm.reconstruct(nrsfm.Tracks(tracks, visible), "bmm", cluster=client, max_iterations=2)
    assert any("cluster: the tracks have missing entries" in text for text in holes.diagnostics["warnings"])
    few = nrsfm.reconstruct(tracks[:, :200], "bmm", cluster="tcp://nowhere:1", max_iterations=2)
    assert any("cluster: 200 points of 12 frames are few" in text for text in few.diagnostics["warnings"])


def test_an_executor_of_processes(files, tracks, whole, tmp_path):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        path = tmp_path / "s.npy"
        result = reconstructed(opened(".npy", files, tracks), cluster=pool, shapes_file=str(path))
        assert_same(result, whole)
        assert result.options["cluster"] == "executor:ProcessPoolExecutor"


@pytest.mark.parametrize("kind", [".h5", "memory"])
def test_an_executor_of_threads(kind, files, tracks, whole):
    with ThreadPoolExecutor(2) as pool:
        result = reconstructed(opened(kind, files, tracks), cluster=pool)
    assert_same(result, whole if kind != "memory" else reconstructed(tracks, memory="2GB"))


@pytest.mark.parametrize("kind", [".npy", "fortran", ".h5", ".zarr", "slice"])
def test_what_is_in_a_file_is_sent_as_its_path(kind, files, tracks, monkeypatch):
    monkeypatch.chdir(files)
    points = opened(kind, Path(), tracks) if kind != "slice" else np.load("t.npy", mmap_mode="r")[::2, ::-3]
    stored = StoredPoints(points) if kind == ".zarr" else getattr(points, "points", points)
    reader = reader_of(stored)
    assert isinstance(reader, FileReader | MapReader | StoredReader)
    sent, expected = pickle.dumps(reader), reader.read(5, 400)
    assert len(sent) < 1_000
    monkeypatch.chdir("/")
    np.testing.assert_array_equal(pickle.loads(sent).read(5, 400), expected)


def test_what_is_in_no_file_is_not_sent(tracks):
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        file["tracks"] = tracks
        with pytest.raises(InputError, match="must lie in a file"):
            pickle.dumps(StoredPoints(file["tracks"]))


def test_groups_hold_every_shard_once():
    for count in (1, 3, 4, 8, 33):
        assert [i for group in groups(count) for i in group] == list(range(count))
    assert [depth(4 * n) for n in (1, 2, 8, 64, 512)] == [3, 4, 6, 9, 12]


def test_nobody_who_uses_no_cluster_loads_dask():
    code = "import sys, nrsfm, nrsfm.pipeline; sys.exit('distributed' in sys.modules or 'dask' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
