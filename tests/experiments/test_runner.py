"""Cells in processes of their own: kept, resumed, shared, killed at their limits."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from nrsfm.experiments import kept, runner, sequences
from nrsfm.experiments.base import Cell, Data, Scope, stand_in
from nrsfm.experiments.kept import Store
from nrsfm.experiments.runner import Limits, run_cells

SMALL = Data("built-in-face1", points=40, frames=6)
SHORT = ("errors", "seconds", "memory")


def cell(method="bmm", data=SMALL, **settings):
    return Cell(data, method, measures=SHORT, **settings)


def test_cells_are_kept_shared_and_never_computed_again(tmp_path):
    store = Store(tmp_path / "cells", None)
    other = Data("built-in-sheet", points=30, frames=6, noise=0.01)
    cells = [
        cell(),
        cell(cameras="intersection"),
        cell(cameras="known", options=(("gamma", 0.01),)),
        cell("nonsense"),
        cell(data=other, cameras="intersection", alone=True),
        cell(data=Data("nowhere")),
    ]
    told = []
    records = run_cells(cells, store, None, jobs=1, tell=told.append)
    own, shared, known, nonsense, alone, nowhere = (records[c.key] for c in cells)
    assert own["errors"]["per-frame"] < 0.2
    assert own["memory"] >= 0
    assert (own["frames"], own["points"]) == (6, 40)
    # The same estimate of the cameras, once inside the call and once before it.
    assert shared["errors"]["per-frame"] == pytest.approx(own["errors"]["per-frame"], rel=1e-6)
    assert shared["seconds"]["shared_cameras"] > 0
    assert own["seconds"]["shared_cameras"] is None
    assert known["errors"]["none"] < 0.2
    assert "method must be one of" in nonsense["error"]
    assert "shared_cameras" in alone["seconds"]
    assert "'nowhere' is not a sequence" in nowhere["error"]
    assert told[-1].done == told[-1].total == 6
    assert told[-1].failed == 2
    assert {p.finished.key for p in told if p.finished} == {c.key for c in cells}

    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "cells").iterdir()}
    # What cannot be loaded is not kept: its file may come.
    assert len([path for path in times if path.suffix == ".json"]) == 5
    assert run_cells(cells[:5], store, None, jobs=1) == {c.key: records[c.key] for c in cells[:5]}
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cells").iterdir()} == times


def test_damaged_files_are_computed_again(tmp_path):
    store = Store(tmp_path, None)
    one = cell(cameras="intersection")
    before = run_cells([one], store, None, jobs=1)[one.key]
    path = tmp_path / f"{store.stem(one)}.json"
    whole = path.read_text()
    for content in (
        "",
        whole[:40],
        "[]",
        whole.replace(one.key, "another"),
        json.dumps({"key": one.key, "record": {}}),
    ):
        path.write_text(content)
        assert store.read(one) is None
    cameras = store.cameras_path(SMALL)
    cameras.write_bytes(cameras.read_bytes()[:100])
    after = run_cells([one], store, None, jobs=1)[one.key]
    assert after["errors"] == before["errors"]
    assert np.load(cameras)["rotations"].shape == (6, 3, 3)


def test_limits_kill_and_are_recorded(tmp_path):
    store = Store(tmp_path, None)
    slow = cell(data=Data("built-in-face3", points=3000, frames=60))
    found = run_cells([slow], store, None, jobs=1, limits=Limits(seconds=0.02))[slow.key]
    assert found["error"].startswith("killed after 0.02 s")
    assert (found["frames"], found["points"]) == (60, 3000)
    # A limit is a result: it is kept.
    assert store.read(slow) == found
    heavy = cell("grassmann", data=slow.data)
    found = run_cells([heavy], store, None, jobs=1, limits=Limits(memory=1e6))[heavy.key]
    assert "GB of memory" in found["error"]


_LONG = """
import sys
from pathlib import Path
from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.kept import Store
from nrsfm.experiments.runner import run_cells
data = [Data("built-in-face3", points=100 + 50 * i, frames=40) for i in range(40)]
cells = [Cell(some, "grassmann", measures=("errors",)) for some in data]
run_cells(cells, Store(Path(sys.argv[1]), None), None, jobs=1)
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds child processes in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL])
def test_a_killed_run_leaves_whole_records_and_no_process(tmp_path, number):
    process = subprocess.Popen([sys.executable, "-c", _LONG, str(tmp_path)])
    try:
        wait_for(lambda: list(tmp_path.glob("*.json")))
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    finally:
        os.kill(process.pid, number)
        process.wait()
    assert children
    wait_for(lambda: not any(alive(child) for child in children))
    for path in tmp_path.glob("*.json"):
        assert "record" in json.loads(path.read_text())


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"
    except OSError:
        return False


def test_an_interrupt_ends_the_processes_and_keeps_what_is_done(tmp_path):
    store = Store(tmp_path, None)
    cells = [cell(data=Data("built-in-face1", points=40 + i)) for i in range(30)]

    def interrupt(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cells(cells, store, None, jobs=1, tell=interrupt)
    assert sum(store.read(c) is not None for c in cells) == 1


def test_keys_tell_cells_apart():
    cells = [
        cell(),
        cell("ds"),
        cell(cameras="known"),
        cell(options=(("gamma", 1.0),)),
        cell(alone=True),
        Cell(SMALL, "bmm"),
        *(cell(data=Data("a", **change)) for change in ({"noise": 0.1}, {"noise": 0.1, "seed": 1}, {"frames": 3})),
    ]
    assert len({c.key for c in cells}) == len(cells)


def test_the_code_of_another_method_does_not_matter(monkeypatch):
    changed = {"ours": "nrsfm.methods.grassmann", "helper": "nrsfm.manifolds.grassmann", "all": "nrsfm.metrics"}
    plain_code = kept._code

    def digests():
        kept._digest.cache_clear()
        return [kept.code_digest(cell(method)) for method in ("grassmann", "bmm")]

    before = digests()
    for what, module in changed.items():
        path = dict(kept._modules())[module]
        monkeypatch.setattr(kept, "_code", lambda p, path=path: b"x" if p == path else plain_code(p))
        differs = [a != b for a, b in zip(before, digests(), strict=True)]
        assert differs == [True, what == "all"]
    monkeypatch.undo()
    assert digests() == before


def test_comments_and_docstrings_do_not_matter(tmp_path):
    texts = ['"""One."""\ndef f(x):\n    """Two."""\n    return x\n', "def f(x):  # three\n\n    return x\n"]
    codes = set()
    for i, text in enumerate([*texts, texts[0].replace("return x", "return -x")]):
        (tmp_path / f"{i}.py").write_text(text)
        codes.add(kept._code(tmp_path / f"{i}.py"))
    assert len(codes) == 2


def test_without_data_built_in_sequences_stand_in():
    scope = Scope(False, sequences.available(None))
    assert scope.having(["face-seq3", "pickup", "yoga"]) == ["built-in-face3", "built-in-sheet"]
    assert scope.faces() == [f"built-in-face{i}" for i in range(1, 5)]
    here = Scope(False, ("face-seq1", "original-face2", "pickup"), ("bmm",))
    assert here.having(["pickup", "yoga", "face-seq1", "face-seq2"]) == ["pickup", "face-seq1"]
    assert here.faces() == ["face-seq1", "original-face2"]
    assert here.using() == here.using(["bmm", "ds"]) == ["bmm"]
    assert here.using(["ds"]) == []
    assert stand_in("original-face4") == "built-in-face4"


def test_originals_are_found_by_many_names(tmp_path):
    (tmp_path / "originals").mkdir()
    for name in ("Face_Seq-1.mat", "actor sequence 2.MAT", "T-shirt.mat"):
        (tmp_path / "originals" / name).touch()
    (tmp_path / "Face2.mat").touch()
    (tmp_path / "face3.npz").touch()  # the motion capture's name; only .mat counts
    found = [name for name in sequences.ORIGINALS if sequences.files(name, tmp_path)]
    assert found == ["original-face1", "original-face2", "original-actor2", "original-tshirt"]
    assert not sequences.files("pickup", tmp_path)


def test_an_original_file_is_read_and_its_window_applied_where_it_fits(tmp_path):
    import scipy.io

    rng = np.random.default_rng(0)
    tracks = rng.uniform(260, 400, (4, 2, 30))
    tracks[:, 1] -= 100
    tracks[:, :, 20:] += 1000.0
    scipy.io.savemat(tmp_path / "paper.mat", {"W": tracks.reshape(8, 30)})
    assert sequences.load(Data("original-paper"), tmp_path).tracks.n_points == 20
    scipy.io.savemat(tmp_path / "paper.mat", {"W": tracks.reshape(8, 30) - 5000})
    sequences._clean.cache_clear()
    assert sequences.load(Data("original-paper"), tmp_path).tracks.n_points == 30
    before = sequences.digest("original-paper", tmp_path)
    scipy.io.savemat(tmp_path / "paper.mat", {"W": tracks.reshape(8, 30) - 4000})
    assert sequences.digest("original-paper", tmp_path) != before


def test_cut_sequences_keep_their_truth(tmp_path):
    whole = sequences.load(Data("built-in-face1", points=200), None)
    path = tmp_path / "face1.mat"
    import scipy.io
    import scipy.linalg

    rows = whole.shapes.transpose(0, 2, 1).reshape(30, 200)
    scipy.io.savemat(
        path,
        {
            "W": whole.tracks.points.transpose(0, 2, 1).reshape(20, 200),
            "S": rows,
            "R_GT": scipy.linalg.block_diag(*whole.rotations),
        },
    )
    cut = sequences.load(Data("original-face1", points=50, frames=4), tmp_path)
    assert cut.tracks.points.shape == (4, 50, 2)
    assert cut.shapes.shape == (4, 50, 3)
    assert len(cut.rotations) == 4
    chosen = sequences.spread_points(whole.shapes[0], 50)
    np.testing.assert_allclose(cut.shapes, whole.shapes[:4][:, chosen], rtol=1e-5)


def test_spread_points_are_spread():
    place = np.random.default_rng(1).uniform(size=(400, 2)) ** 3  # crowded in a corner
    chosen = sequences.spread_points(place, 40)
    assert len(set(chosen)) == 40
    assert list(chosen) == sorted(chosen)

    def nearest(points):
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
        return gaps.min(axis=1)

    assert nearest(place[chosen]).min() > 3 * nearest(place[::10]).min()
    same = np.zeros((5, 2))
    assert sorted(sequences.spread_points(same, 5)) == [0, 1, 2, 3, 4]
    place[7] = np.nan
    assert 7 not in sequences.spread_points(place, 100)


def test_time_left_is_a_share_of_the_work():
    told = []
    clock = runner.Clock(2, {}, [cell(), cell("ds")], None, told.append)
    clock.finish(cell(), {"x": 1})
    clock.finish(cell("ds"), {"error": "no"})
    assert told[0].left is None
    assert told[1].left > 0
    assert told[-1].left == pytest.approx(0.0, abs=1e-6)
    assert (told[-1].done, told[-1].failed) == (2, 1)
