import json
import os
import signal
import subprocess
import sys
import time

import pytest

QUICK = ("--quick", "--methods", "bmm", "--jobs", "1")


@pytest.fixture(autouse=True)
def no_data(monkeypatch):
    monkeypatch.delenv("NRSFM_DATA", raising=False)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "an experiment is needed, one of table, noise"),
        (["tabel"], "unknown experiment 'tabel'; did you mean 'table'"),
        (["time", "--jobs", "0"], "option '--jobs' must be at least 1, received 0"),
        (["time", "--methods", "bm"], "unknown method 'bm'; did you mean 'bmm'"),
        (["time", "--methods", ","], "option '--methods' needs names"),
        (["time", "--sequences", "pickup"], "of which none was given (--data)"),
        (["time", "--data", "/nowhere"], "must exist, received '/nowhere'"),
        (["time", "--page", "x.md"], "option '--page' belongs to 'nrsfm experiment all'"),
    ],
)
def test_wrong_words_are_explained_before_anything_is_computed(command, tmp_path, words, text):
    code, out, err = command("experiment", *words, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_experiment_and_the_page_of_all(command, tmp_path, monkeypatch):
    out = tmp_path / "out"
    code, said, err = command("experiment", "time", *QUICK, "--out", out)
    assert code == 0
    assert "built-in sequences are used" in said
    assert "not measured: Algorithms 1 and 2" in said
    assert "time: 0 of 5 cells" in err
    assert {"time.csv", "time.png", "time.svg", "time.json", "cells"} == {path.name for path in out.iterdir()}
    times = {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
    config = json.loads((out / "time.json").read_text())
    assert all((out / cell["file"]).is_file() for cell in config["cells"])

    # All of one experiment: what is finished is not computed again.
    import nrsfm.experiments

    monkeypatch.setattr(nrsfm.experiments, "experiment_names", lambda: ["time", "noise"])
    monkeypatch.setattr("nrsfm.experiments.noise.Noise.cells", lambda self, scope: 1 / 0)
    code, said, err = command("experiment", "all", *QUICK, "--out", out, "--page", tmp_path / "page" / "r.md")
    assert code == 1  # a fault in one experiment does not stop the others
    assert "a fault of nrsfm in 'noise': division by zero" in err
    assert {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()} == times
    assert "ZeroDivisionError" in (out / "report.html").read_text()
    assert "images/results/time.png" in (tmp_path / "page" / "r.md").read_text()
    assert (tmp_path / "page" / "images" / "results" / "time.png").is_file()


def test_ctrl_c_is_130_and_leaves_what_is_done(tmp_path):
    words = [sys.executable, "-m", "nrsfm.cli", "experiment", "noise", *QUICK, "--out", str(tmp_path)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while not list((tmp_path / "cells").glob("[!.c]*.json")) and time.monotonic() < end and process.poll() is None:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.strip().splitlines()[-1] == "nrsfm: interrupted"
    assert list((tmp_path / "cells").glob("*.json"))
    assert not (tmp_path / "noise.csv").exists()


def test_the_terminal_shows_the_time_left():
    import io

    from nrsfm.cli.counting import Counting, duration
    from nrsfm.experiments.runner import Progress

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    state = Progress(3, 10, 1, 200.0, ("bmm on pickup",))
    shown = Terminal()
    with Counting("noise", shown) as counting:
        counting(state)
        counting._display.refresh()
    assert "3/10" in shown.getvalue()
    assert "about 3 min left, 1 without numbers, bmm on pickup" in shown.getvalue()
    plain = io.StringIO()
    with Counting("noise", plain) as counting:
        counting(state)
        counting(state)
    assert plain.getvalue() == "noise: 3 of 10 cells, about 3 min left, 1 without numbers, bmm on pickup\n"
    assert [duration(s) for s in (0.2, 80, 200, 6000)] == ["1 s", "80 s", "3 min", "1 h 40 min"]
