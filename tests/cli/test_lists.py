"""``info``, ``methods`` and ``datasets``."""

import json

import numpy as np
import pytest

from nrsfm.cli.text import table


def test_info_of_tracks(command, tracks_file):
    code, out, err = command("info", tracks_file)
    assert (code, err) == (0, "")
    for text in ("kind         tracks", "tracks, shapes, cameras", "float64 5x8x2"):
        assert text in out


def test_info_as_json(command, tracks_file):
    _, out, _ = command("info", "--json", tracks_file)
    found = json.loads(out)
    assert (found["kind"], found["frames"], found["points"], found["missing"]) == ("tracks", 5, 8, 0)


def test_info_of_a_reconstruction(command, pipeline, tracks_file, tmp_path):
    assert command("reconstruct", tracks_file, "--out", tmp_path / "o", "--no-pictures")[0] == 0
    code, out, _ = command("info", tmp_path / "o" / "reconstruction.npz")
    assert code == 0
    for text in ("reconstruction", "auto", "the camera does not turn"):
        assert text in out


def test_info_of_a_reconstruction_of_real_tracks(command, real_result, tmp_path):
    real_result.save(tmp_path / "r.npz")
    code, out, err = command("info", tmp_path / "r.npz")
    assert (code, err) == (0, "")
    for text in ("8 entries, 13.33 %", "1 of 10 points", "median 0.5, 95 % below 0.5", "nose towards the camera"):
        assert text in out
    found = json.loads(command("info", tmp_path / "r.npz", "--json")[1])
    assert (found["not_reconstructed"], found["missing"], found["depth_deviation"]["median"]) == (1, 8, 0.5)


def test_info_of_a_damaged_file_is_an_error(command, tracks_file):
    content = bytearray(tracks_file.read_bytes())
    content[300] ^= 0xFF  # within the numbers of the first array
    tracks_file.write_bytes(content)
    code, out, err = command("info", tracks_file)
    assert (code, out) == (2, "")
    assert err.startswith("nrsfm: error: cannot read ")
    assert err.count("\n") == 1


def test_info_of_something_else_lists_what_is_there(command, tmp_path):
    np.savez(tmp_path / "x.npz", apples=np.zeros((2, 3)), pears=np.zeros(4))
    code, out, _ = command("info", tmp_path / "x.npz")
    assert code == 0
    for text in ("kind       unknown", "apples float64 2x3", "pears float64 4"):
        assert text in out


def test_info_of_no_file(command, tmp_path):
    code, out, err = command("info", tmp_path / "x.npz")
    assert (code, out) == (2, "")
    assert "x.npz" in err


def test_methods(command, pipeline):
    code, out, err = command("methods")
    assert (code, err) == (0, "")
    header, _, first, *_ = out.splitlines()
    assert header.split() == ["method", "year", "assumes", "needs", "cost"]
    assert first.split() == ["bmm", "2012", "nothing", "complete", "tracks", "none"]
    _, out, _ = command("methods", "--json")
    found = json.loads(out)
    assert [method["name"] for method in found] == ["bmm", "auto"]
    assert (found[0]["needs"], found[0]["camera_method"]) == ("complete tracks", "intersection")


@pytest.mark.parametrize("width", [60, 100, 500])
def test_tables_keep_every_word_and_the_width(width):
    rows = [["bmm", "2014", "few modes in all, and cameras that turn", "2F²P once"], ["a", "1", "", "x " * 40]]
    text = table(["name", "year", "assumes", "cost"], rows, width)
    assert max(map(len, text.splitlines())) <= width
    for row in rows:
        for cell in row:
            for word in cell.split():
                assert word in text


def test_datasets_say_which_are_here(command, monkeypatch, tmp_path):
    monkeypatch.delenv("NRSFM_DATA", raising=False)
    (tmp_path / "pickup.npz").write_bytes(b"")
    code, out, _ = command("datasets", "--data", tmp_path, "--json")
    found = {row["name"]: row["here"] for row in json.loads(out)["datasets"]}
    assert code == 0
    assert found["pickup"] is True
    assert found["yoga"] is False
    code, out, _ = command("datasets")
    assert code == 0
    assert "no folder was given" in out
    monkeypatch.setenv("NRSFM_DATA", str(tmp_path))
    assert f"folder: {tmp_path}" in command("datasets")[1]


def test_datasets_of_no_folder(command, tmp_path):
    code, _, err = command("datasets", "--data", tmp_path / "none")
    assert code == 2
    assert err.count("\n") == 1
