"""``nrsfm datasets --render``: a video anybody can make, with its masks and truth."""

import json
import os

import numpy as np
import pytest

import nrsfm

pytest.importorskip("av")
pytest.importorskip("cv2")


def test_a_rendered_video_has_masks_and_truth(command, tmp_path):
    words = ("datasets", "--render", "sheet", "--size", "48", "--frames", "4", "--out", tmp_path / "a é", "--json")
    code, out, _ = command(*words)
    assert code == 0
    found = json.loads(out)
    assert sorted(os.listdir(tmp_path / "a é")) == ["masks", "truth.npz", "video.mp4"]
    from nrsfm.video import open_frames, read_mask

    with open_frames(found["video"]) as frames:
        assert frames.shape == (4, 48, 48)
        masks = read_mask(found["masks"], frames)
    tracks = nrsfm.load_tracks(found["truth"])
    with np.load(found["truth"]) as held:
        np.testing.assert_allclose(tracks.points[found["reference"]], held["pixels"], atol=1e-3)
        assert masks[found["reference"], held["pixels"][:, 1], held["pixels"][:, 0]].all()
        # In pixels: an orthographic camera shows x and y of the turned shape, up to its place in the image.
        f = found["reference"]
        shown = held["shapes"][f] @ held["rotations"][f, :2].T
    away = tracks.points[f] - shown
    np.testing.assert_allclose(away, np.broadcast_to(away.mean(axis=0), away.shape), atol=0.05)
    code, _, err = command(*words)
    assert (code, "--overwrite" in err) == (2, True)
    assert command(*words, "--overwrite", "--lossless")[0] == 0
    assert len(os.listdir(tmp_path / "a é" / "frames")) == 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--render", "sheet"), "--out DIR"),
        (("--out", "x"), "--render SCENE"),
        (("--render", "fase", "--out", "x"), "did you mean 'face'"),
        (("--render", "sheet", "--out", "x", "--variant", "plane"), "did you mean 'plain'"),
        (("--render", "sheet", "--out", "x", "--size", "3"), "size"),
        (("--render", "sheet", "--out", "x", "--seed", "-1"), "--seed"),
    ],
)
def test_what_is_wrong_is_one_line(command, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = command("datasets", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not os.listdir(tmp_path)
