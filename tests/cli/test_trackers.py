"""Files of point trackers from the command line."""

import json

import numpy as np

POINTS = np.random.default_rng(0).uniform(0, 200, (5, 8, 2))
SEEN = np.random.default_rng(1).random((5, 8)) < 0.9


def test_info_and_reconstruct_read_them(command, pipeline, tmp_path):
    path = tmp_path / "tapir é.npz"
    np.savez(path, tracks=POINTS.swapaxes(0, 1) / 2 + 0.5, visibles=SEEN.T)
    given = ("--tracker", "tapir", "--image-size", "400x400", "--seen-size", "200x200")
    code, out, _ = command("info", path, "--json", *given)
    assert code == 0
    found = json.loads(out)
    assert (found["kind"], found["frames"], found["points"], found["missing"]) == ("tracks", 5, 8, int((~SEEN).sum()))
    assert command("reconstruct", path, "--out", tmp_path / "o", "--no-pictures", "--quiet", *given)[0] == 0
    config = json.loads((tmp_path / "o" / "config.json").read_text(encoding="utf-8"))
    assert config["tracks"]["missing"] == int((~SEEN).sum())


def test_a_wrong_tracker_and_a_pickle_are_one_line(command, tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, tracks=POINTS)
    for words in ((path, "--tracker", "tapvid"), (path, "--tracker", "raft"), (path, "--seen-size", "2x2")):
        code, out, err = command("reconstruct", *words, "--out", tmp_path / "o")
        assert (code, out, err.count("\n")) == (2, "", 1)
    (tmp_path / "a.pkl").write_bytes(b"\x80\x04.")
    code, _, err = command("info", tmp_path / "a.pkl")
    assert (code, err.count("\n")) == (2, 1)
    assert "numpy.savez" in err
