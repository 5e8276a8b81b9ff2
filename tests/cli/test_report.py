"""``nrsfm report``: the page and the animation of a folder, and what is refused."""

import json
import os

import numpy as np
import pytest

import nrsfm


@pytest.fixture
def made(command, pipeline, tmp_path):
    """A finished run of the stand-in, made from a file beside it."""
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "spuren 1.npz", tracks=100 + 30 * rng.normal(size=(6, 40, 2)))
    out = tmp_path / "Lauf é 1"
    words = ("reconstruct", tmp_path / "spuren 1.npz", "--order", "frame-first", "--out", out)
    code, _, err = command(*words, "--no-pictures", "--method", "bmm")
    assert (code, err) == (0, "")
    return out


def test_a_page_is_made_once(command, made):
    code, out, err = command("report", made)
    assert (code, err) == (0, "")
    assert "report.html" in out
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "Lauf é 1" in page
    assert "spuren 1.npz" in page
    assert '<h2 id="fit">' in page
    code, out, err = command("report", made)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "exists" in err
    assert "--overwrite" in err
    assert command("report", made, "--overwrite", "--quiet", "--title", "Ein Titel")[:2] == (0, "")
    assert "<h1>Ein Titel</h1>" in (made / "report.html").read_text(encoding="utf-8")


def test_another_place_and_an_animation(command, made, tmp_path, monkeypatch):
    monkeypatch.setattr("nrsfm.viewing.animation.panels._FINER", 1)  # coarse, and fast
    monkeypatch.setattr("nrsfm.viewing.animation.PACE", {".gif": (4, 70)})
    page, film = tmp_path / "neu" / "s & p.html", tmp_path / "ein film.gif"
    code, out, _ = command("report", made, "--animation", film)
    assert code == 0
    assert film.stat().st_size < 2e6
    assert "pixels" in out
    assert not (made / "report.html").exists()  # only what was asked for
    assert command("report", made, "--animation", film, "--out", page)[0] == 2
    assert not page.exists()  # refused before anything was made
    assert command("report", made, "--animation", film, "--out", page, "--overwrite")[0] == 0
    assert page.exists()


def test_tracks_that_changed_or_went_are_not_used(command, made, tmp_path):
    place = tmp_path / "spuren 1.npz"
    moved = tmp_path / "anders.npz"
    place.rename(moved)
    code, out, _ = command("report", made)
    assert code == 0
    assert "no longer at" in out
    assert "--tracks</code> FILE" in (made / "report.html").read_text(encoding="utf-8")
    code, out, _ = command("report", made, "--overwrite", "--tracks", moved, "--order", "frame-first")
    assert (code, "left out" in out) == (0, False)
    np.savez(place, tracks=np.zeros((6, 40, 2)))
    code, out, _ = command("report", made, "--overwrite")
    assert code == 0
    assert "has changed since the run" in out


def test_a_run_may_be_made_again_over_its_report(command, made, tmp_path):
    assert command("report", made)[0] == 0
    words = ("reconstruct", tmp_path / "spuren 1.npz", "--order", "frame-first", "--out", made, "--method", "bmm")
    assert command(*words, "--no-pictures", "--overwrite")[0] == 0
    assert not (made / "report.html").exists()  # it was of the old run


def test_results_without_a_record_have_a_page(command, made, tmp_path):
    for name in ("config.json", "log.txt"):
        (made / name).unlink()
    assert command("report", made)[0] == 0
    (made / "config.json").write_text(json.dumps({"tracks": 3, "command": 5, "options": [], "versions": "x"}))
    assert command("report", made, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "x.pdf"], "must end in .html"),
        (["--animation", "x.png"], "must end in .gif, .webp or .mp4"),
        (["--fps", "0"], "--fps"),
        (["--megabytes", "nan"], "--megabytes"),
        (["--tracks", "none.npz"], "none.npz"),
        (["--truth", "none.npz"], "none.npz"),
        (["--images", "none.mp4"], "none.mp4"),
        (["--faces", "grid:3x3"], "grid"),
    ],
)
def test_what_cannot_be_is_one_line(command, made, words, said):
    code, out, err = command("report", made, *words)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert said in err
    assert not (made / "report.html").exists()


def test_folders_that_are_no_runs(command, tmp_path, made):
    (tmp_path / "leer").mkdir()
    for folder, said in (("fehlt", "no such folder"), ("leer", "reconstruction.npz"), ("spuren 1.npz", "a file")):
        code, out, err = command("report", tmp_path / folder)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert said in err


def test_tracks_of_another_run_are_refused(command, made, tmp_path):
    np.savez(tmp_path / "other.npz", tracks=np.random.default_rng(1).normal(size=(6, 39, 2)))
    code, _, err = command("report", made, "--tracks", tmp_path / "other.npz", "--order", "frame-first")
    assert code == 2
    assert "6 frames of 40 points" in err


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_that_may_not_be_written(command, made):
    made.chmod(0o500)
    try:
        code, _, err = command("report", made)
    finally:
        made.chmod(0o700)
    assert code == 2
    assert "cannot write" in err


def test_a_place_that_cannot_be_written(command, made, tmp_path):
    (tmp_path / "datei").write_text("x")
    code, _, err = command("report", made, "--out", tmp_path / "datei" / "r.html")
    assert code == 2
    assert "cannot write" in err
    assert sorted(p.name for p in made.iterdir()) == ["config.json", "log.txt", "reconstruction.npz"]
    assert nrsfm.load_reconstruction(made / "reconstruction.npz").n_frames == 6
