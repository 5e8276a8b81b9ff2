"""``nrsfm run`` on a tiny rendered video: every stage, what is skipped, what is repeated, and what is refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from nrsfm.cli.work import chosen_step

pytest.importorskip("av")
cv2 = pytest.importorskip("cv2")

FAST = ("--track-method", "dis", "--method", "geometry-aware", "--step", "3")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A rendered video of 10 frames of 64 x 64, masks and truth, in a folder with a name that is not plain."""
    from nrsfm.datasets.render_files import save_rendered
    from nrsfm.datasets.rendering import rendered

    folder = tmp_path_factory.mktemp("sets") / "ein Gesicht é"
    save_rendered(rendered("face-slow", size=64, frames=10, samples=1), folder, step=1)
    return folder


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory):
    """The folder of a whole run, made once; tests that change it copy it."""
    from nrsfm.cli import main

    out = tmp_path_factory.mktemp("runs") / "a run"
    words = ["run", scene / "video.mp4", "--mask", scene / "masks", "--truth", scene / "truth.npz", "--out", out, *FAST]
    with pytest.MonkeyPatch.context() as patched:  # drawing takes most of the time, and demo's tests draw
        patched.setattr("nrsfm.cli.pictures.draw", _drawn)
        assert main([str(word) for word in [*words, "--quiet"]]) == 0
    return out


def _drawn(folder, inputs, result, found, report):
    """In place of the pictures: what they would be drawn from fits together."""
    assert inputs.truth.shapes.shape == result.shapes.shape
    assert (inputs.tracks.n_points, inputs.unit) == (result.n_points, "px")
    assert inputs.faces.max() < result.n_points
    assert found["shape_error"]
    (folder / "overview.png").write_bytes(b"drawn")


def _again(finished, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(finished, copy)
    return copy


def _done(err: str) -> list[str]:
    """Names of the stages that were done, as the lines on stderr tell."""
    return [line.split()[2].rstrip(":") for line in err.splitlines() if ": done in " in line]


def test_every_stage_leaves_what_it_should(finished, scene):
    held = set(os.listdir(finished))
    assert held >= {"tracks.h5", "tracking.json", "reconstruction.npz", "config.json", "metrics.json", "truth.npz"}
    assert held >= {"model.glb", "report.html", "log.txt", "stages.json", "overview.png"}
    assert not [name for name in held if name.startswith(".")]
    config = json.loads((finished / "config.json").read_text(encoding="utf-8"))
    assert (config["method"], config["tracking"]["step"], config["video"]["frames"]) == ("geometry-aware", 3, 10)
    assert config["command"].startswith("nrsfm run ")
    found = json.loads((finished / "metrics.json").read_text())
    assert found["tracks"]["mean"] < 3  # pixels, of 64
    assert found["shape_error"]["per-frame"] < 0.5  # in the unit of the tracks: no scale is taken out
    assert found["tracks"]["points"] == found["scored_points"] + found["points"] - _reconstructed(finished)
    assert "<html" in (finished / "report.html").read_text(encoding="utf-8")[:500]
    assert (finished / "model.glb").read_bytes()[:4] == b"glTF"


def test_what_is_too_uncertain_is_left_out_and_the_noise_told(finished):
    import h5py

    import nrsfm
    from nrsfm.tracking import usable

    with h5py.File(finished / "tracks.h5") as file:
        tracks, level = usable(nrsfm.Tracks(file["tracks"][:], file["visible"][:]), file["deviation"][:])
        before = file["visible"][:].mean()
    result = nrsfm.load_reconstruction(finished / "reconstruction.npz")
    assert result.options["noise_level"] == pytest.approx(level)
    assert np.count_nonzero(result.confidence == 0) >= tracks.n_missing > (1 - before) * tracks.visible.size + 1


def _reconstructed(folder):
    import nrsfm

    result = nrsfm.load_reconstruction(folder / "reconstruction.npz")
    return result.n_points - result.n_missing


def test_the_truth_of_the_run_reads_as_a_truth(finished, command):
    code, out, _ = command("evaluate", finished / "reconstruction.npz", finished / "truth.npz", "--json")
    assert code == 0
    found = json.loads((finished / "metrics.json").read_text())
    assert json.loads(out)["shape_error"]["per-frame"] == pytest.approx(found["shape_error"]["per-frame"])


def test_what_is_done_is_skipped_and_a_change_repeats_what_builds_on_it(
    finished, scene, command, tmp_path, monkeypatch
):
    monkeypatch.setattr("nrsfm.viewing.report.make_report", lambda *given, **named: "<html>")
    out = _again(finished, tmp_path)
    words = ["run", scene / "video.mp4", "--mask", scene / "masks", "--out", out, *FAST]
    truth = ["--truth", scene / "truth.npz"]
    code, text, err = command(*words, *truth)
    assert (code, _done(err)) == (0, [])
    assert err.count("done before, unchanged") == 6
    assert "track error" in text
    assert "report" in text
    code, _, err = command(*words, *truth, "--export", "csv,ply", "--quiet")
    assert (code, err) == (0, "")
    assert (out / "model.csv").is_file()
    assert len(os.listdir(out / "model-ply")) >= 10
    assert not (out / "model.glb").exists()
    code, _, err = command(*words, *truth, "--export", "none", "--rank", "3", "--no-pictures")
    assert (code, _done(err)) == (0, ["reconstruct", "score", "report"])
    assert "other options: options" in err
    assert not (out / "model.csv").exists()
    assert not (out / "overview.png").exists()
    code, text, err = command(*words, "--export", "none", "--rank", "3", "--no-pictures", "--no-report")
    assert (code, _done(err)) == (0, [])
    assert "3D error" not in text
    assert {"metrics.json", "truth.npz", "report.html"}.isdisjoint(os.listdir(out))


def test_force_and_an_option_of_tracking_repeat_everything(finished, scene, command, tmp_path):
    out = _again(finished, tmp_path)
    words = ["run", scene / "video.mp4", "--mask", scene / "masks", "--out", out, "--no-pictures", "--no-report"]
    words += ["--export", "none", *FAST]
    assert _done(command(*words, "--track-likeness", "0.3")[2]) == ["track", "reconstruct"]
    assert _done(command(*words, "--track-likeness", "0.3", "--force")[2]) == ["track", "reconstruct"]


def test_the_folder_of_another_video_is_not_replaced_unasked(finished, scene, command, tmp_path):
    out = _again(finished, tmp_path)
    shutil.copytree(scene / "masks", tmp_path / "frames")
    code, _, err = command("run", tmp_path / "frames", "--out", out, *FAST)
    assert code == 2
    assert "holds the run of" in err
    assert "--force" in err
    assert err.count("\n") == 1
    shutil.copy(scene / "video.mp4", tmp_path / "same.mp4")  # another name, the same video
    words = ["run", tmp_path / "same.mp4", "--mask", scene / "masks", "--out", out, "--export", "none", "--no-pictures"]
    code, _, err = command(*words, "--no-report", *FAST)
    assert (code, _done(err)) == (0, [])


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_was_interrupted_goes_on(scene, command, tmp_path, how):
    out = tmp_path / "out"
    words = ["run", scene / "video.mp4", "--mask", scene / "masks", "--out", out, "--no-report", "--no-pictures"]
    words = [str(word) for word in [*words, *FAST, "--export", "none"]]
    slow = (
        "import sys, time, nrsfm, nrsfm.cli\n"
        "nrsfm.reconstruct = lambda *a, **k: (print('ready', flush=True), time.sleep(60))\n"
        "sys.exit(nrsfm.cli.main(sys.argv[1:]))"
    )
    words_of_child = [sys.executable, "-c", slow, *words]
    with subprocess.Popen(words_of_child, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "ready\n"
            child.send_signal(how)
            assert child.wait(20) == (130 if how == signal.SIGINT else -how)
        finally:
            child.kill()
    held = set(os.listdir(out))
    assert {"tracks.h5", "stages.json"} <= held
    assert "reconstruction.npz" not in held
    code, _, err = command(*words)
    assert (code, _done(err)) == (0, ["reconstruct"])
    assert not [name for name in os.listdir(out) if name.startswith(".")]


def test_tracks_without_shapes_are_scored_alone(scene, finished, command, tmp_path):
    out = _again(finished, tmp_path)
    with np.load(scene / "truth.npz") as held:
        arrays = {name: held[name] for name in ("tracks", "visible")}
    np.savez(tmp_path / "tracks only.npz", **arrays)
    words = ["run", scene / "video.mp4", "--mask", scene / "masks", "--out", out, "--no-pictures", "--no-report", *FAST]
    code, text, _ = command(*words, "--truth", tmp_path / "tracks only.npz")
    assert code == 0
    assert "track error" in text
    assert "3D error" not in text
    assert set(json.loads((out / "metrics.json").read_text())) == {"tracks"}


def _write(path, images):
    from nrsfm.video import write_video

    write_video(path, images, lossless=True)
    return path


def _moving(frames=8, side=48, seed=0):
    rng = np.random.default_rng(seed)
    picture = np.kron(rng.integers(0, 255, (side // 3, side // 3, 3), dtype=np.uint8), np.ones((3, 3, 1), np.uint8))
    return [np.roll(picture, f, axis=1) for f in range(frames)]


def _bad(kind, folder):
    path = folder / "bäd film.mkv"
    if kind == "no video stream":
        import wave

        with wave.open(str(folder / "bäd film.wav"), "wb") as sound:
            sound.setparams((1, 2, 8000, 800, "NONE", ""))
            sound.writeframes(b"\0\0" * 800)
        return folder / "bäd film.wav"
    if kind == "zero length":
        path.write_bytes(b"")
    elif kind == "nothing moves":
        _write(path, _moving()[:1] * 8)
    elif kind == "scene cut":
        _write(path, _moving(6, 96) + _moving(6, 96, seed=5))
    elif kind == "single frame":
        _write(path, _moving()[:1])
    elif kind == "resolutions":
        (folder / "bäd film").mkdir()
        for f, side in enumerate((48, 48, 60)):
            cv2.imencode(".png", _moving(1, side)[0])[1].tofile(folder / "bäd film" / f"{f}.png")
        return folder / "bäd film"
    elif kind == "tracks":
        path = folder / "bäd film.npz"
        np.savez(path, tracks=np.zeros((3, 5, 2)))
    return path


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("no video stream", "video"),
        ("zero length", "bäd film.mkv"),
        ("nothing moves", "must move"),
        ("scene cut", "scene cut"),
        ("single frame", "two frames"),
        ("resolutions", "size"),
        ("tracks", "nrsfm reconstruct takes it"),
        ("missing", "no such file"),
    ],
)
def test_a_bad_video_is_one_line_and_leaves_nothing(command, tmp_path, kind, words):
    path = _bad(kind, tmp_path)
    before = sorted(os.listdir(tmp_path))
    code, out, err = command("run", path, "--out", tmp_path / "new" / "out", "--quiet")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert "bäd film" in err
    assert sorted(os.listdir(tmp_path)) == before


def test_a_mask_of_another_size(scene, command, tmp_path):
    cv2.imencode(".png", np.full((40, 64), 255, np.uint8))[1].tofile(tmp_path / "mask.png")
    code, _, err = command(
        "run", scene / "video.mp4", "--mask", tmp_path / "mask.png", "--out", tmp_path / "o", "--quiet"
    )
    assert code == 2
    assert "64 x 64" in err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--step", "0"), "'--step' must be a whole number"),
        (("--export", "gbl"), "did you mean 'glb'"),
        (("--track-method", "sub"), "'--track-method' must be one of"),
        (("--track-rank", "0"), "rank"),
        (("--trak-rank", "3"), "did you mean '--track-rank'"),
        (("--reference", "first"), "'--reference'"),
        (("--method", "bm"), "unknown method"),
        (("--truth", "nowhere.npz"), "nowhere.npz"),
        (("--mask", "nowhere.png"), "nowhere.png"),
        (("--overwrite",), "unknown option"),
    ],
)
def test_a_wrong_option_is_found_before_anything_is_done(scene, command, tmp_path, words, said):
    code, out, err = command("run", scene / "video.mp4", "--out", tmp_path / "o", "--quiet", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not (tmp_path / "o").exists()


def test_a_folder_of_something_else_stays_as_it_is(scene, command, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    code, _, err = command("run", scene / "video.mp4", "--out", tmp_path / "mine")
    assert code == 2
    assert "letter.txt" in err
    assert os.listdir(tmp_path / "mine") == ["letter.txt"]


def test_the_step_grows_with_the_object_and_the_frames():
    assert chosen_step(480 * 480, 99) == 6
    assert chosen_step(55_272, 99) == 3
    assert chosen_step(2_000, 99) == 1
    for area, frames in ((10**4, 50), (10**6, 300), (10**5, 5000)):
        step = chosen_step(area, frames)
        allowed = max(800_000 / frames, 1_000)
        assert area / step**2 <= allowed < (area / (step - 1) ** 2 if step > 1 else np.inf)


def test_the_time_left_is_that_of_the_stage_where_its_steps_are_known(monkeypatch):
    import io

    from nrsfm.cli.stage_progress import StageProgress

    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    stream = io.StringIO()
    with StageProgress(2, stream) as line:
        line.begin("track", "not done yet", {"first": 0.25, "second": 0.75})
        now[0] += 40
        line("first", 1.0)
        now[0] += 40
        line("second", 1 / 3)  # half of the stage in 80 s
        line.end()
        line.begin("other", "")
        line("unknown", None)
        now[0] += 40
        line("unknown", 0.25)
    told = stream.getvalue()
    assert "second 50 %, about 80 s left\n" in told
    assert "unknown 25 %, about 2 min left in this step" in told
    assert "1/2 track: done in 80.0 s" in told
