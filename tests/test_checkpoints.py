"""An interrupted run goes on: killed at the start of any stage, it ends with the same bytes as one that was not."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nrsfm
from nrsfm.checkpoints import RUN, Checkpoint, checkpoint, content_of, forget
from nrsfm.compression import Measurements
from nrsfm.errors import FileError, InputError
from nrsfm.files.locks import alone
from nrsfm.files.values import load_value, save_value
from nrsfm.methods.base import Solution

FRAMES = 12

KILLED = """
import os, signal, sys
import numpy as np
import nrsfm

source, folder, method, stage, mapped, shapes_file = sys.argv[1:]
points = np.load(source, mmap_mode="r" if mapped == "mapped" else None)
tracks = points if mapped == "mapped" else nrsfm.Tracks(points, np.isfinite(points[..., 0]))

def progress(name, fraction):
    if name == stage:
        os.kill(os.getpid(), signal.SIGKILL)

more = {"shapes_file": shapes_file} if shapes_file else {}
nrsfm.reconstruct(tracks, method, progress=progress, checkpoint=folder, **more)
"""


def bending(points, noise=0.0, holes=0.0, seed=0):
    """A sheet that bends and turns: tracks (F, P, 2) in pixels, NaN where not seen."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, points))
    tracks = np.empty((FRAMES, points, 2))
    for f in range(FRAMES):
        z = 0.5 * np.cos(1.5 * x) + 0.15 * np.sin(0.5 * f) * x * y + 0.1 * np.cos(0.9 * f) * x**2
        angle = 0.9 * np.sin(0.4 * f)
        tracks[f] = 100 * np.stack([np.cos(angle) * x + np.sin(angle) * z, y], axis=1)
    tracks += noise * rng.standard_normal(tracks.shape)
    tracks[rng.random((FRAMES, points)) < holes] = np.nan
    return tracks


def killed(source, folder, method, stage, *, mapped=False, shapes_file=""):
    """Run in a process of its own, which kills itself when it reaches the stage."""
    words = [str(source), str(folder), method, stage, "mapped" if mapped else "", str(shapes_file)]
    done = subprocess.run([sys.executable, "-c", KILLED, *words], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr


def same(one, other):
    np.testing.assert_array_equal(one.shapes, other.shapes)
    np.testing.assert_array_equal(one.rotations, other.rotations)
    if one.depth_deviation is not None:
        np.testing.assert_array_equal(one.depth_deviation, other.depth_deviation)
    if one.groups is not None:
        np.testing.assert_array_equal(one.groups, other.groups)


@pytest.mark.parametrize(
    ("stage", "taken"),
    [
        ("cameras", ["repair"]),
        ("compression", ["repair", "cameras"]),
        ("geometry-aware", ["repair", "cameras", "compression"]),
        ("expansion", ["repair", "cameras", "compression", "geometry-aware"]),
    ],
)
def test_a_killed_run_goes_on_after_its_last_stage(tmp_path, stage, taken):
    points = bending(300, noise=0.5)
    np.save(tmp_path / "t.npy", points)
    killed(tmp_path / "t.npy", tmp_path / "kept", "geometry-aware", stage)
    result = nrsfm.reconstruct(points, "geometry-aware", checkpoint=str(tmp_path / "kept"))
    assert result.diagnostics["taken_from_checkpoint"] == taken
    same(result, nrsfm.reconstruct(points, "geometry-aware"))


def test_holes_and_noise_go_on_in_any_round(tmp_path):
    points = bending(120, noise=0.5, holes=0.1)
    np.save(tmp_path / "t.npy", points)
    points = nrsfm.Tracks(points, np.isfinite(points[..., 0]))
    killed(tmp_path / "t.npy", tmp_path / "kept", "auto", "resection")
    result = nrsfm.reconstruct(points, "auto", checkpoint=str(tmp_path / "kept"))
    assert "auto" in result.diagnostics["taken_from_checkpoint"]
    assert "resection" not in result.diagnostics["taken_from_checkpoint"]
    whole = nrsfm.reconstruct(points, "auto")
    same(result, whole)
    again = nrsfm.reconstruct(points, "auto", checkpoint=str(tmp_path / "kept"))
    assert again.diagnostics["taken_from_checkpoint"].count("resection") > 1
    same(again, whole)


@pytest.mark.parametrize("stage", ["cameras", "expansion", "perspective"])
def test_tracks_read_in_blocks_go_on_too(tmp_path, stage):
    points = bending(1500, noise=0.5).astype(np.float32)
    np.save(tmp_path / "t.npy", points)
    killed(tmp_path / "t.npy", tmp_path / "kept", "bmm", stage, mapped=True, shapes_file=tmp_path / "lost.npy")
    mapped = np.load(tmp_path / "t.npy", mmap_mode="r")
    shapes = str(tmp_path / "s.npy")  # where the shapes go may change
    result = nrsfm.reconstruct(mapped, "bmm", checkpoint=str(tmp_path / "kept"), shapes_file=shapes)
    assert result.diagnostics["taken_from_checkpoint"][0] == "reading tracks"
    same(result, nrsfm.reconstruct(mapped, "bmm", shapes_file=str(tmp_path / "other.npy")))


def test_the_command_goes_on_and_removes_the_checkpoint(tmp_path):
    np.save(tmp_path / "t.npy", bending(300, noise=0.5))
    killed(tmp_path / "t.npy", tmp_path / "kept ä", "geometry-aware", "expansion")
    words = ["reconstruct", "t.npy", "--out", "out", "--method", "geometry-aware", "--checkpoint", "kept ä"]
    words += ["--no-pictures", "--order", "frame-first"]
    run = [sys.executable, "-m", "nrsfm.cli", *words]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "resumed" in done.stdout
    assert "geometry-aware" in next(line for line in done.stdout.splitlines() if line.startswith("resumed"))
    assert not (tmp_path / "kept ä").exists()
    again = subprocess.run([*run, "--overwrite", "--seed", "1"], cwd=tmp_path, capture_output=True, check=False)
    assert again.returncode == 0


def test_another_run_is_refused_and_nothing_is_lost(tmp_path):
    points, folder = bending(200), str(tmp_path / "kept")
    nrsfm.reconstruct(points, "bmm", checkpoint=folder)
    before = {p.name: p.read_bytes() for p in Path(folder).iterdir()}
    with pytest.raises(InputError, match=r"checkpoint '.*' is of another run: option seed was 0, received 3"):
        nrsfm.reconstruct(points, "bmm", seed=3, checkpoint=folder)
    with pytest.raises(InputError, match="of another run: tracks was"):
        nrsfm.reconstruct(points + 1e-9, "bmm", checkpoint=folder)
    with pytest.raises(InputError, match="of another run: method was bmm, received grassmann"):
        nrsfm.reconstruct(points, "grassmann", checkpoint=folder)
    with pytest.raises(InputError, match="of another run: cameras was None"):
        nrsfm.reconstruct(points, "bmm", rotations=np.tile(np.eye(3), (FRAMES, 1, 1)), checkpoint=folder)
    assert {p.name: p.read_bytes() for p in Path(folder).iterdir()} == before
    nrsfm.reconstruct(points, "bmm", checkpoint=folder)


def test_a_damaged_stage_is_named(tmp_path):
    points, folder = bending(200), tmp_path / "kept"
    whole = nrsfm.reconstruct(points, "bmm", checkpoint=str(folder))
    stage = next(p for p in folder.iterdir() if "compression" in p.name)
    content = stage.read_bytes()
    for damaged in (content[:1000], content[:-300] + bytes(300), b"", content[:2000] + b"\xff" * 64 + content[2064:]):
        stage.write_bytes(damaged)
        with pytest.raises(FileError, match=r"checkpoint: cannot read '.*compression.npz'.*remove that file"):
            nrsfm.reconstruct(points, "bmm", checkpoint=str(folder))
    stage.unlink()
    same(nrsfm.reconstruct(points, "bmm", checkpoint=str(folder)), whole)


def test_a_stage_that_was_being_written_is_not_there(tmp_path):
    """A process that is killed while it writes leaves a hidden file, which the next one removes."""
    script = """
import os, signal, sys
import numpy as np
from nrsfm.files import atomic
os.fsync = lambda handle: os.kill(os.getpid(), signal.SIGKILL)
from nrsfm.checkpoints import Checkpoint
from pathlib import Path
Checkpoint(Path(sys.argv[1])).kept("a stage", lambda: np.zeros(100))
"""
    folder = tmp_path / "kept"
    with checkpoint(str(folder), lambda: {"a": 1}):
        pass
    done = subprocess.run([sys.executable, "-c", script, str(folder)], capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    names = sorted(p.name for p in folder.iterdir())
    assert len(names) == 2
    assert names[0].startswith(".001-a-stage.npz.")
    with checkpoint(str(folder), lambda: {"a": 1}) as kept:
        assert [p.name for p in folder.iterdir()] == [RUN]
        assert kept.kept("a stage", lambda: 7) == 7
    assert kept.taken == []


def test_folders_of_others_are_left_alone(tmp_path):
    (tmp_path / "letters.txt").write_text("dear")
    with pytest.raises(FileError, match=r"it holds other files, such as 'letters\.txt'"):
        nrsfm.reconstruct(bending(200), "bmm", checkpoint=str(tmp_path))
    with pytest.raises(FileError, match="it is not a folder"):
        nrsfm.reconstruct(bending(200), "bmm", checkpoint=str(tmp_path / "letters.txt"))
    assert [p.name for p in tmp_path.iterdir()] == ["letters.txt"]
    forget(str(tmp_path))
    forget(str(tmp_path / "none"))
    assert [p.name for p in tmp_path.iterdir()] == ["letters.txt"]
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "001-cameras.npz").write_bytes(b"")
    with pytest.raises(FileError, match=f"its {RUN} is missing"), checkpoint(str(tmp_path / "a"), dict):
        pass
    (tmp_path / "a" / RUN).write_text("{")
    with pytest.raises(FileError, match=f"its {RUN} is damaged"), checkpoint(str(tmp_path / "a"), dict):
        pass


@pytest.mark.skipif(os.name == "nt", reason="needs the locks of POSIX")
def test_one_process_at_a_time(tmp_path):
    with alone(tmp_path, "there"), pytest.raises(FileError, match="another process is working in it"):
        nrsfm.reconstruct(bending(200), "bmm", checkpoint=str(tmp_path))


def test_the_generator_goes_on_where_it_was(tmp_path):
    drawn = []
    for _ in range(2):
        rng, kept = np.random.default_rng(5), Checkpoint(tmp_path)
        kept.kept("draw", lambda rng=rng: rng.random(3), rng=rng)
        drawn.append(rng.random())
    assert drawn[0] == drawn[1]


def test_values_come_back_as_they_were(tmp_path):
    points = np.zeros((3, 5, 2))
    measured = Measurements(points, np.ones((3, 2)), 2.0, np.eye(6), indices=np.arange(5))
    solution = Solution(
        np.zeros((3, 3, 4), np.float32), None, 3, "settled", {"gap": [1.0, float("nan")]}, {(1, 2): "a"}
    )
    value = (measured, solution, [True, None, "ä", 1 << 100, np.float32(0.1)], {"k": np.bool_(True)})
    save_value(tmp_path / "v.npz", value, held=(None, points))
    again, other, plain, last = load_value(tmp_path / "v.npz", held=(None, points))
    assert again.points is points
    assert (again.unit, again.total, other.stop_reason, other.chosen) == (2.0, None, "settled", {(1, 2): "a"})
    np.testing.assert_array_equal(again.gram, np.eye(6))
    assert other.shapes.dtype == np.float32
    assert np.isnan(other.history["gap"][1])
    assert plain == [True, None, "ä", 1 << 100, np.float32(0.1)]
    assert last["k"].dtype == bool
    for wrong in (object(), np.array([object()]), lambda: 1):
        with pytest.raises(TypeError, match="cannot be kept"):
            save_value(tmp_path / "w.npz", wrong)
    assert not (tmp_path / "w.npz").exists()


def test_only_classes_of_this_package_are_made(tmp_path):
    text = '{"kind": "subprocess:Popen", "items": {"args": "true"}}'
    np.savez(tmp_path / "v.npz", value=np.frombuffer(text.encode(), dtype=np.uint8))
    with pytest.raises(FileError, match="not a class of this package"):
        load_value(tmp_path / "v.npz")


def test_content_tells_tracks_from_others(tmp_path, monkeypatch):
    points = bending(400)
    np.save(tmp_path / "t.npy", points)
    mapped = np.load(tmp_path / "t.npy", mmap_mode="r")
    assert content_of(points) == content_of(np.asfortranarray(points)) != content_of(points[:, ::-1])
    small = content_of(mapped)
    monkeypatch.setattr("nrsfm.checkpoints._WHOLE", 1)
    assert content_of(mapped) != small
    assert content_of(mapped) == content_of(np.load(tmp_path / "t.npy", mmap_mode="r"))
