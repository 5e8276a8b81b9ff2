"""The mesh that came with the tracks, for methods that want neighbours."""

import json

import numpy as np
import pytest

from nrsfm.cli import main


@pytest.fixture
def folder(tmp_path):
    """Tracks of a bending strip with its faces in the same file."""
    rows, columns = np.mgrid[:5, :6] - 2.0
    time = np.linspace(0, 1.5, 8)
    shapes = np.stack([np.stack([columns, rows, 0.2 * (1 + t) * columns**2], -1).reshape(-1, 3) for t in time])
    turns = np.stack([[[np.cos(t), 0, np.sin(t)], [0, 1, 0]] for t in time])
    corner = np.flatnonzero(((columns < 3) & (rows < 2)).ravel())
    faces = np.column_stack([corner, corner + 1, corner + 7, corner + 6])
    np.savez(tmp_path / "tracks.npz", tracks=np.einsum("fij,fpj->fpi", turns, shapes), faces=faces)
    np.save(tmp_path / "grid.npy", np.column_stack([columns.ravel(), rows.ravel()]).astype(int))
    return tmp_path


def run(folder, *words):
    out = folder / f"out{len(list(folder.iterdir()))}"
    words = ["reconstruct", str(folder / "tracks.npz"), "--out", str(out), "--no-pictures", "--quiet", *words]
    assert main(words) == 0
    return json.loads((out / "config.json").read_text()), (out / "log.txt").read_text()


def test_it_is_used_where_the_method_has_use_for_it_and_said(folder):
    config, log = run(folder, "--method", "ds")
    assert config["faces"] == "came with the tracks"
    assert config["options"]["faces"].startswith("array (20, 4)")
    assert "faces: the 20 that came with the tracks" in log
    config, log = run(folder, "--method", "bmm")
    assert "faces" not in config
    assert "came with" not in log


def test_what_is_given_comes_first(folder):
    config, _ = run(folder, "--method", "dv", "--grid", str(folder / "grid.npy"))
    assert "faces" not in config
    assert config["options"]["grid"].startswith("array (30, 2)")
    assert config["options"]["faces"] is None
    config, _ = run(folder, "--method", "ds", "--faces", "auto")
    assert config["options"]["faces"] is None
