"""The command with the real methods, on small sequences."""

import json
import os

import numpy as np
import pytest

import nrsfm
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.reconstruction import load_reconstruction
from nrsfm.stages.run_folder import OUTPUT_NAMES


@pytest.fixture(scope="module")
def sequence():
    return face_sequence(frames=20, points=150, camera="pan90", seed=1)


@pytest.fixture
def files(sequence, tmp_path):
    np.savez(tmp_path / "tracks.npz", tracks=sequence.tracks.points)
    np.savez(tmp_path / "truth.npz", shapes=sequence.shapes, rotations=sequence.rotations)
    return tmp_path / "tracks.npz", tmp_path / "truth.npz"


def test_demo_draws_every_picture(command, tmp_path):
    code, out, err = command("demo", "--frames", "12", "--points", "400", "--out", tmp_path / "d")
    assert (code, err) == (0, "")
    assert "could be drawn" not in out
    assert set(os.listdir(tmp_path / "d")) == set(OUTPUT_NAMES) - {"groups.png"}  # which some methods only have
    assert json.loads((tmp_path / "d" / "metrics.json").read_text())["shape_error"]["per-frame"] < 0.1


@pytest.mark.parametrize("method", nrsfm.method_names())
def test_every_method_has_help_without_clashes(command, method):
    for verb in ("reconstruct", "demo"):
        code, out, err = command(verb, "--method", method, "--help")
        assert (code, err) == (0, "")
        assert f"options of the method {method}" in out


@pytest.mark.parametrize("method", nrsfm.method_names())
def test_every_method_reconstructs_with_known_cameras(command, files, tmp_path, method):
    tracks, truth = files
    words = ("reconstruct", tracks, "--out", tmp_path / "o", "--method", method, "--truth", truth)
    assert command(*words, "--cameras", truth, "--no-pictures")[0] == 0
    metrics = json.loads((tmp_path / "o" / "metrics.json").read_text())
    assert metrics["shape_error"]["per-frame"] < 0.06
    assert metrics["rotation_error_degrees"] < 1e-3


def test_same_input_options_and_seed_give_the_same_output(command, files, tmp_path):
    for name in ("a", "b"):
        words = ("reconstruct", files[0], "--out", tmp_path / name, "--no-pictures", "--threads", "1")
        assert command(*words)[0] == 0
    first, second = (load_reconstruction(tmp_path / name / "reconstruction.npz") for name in ("a", "b"))
    np.testing.assert_array_equal(first.shapes, second.shapes)
    np.testing.assert_array_equal(first.rotations, second.rotations)
    configs = [json.loads((tmp_path / name / "config.json").read_text()) for name in ("a", "b")]
    assert configs[0].pop("command") != configs[1].pop("command")
    assert configs[0] == configs[1]


def test_the_two_solutions_are_seen_the_same(command, files, tmp_path):
    for name, flag in (("a", "--no-mirror"), ("b", "--mirror")):
        words = ("reconstruct", files[0], "--out", tmp_path / name, "--no-pictures", "--threads", "1", flag)
        assert command(*words, "--method", "bmm", "--precision", "float64")[0] == 0
    first, second = (load_reconstruction(tmp_path / name / "reconstruction.npz") for name in ("a", "b"))
    other = first.mirrored()
    scale = np.abs(first.shapes).max()
    np.testing.assert_allclose(second.camera_shapes(), other.camera_shapes(), atol=1e-6 * scale)


def test_the_configuration_makes_the_same_run_in_python(command, files, tmp_path):
    words = ("reconstruct", files[0], "--out", tmp_path / "o", "--method", "bmm", "--seed", "4")
    assert command(*words, "--no-pictures", "--threads", "1", "--gamma", "0.01")[0] == 0
    config = json.loads((tmp_path / "o" / "config.json").read_text())
    saved = load_reconstruction(tmp_path / "o" / "reconstruction.npz")
    tracks = nrsfm.load_tracks(files[0])
    again = nrsfm.reconstruct(tracks, method=config["method"], seed=config["seed"], **config["options"])
    np.testing.assert_allclose(again.shapes, saved.shapes, atol=1e-5 * np.abs(saved.shapes).max())
