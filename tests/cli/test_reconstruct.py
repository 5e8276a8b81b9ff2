import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from nrsfm.reconstruction import load_reconstruction


def names(folder):
    return sorted(os.listdir(folder))


def test_output_is_complete(command, pipeline, tracks_file, tmp_path):
    out = tmp_path / "deep" / "out"
    code, shown, err = command("reconstruct", tracks_file, "--out", out, "--truth", tracks_file, "--no-pictures")
    assert (code, err) == (0, "")
    assert names(out) == ["config.json", "log.txt", "metrics.json", "reconstruction.npz"]
    assert names(tmp_path / "deep") == ["out"]
    assert "5 frames, 8 points" in shown
    assert "warning" in shown
    assert "the camera does not turn" in shown
    assert load_reconstruction(out / "reconstruction.npz").shapes.shape == (5, 8, 3)


def test_configuration_records_everything(command, pipeline, tracks_file, tmp_path):
    import hashlib

    words = ["reconstruct", tracks_file, "--out", tmp_path / "a b", "--seed", "7", "--threads", "1"]
    code, _, _ = command(*words, "--subspaces", "5", "--no-pictures", "--camera-method", "rigid")
    config = json.loads((tmp_path / "a b" / "config.json").read_text())
    assert code == 0
    assert config["command"].startswith("nrsfm reconstruct ")
    assert "'" in config["command"]  # quoted, so that it can be pasted
    assert config["tracks"]["sha256"] == hashlib.sha256(tracks_file.read_bytes()).hexdigest()
    assert (config["seed"], config["threads"], config["method"]) == (7, 1, "auto")
    assert config["options"] == {
        "rank": None,
        "tolerance": 1e-3,
        "subspaces": 5,
        "spatial": True,
        "camera_method": "rigid",
        "mirror": False,
        "shift": 0.0,
    }
    assert {"nrsfm", "python", "numpy", "scipy"} <= config["versions"].keys()
    assert config["cameras"] == "estimated"


def test_metrics_have_every_alignment(command, pipeline, tracks_file, tmp_path):
    words = ("reconstruct", tracks_file, "--out", tmp_path / "o", "--truth", tracks_file, "--no-pictures")
    assert command(*words)[0] == 0
    metrics = json.loads((tmp_path / "o" / "metrics.json").read_text())
    assert list(metrics["shape_error"]) == ["none", "global", "per-frame", "similarity"]
    assert metrics["shape_error"]["none"] >= metrics["shape_error"]["per-frame"] > 0
    assert metrics["mocap_error"] > 0
    assert metrics["rotation_error_degrees"] == pytest.approx(0.0, abs=1e-4)


def test_known_cameras_are_handed_on(command, pipeline, tracks_file, tmp_path):
    words = ("reconstruct", tracks_file, "--out", tmp_path / "o", "--cameras", tracks_file, "--no-pictures")
    assert command(*words)[0] == 0
    assert pipeline.calls[0]["rotations"].shape == (5, 3, 3)


@pytest.mark.parametrize("where", [0, 1, 2])
def test_arguments_may_come_in_any_order(command, pipeline, tracks_file, tmp_path, where):
    groups = [
        ["--subspaces", "5"],
        ["--out", tmp_path / "o"],
        ["--no-pictures", "--mirror", "--rank", "auto"],
    ]
    groups.insert(where, [tracks_file])
    code, _, err = command("reconstruct", *(word for group in groups for word in group))
    assert (code, err) == (0, "")
    assert pipeline.calls == [
        {
            "method": "auto",
            "rotations": None,
            "seed": 0,
            "subspaces": 5,
            "mirror": True,
            "rank": None,
        }
    ]


def test_quiet_shows_nothing(command, pipeline, tracks_file, tmp_path):
    words = ("reconstruct", tracks_file, "--out", tmp_path / "o", "--quiet", "--no-pictures")
    assert command(*words) == (0, "", "")


def test_log_has_the_command_the_stages_and_the_warnings(command, pipeline, tracks_file, tmp_path):
    assert command("reconstruct", tracks_file, "--out", tmp_path / "o", "--no-pictures")[0] == 0
    log = (tmp_path / "o" / "log.txt").read_text()
    for text in (
        "nrsfm reconstruct",
        "reading files: ",
        "iterating: ",
        "writing: ",
        "WARNING",
        "does not turn",
    ):
        assert text in log


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--method", "bbm"], "unknown method 'bbm'; did you mean 'bmm'?"),
        (["--method", "zzzz"], "unknown method 'zzzz'; known are bmm, auto"),
        (["--subspace", "3"], "unknown option '--subspace'; did you mean '--subspaces'"),
        (["--method", "bmm", "--subspaces", "3"], "it belongs to auto and not to bmm"),
        (["--subspaces", "0"], "option 'subspaces' must be at least 1, received 0"),
        (["--tolerance", "0"], "option 'tolerance' must be greater than 0"),
        (
            ["--camera-method", "guess"],
            "option 'camera_method' must be one of intersection, rigid, received 'guess'",
        ),
        (["--seed", "-1"], "option '--seed' must be at least 0, received -1"),
        (["--threads", "0"], "option '--threads' must be at least 1, received 0"),
        (["--truth", "missing.npz"], "missing.npz"),
        (["--cameras", "missing.npz"], "missing.npz"),
        (["--image-size", "12"], "WIDTHxHEIGHT is needed, received '12'"),
    ],
)
def test_wrong_options_leave_nothing_behind(command, pipeline, tracks_file, tmp_path, words, text):
    code, out, err = command("reconstruct", tracks_file, "--out", tmp_path / "p" / "o", *words)
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1
    assert pipeline.calls == []
    assert names(tmp_path) == ["tracks.npz"]


def bad_inputs():
    good = np.zeros((3, 4, 2))
    yield "nan", {"tracks": np.full((3, 4, 2), np.nan)}
    yield "dimensions", {"tracks": np.zeros((3, 4))}
    yield "odd rows", {"W": np.zeros((5, 8))}
    yield "names", {"a": good, "b": good}
    yield "pickle", {"tracks": np.array([{}], dtype=object)}
    yield "complex", {"tracks": good.astype(complex)}
    yield "empty", {"tracks": good[:0]}


@pytest.mark.parametrize(("kind", "arrays"), list(bad_inputs()), ids=[kind for kind, _ in bad_inputs()])
def test_bad_inputs_leave_nothing_behind(command, pipeline, tmp_path, kind, arrays):
    np.savez(tmp_path / "in.npz", **arrays)
    code, out, err = command("reconstruct", tmp_path / "in.npz", "--out", tmp_path / "p" / "o")
    assert (code, out) == (2, "")
    assert err.startswith("nrsfm: error: ")
    assert err.count("\n") == 1
    assert names(tmp_path) == ["in.npz"]


def test_truncated_input(command, pipeline, tracks_file, tmp_path):
    tracks_file.write_bytes(tracks_file.read_bytes()[:200])
    code, _, err = command("reconstruct", tracks_file, "--out", tmp_path / "o")
    assert code == 2
    assert "tracks.npz" in err
    assert names(tmp_path) == ["tracks.npz"]


def test_truth_of_another_size_is_found_before_computing(command, pipeline, tracks_file, tmp_path):
    np.savez(tmp_path / "truth.npz", shapes=np.zeros((5, 9, 3)))
    code, _, err = command("reconstruct", tracks_file, "--out", tmp_path / "o", "--truth", tmp_path / "truth.npz")
    assert code == 2
    assert "truth: the input has 5 frames of 8 points, the truth has 5 frames of 9 points" in err
    assert pipeline.calls == []


def test_finished_output_is_kept_without_overwrite(command, pipeline, tracks_file, tmp_path):
    words = ("reconstruct", tracks_file, "--out", tmp_path / "o", "--no-pictures")
    assert command(*words)[0] == 0
    before = {name: (tmp_path / "o" / name).read_bytes() for name in names(tmp_path / "o")}
    code, out, err = command(*words, "--seed", "1")
    assert (code, out) == (2, "")
    assert "holds a finished output (to replace it: --overwrite" in err
    assert len(pipeline.calls) == 1  # refused before computing
    assert {name: (tmp_path / "o" / name).read_bytes() for name in names(tmp_path / "o")} == before
    assert command(*words, "--seed", "1", "--overwrite")[0] == 0
    assert json.loads((tmp_path / "o" / "config.json").read_text())["seed"] == 1
    assert names(tmp_path) == ["o", "tracks.npz"]


def test_overwrite_never_deletes_other_files(command, pipeline, tracks_file, tmp_path):
    code, _, err = command("reconstruct", tracks_file, "--out", tmp_path, "--overwrite")
    assert code == 2
    assert "it holds other files, which would be lost: tracks.npz" in err
    assert tracks_file.exists()
    assert pipeline.calls == []


@pytest.mark.parametrize("out", ["/proc/nrsfm-out", "/dev/null", "/dev/null/out", "tracks.npz", "tracks.npz/o"])
def test_paths_that_cannot_be_written_are_found_before_computing(command, pipeline, tracks_file, tmp_path, out):
    code, _, err = command("reconstruct", tracks_file, "--out", tmp_path / out)
    assert code == 2
    assert "cannot write" in err
    assert err.count("\n") == 1
    assert pipeline.calls == []


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ZeroDivisionError("x"), MemoryError("big")])
def test_whatever_stops_the_run_leaves_the_old_output(command, pipeline, tracks_file, tmp_path, error):
    def stop():
        raise error

    words = ("reconstruct", tracks_file, "--out", tmp_path / "o", "--no-pictures", "--overwrite")
    assert command(*words)[0] == 0
    pipeline.before = stop
    code, out, err = command(*words)
    assert code == (130 if isinstance(error, KeyboardInterrupt) else 1)
    assert out == ""
    assert err.count("\n") == 1
    assert names(tmp_path) == ["o", "tracks.npz"]
    assert len(names(tmp_path / "o")) == 3


def test_a_picture_that_fails_does_not_cost_the_result(command, pipeline, tracks_file, tmp_path, monkeypatch):
    def fail(*what):
        raise ZeroDivisionError("no colours")

    monkeypatch.setattr("nrsfm.cli.pictures.draw", fail)
    code, out, err = command("reconstruct", tracks_file, "--out", tmp_path / "o")
    assert (code, err) == (0, "")
    assert "not every picture could be drawn: no colours" in out
    assert "ZeroDivisionError" in (tmp_path / "o" / "log.txt").read_text()
    assert load_reconstruction(tmp_path / "o" / "reconstruction.npz").n_points == 8


@pytest.mark.parametrize("out", ["o", "o/"])
def test_pictures_of_tracks_alone(command, pipeline, tracks_file, tmp_path, out):
    code, shown, _ = command("reconstruct", tracks_file, "--out", f"{tmp_path}/{out}")
    assert code == 0
    assert "could be drawn" not in shown
    assert {"overview.png", "shapes.png", "tracks.png"} <= set(names(tmp_path / "o"))
    assert "error.png" not in names(tmp_path / "o")


# Runs the command with a pipeline that waits, in a process that takes Ctrl-C whatever its parent does.
WAITING = """
import signal, sys, time, types
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {tests!r})
import conftest, nrsfm
methods = types.ModuleType("nrsfm.methods")
methods.method_names, methods.get_method = (lambda: list(conftest.METHODS)), conftest.METHODS.__getitem__
pipeline = types.ModuleType("nrsfm.pipeline")
pipeline.STAGE_OPTIONS = conftest.STAGE_OPTIONS
sys.modules.update({{"nrsfm.methods": methods, "nrsfm.pipeline": pipeline}})
def wait(*args, **options):
    print("running", flush=True)
    time.sleep(60)
nrsfm.reconstruct = wait
from nrsfm.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("number", "code", "said"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_in_mid_run_leaves_nothing(tracks_file, tmp_path, number, code, said):
    script = WAITING.format(tests=os.path.dirname(__file__))
    process = subprocess.Popen(
        [sys.executable, "-c", script, "reconstruct", tracks_file, "--out", tmp_path / "p" / "o"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "running\n"
    assert len(names(tmp_path)) == 2  # the folder is being made
    time.sleep(0.05)
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == code
    assert err == f"nrsfm: {said}\n"
    assert names(tmp_path) == ["tracks.npz"]


def test_tracks_with_holes_become_a_result_with_holes(command, pipeline, monkeypatch, real_result, tmp_path):
    """Missing entries are counted, handed on, saved, scored, told and drawn, whatever the method made of them."""
    import nrsfm
    from nrsfm.viewing.style import save_figure

    seen = np.ones((6, 10), dtype=bool)
    seen[:, 9] = False
    seen[0, :2] = False
    points = np.where(seen[..., None], np.random.default_rng(0).uniform(0, 9, (6, 10, 2)), np.nan)
    np.savez(tmp_path / "t.npz", tracks=points, visible=seen)
    np.savez(tmp_path / "truth.npz", shapes=np.random.default_rng(1).standard_normal((6, 10, 3)))
    given = []

    def reconstruct(tracks, **options):
        given.append(tracks)
        return real_result

    monkeypatch.setattr(nrsfm, "reconstruct", reconstruct)
    monkeypatch.setattr("nrsfm.viewing.save_figure", lambda figure, path: save_figure(figure, path, dpi=20))
    monkeypatch.setattr("nrsfm.viewing.panels._PIXELS_PER_INCH", 20)
    out = tmp_path / "o"
    code, shown, err = command("reconstruct", tmp_path / "t.npz", "--out", out, "--truth", tmp_path / "truth.npz")
    assert (code, err) == (0, "")
    assert given[0].n_missing == 8
    for text in ("8 of 60 entries missing", "1 of 10 points not reconstructed", "9 of 10 points, 54 of 60 entries"):
        assert text in shown
    assert "could not be drawn" not in shown
    assert {"overview.png", "uncertainty.png", "error.png", "groups.png"} <= set(names(out))
    assert json.loads((out / "config.json").read_text())["tracks"]["missing"] == 8
    assert json.loads((out / "metrics.json").read_text())["scored_points"] == 9
    assert load_reconstruction(out / "reconstruction.npz").n_missing == 1
    assert command("reconstruct", tmp_path / "t.npz", "--out", out, "--overwrite", "--quiet")[0] == 0
