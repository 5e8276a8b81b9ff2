import json
import os

import pytest


def names(folder):
    return sorted(os.listdir(folder))


def test_demo_makes_a_scored_output(command, pipeline, tmp_path):
    out = tmp_path / "d"
    words = ("demo", "--out", out, "--frames", "6", "--points", "30", "--noise", "0.01", "--no-pictures")
    code, shown, err = command(*words, "--camera", "pan30", "--seed", "3", "--method", "bmm")
    assert (code, err) == (0, "")
    assert names(out) == ["config.json", "log.txt", "metrics.json", "reconstruction.npz"]
    assert "6 frames, 30 points" in shown
    config = json.loads((out / "config.json").read_text())
    assert config["tracks"].items() >= {"sequence": "face", "noise": 0.01, "camera": "pan30", "seed": 3}.items()
    assert json.loads((out / "metrics.json").read_text())["rotation_error_degrees"] > 1
    assert pipeline.calls[0]["rotations"] is None


def test_demo_with_the_true_cameras(command, pipeline, tmp_path):
    words = (
        "demo",
        "--frames",
        "6",
        "--points",
        "30",
        "--out",
        tmp_path / "d",
        "--known-cameras",
        "--no-pictures",
    )
    assert command(*words)[0] == 0
    assert json.loads((tmp_path / "d" / "metrics.json").read_text())["rotation_error_degrees"] < 1e-3


@pytest.mark.parametrize("words", [["--frames", "1"], ["--points", "2"], ["--noise", "-1"], ["--camera", "pan"]])
def test_demo_of_the_impossible(command, pipeline, tmp_path, words):
    code, out, err = command("demo", "--out", tmp_path / "d", *words)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert names(tmp_path) == []
