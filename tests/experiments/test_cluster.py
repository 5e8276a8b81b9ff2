"""A sweep on a cluster is a sweep here: the same records, also where a worker is killed, and the same limits."""

import json
import os
import signal

import pytest

from nrsfm.cli import main
from nrsfm.experiments import runner
from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.kept import Store
from nrsfm.experiments.runner import Limits, run_cells
from nrsfm.streaming import connecting
from nrsfm.streaming.connecting import ClusterError

distributed = pytest.importorskip("distributed")

SMALL = Data("built-in-face1", points=40, frames=6)
# What a killed worker leaves behind in this process: its half of a connection.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed (socket|transport):ResourceWarning")


def cell(method="bmm", data=SMALL, **settings):
    return Cell(data, method, measures=("errors", "rotation"), **settings)


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs="CRITICAL"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as found,
    ):
        yield found


def test_a_sweep_on_a_cluster_is_one_here_also_where_a_worker_is_killed(tmp_path, client):
    cells = [
        cell(),
        cell(cameras="intersection"),
        cell("grassmann", cameras="intersection"),
        cell("nonsense"),
        cell(data=Data("nowhere")),
    ]
    here = run_cells(cells, Store(tmp_path / "here", None), None, jobs=2)
    store, marker = Store(tmp_path / "there", None), str(tmp_path / "killed")
    client.register_plugin(killer(f"cell-{store.stem(cells[0])}", marker))
    told = []
    there = run_cells(cells, store, None, tell=told.append, cluster=client.scheduler.address)
    assert os.path.exists(marker)
    assert there == {key: record | _seconds(there[key]) for key, record in here.items()}
    assert {p.finished.key for p in told if p.finished} == {c.key for c in cells}
    assert (told[-1].done, told[-1].total, told[-1].failed) == (5, 5, 2)
    assert {p.name for p in (tmp_path / "there").iterdir()} == {p.name for p in (tmp_path / "here").iterdir()}

    # What is kept is not computed again: nobody is asked.
    assert run_cells(cells[:4], store, None, cluster="tcp://127.0.0.1:1") == {c.key: there[c.key] for c in cells[:4]}


def _seconds(record):
    return {name: record[name] for name in ("seconds",) if name in record}


def killer(prefix, marker):
    """A plugin that kills the worker that first begins a task whose name begins so."""

    class Killer(distributed.WorkerPlugin):
        name = "killer"

        def transition(self, key, start, finish, **_):
            if finish == "executing" and str(key).startswith(prefix):
                try:
                    os.close(os.open(marker, os.O_CREAT | os.O_EXCL))
                except FileExistsError:
                    return
                os.kill(os.getpid(), signal.SIGKILL)

    return Killer()


def test_limits_are_kept_on_the_workers(tmp_path, client):
    client.wait_for_workers(2)
    one = cell(data=Data("built-in-face3", points=3000, frames=60))
    store = Store(tmp_path, None)
    record = run_cells([one], store, None, limits=Limits(seconds=0.02), cluster=client.scheduler.address)[one.key]
    assert record["error"].startswith("killed after 0.02 s")
    assert store.read(one) == record


def test_a_cluster_that_does_not_answer(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(connecting, "CONNECTING", 0.5)
    with pytest.raises(ClusterError, match="no scheduler answers"):
        run_cells([cell()], Store(tmp_path, None), None, cluster="tcp://127.0.0.1:1")
    words = ["experiment", "tau", "--quick", "--cluster", "tcp://127.0.0.1:1", "--out", str(tmp_path / "out")]
    assert main([*words, "--jobs", "2"]) == 2
    assert "option '--jobs' is for this machine alone" in capsys.readouterr().err


def test_what_runs_alone_runs_here(tmp_path, monkeypatch):
    made = []

    class Pool:
        def __init__(self, cells, *_):
            made.extend(cells)

        def run(self):
            raise KeyboardInterrupt

    monkeypatch.setattr(runner, "_Pool", Pool)
    one = cell(alone=True)
    with pytest.raises(KeyboardInterrupt):
        run_cells([one], Store(tmp_path, None), None, cluster="tcp://127.0.0.1:1")
    assert made == [one]


def test_a_damaged_return_is_an_error(tmp_path, client):
    client.wait_for_workers(1)

    class Other(Store):
        def stem(self, cell):
            return "another"

    record = run_cells([cell()], Other(tmp_path, None), None, cluster=client.scheduler.address)[cell().key]
    assert "differ from those here" in record["error"]
    json.dumps(record)
    assert not list(tmp_path.iterdir())
