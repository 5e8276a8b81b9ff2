"""The call and the command: whole files or none, one line for what is wrong, names of every kind."""

import json

import numpy as np
import pytest
from PIL import Image

import nrsfm.export as export
from nrsfm.cli import main
from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.export.options import FORMATS

from .conftest import COLUMNS, ROWS

GRID = f"grid:{ROWS}x{COLUMNS}"
NAMES = {"ply": "out", "obj": "out", "glb": "x.glb", "usd": "x.usdc", "npz": "x.npz", "csv": "x.csv"}


@pytest.fixture
def command(capsys):
    def run(*words):
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture
def saved(holed, tmp_path):
    folder = tmp_path / "rün of today"
    folder.mkdir()
    holed.save(folder / "reconstruction.npz")
    return folder


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_is_written_whole_or_not_at_all(result, tmp_path, monkeypatch, form):
    from nrsfm.export.scene import Scene

    original, calls = Scene.still_points, []

    def fails_later(self, frame):
        calls.append(frame)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return original(self, frame)

    monkeypatch.setattr(Scene, "still_points", fails_later)
    if form == "glb":
        monkeypatch.setattr("nrsfm.export.gltf._mesh", fails_later)
        calls += [0] * 4
    target = tmp_path / "new" / NAMES[form]
    with pytest.raises(KeyboardInterrupt):
        export.write(result, target, format=form)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", FORMATS)
def test_nothing_is_replaced_unasked(result, tmp_path, form):
    target = tmp_path / "dir with space ñ" / NAMES[form]
    export.write(result, target, format=form)
    before = sorted((p.name, p.stat().st_mtime_ns) for p in target.parent.rglob("*"))
    with pytest.raises(FileError, match="--overwrite"):
        export.write(result, target, format=form)
    assert sorted((p.name, p.stat().st_mtime_ns) for p in target.parent.rglob("*")) == before
    found = export.write(result, target, format=form, overwrite=True)
    assert (found.frames, found.points, found.left_out) == (7, 48, 0)


@pytest.mark.parametrize("form", ["glb", "npz", "csv"])
def test_the_same_call_gives_the_same_bytes(result, tmp_path, form):
    paths = [tmp_path / f"{k}{FORMATS[form].extensions[0]}" for k in range(2)]
    for path in paths:
        export.write(result, path, faces="auto", colours="groups")
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_a_folder_with_other_things_is_never_replaced(result, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("mine")
    with pytest.raises(FileError, match=r"thesis\.txt"):
        export.write(result, tmp_path / "out", format="ply", overwrite=True)
    assert (tmp_path / "out" / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"format": "gltf"}, "unknown format 'gltf'; did you mean"),
        ({"format": "fbx"}, "known are ply, obj, glb, usd, npz, csv"),
        ({"format": "usd"}, "ends in .usdc or .usda or .usd, received"),
        ({"fps": 0}, "'fps' must be a finite number greater than 0"),
        ({"fps": float("nan")}, "'fps'"),
        ({"frame": "world"}, "'frame' must be one of object, camera"),
        ({"axes": "x-up"}, "'axes' must be one of"),
        ({"reference": 7}, "from 0 to 6, received 7"),
        ({"reference": -1}, "'reference' must be a whole number of at least 0"),
        ({"scale": 0}, "'scale'"),
        ({"scale": 1e-60}, "'scale'"),
        ({"tolerance": 0}, "'tolerance'"),
        ({"criterion": "mean"}, "'criterion'"),
        ({"targets": -1}, "'targets'"),
        ({"targets": 2.5}, "'targets'"),
        ({"layout": "tall"}, "'layout'"),
        ({"image_size": (640, 0)}, "'image_size'"),
        ({"image_size": 640}, "'image_size'"),
    ],
)
def test_options_out_of_range_are_explained_and_nothing_is_written(result, tmp_path, options, text):
    with pytest.raises(InputError, match=text):
        export.write(result, tmp_path / "new" / "x.glb", **options)
    assert list(tmp_path.iterdir()) == []


def test_names_that_say_no_format(result, tmp_path):
    with pytest.raises(OptionError, match="the format must be named"):
        export.write(result, tmp_path / "x")
    with pytest.raises(OptionError, match="a folder is needed"):
        export.write(result, tmp_path / "x.ply", format="ply")
    with pytest.raises(OptionError, match="a name"):
        export.write(result, "", format="ply")
    with pytest.raises(InputError, match="a Reconstruction is needed, received ndarray"):
        export.write(result.shapes, tmp_path / "x.glb")


def test_image_and_mask_must_agree(result, tmp_path):
    image, mask = np.zeros((480, 640, 3), dtype=np.uint8), np.ones((240, 320), dtype=np.uint8)
    with pytest.raises(InputError, match="640 × 480, received 320 × 240"):
        export.write(result, tmp_path / "x.glb", image=image, mask=mask, faces="auto")


def test_read_only_and_memory_mapped_shapes(result, tmp_path):
    import dataclasses

    np.save(tmp_path / "shapes.npy", result.shapes)
    mapped = dataclasses.replace(result, shapes=np.load(tmp_path / "shapes.npy", mmap_mode="r"))
    for form, name in NAMES.items():
        export.write(mapped, tmp_path / form / name, format=form, faces="auto")


def test_progress_goes_to_its_end(result, tmp_path):
    calls = []
    export.write(result, tmp_path / "out", format="ply", progress=lambda stage, part: calls.append((stage, part)))
    assert calls[0] == ("surface", None)
    assert calls[-1] == ("writing", 1.0)


def test_the_command_writes_and_tells(command, saved, tmp_path):
    Image.fromarray(np.zeros((480, 640, 3), dtype=np.uint8)).save(tmp_path / "bild ä.png")
    target = tmp_path / "out put ß.glb"
    words = ["export", saved, "--out", target, "--faces", "auto", "--image", tmp_path / "bild ä.png", "--fps", "30"]
    code, out, err = command(*words)
    assert (code, err) == (0, "")
    lines = dict(line.split("  ", 1) for line in out.splitlines())
    assert lines["points"].strip() == "46; 2 without a shape left out"
    assert lines["frames"].strip() == "7, 30 a second"
    assert "triangles in frame" in lines["surface"]
    assert "left out: rms" in lines["targets"]
    code, out, err = command(*words)
    assert (code, out) == (2, "")
    assert "--overwrite" in err
    assert err.count("\n") == 1
    code, out, _ = command(*words, "--overwrite", "--json", "--targets", "1")
    assert code == 0
    assert json.loads(out)["truncation"]["targets"] == 1


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_by_command(command, saved, tmp_path, form):
    words = ["--format", form, "--out", tmp_path / NAMES[form], "--frame", "camera"]
    code, out, err = command("export", saved / "reconstruction.npz", *words)
    assert (code, err) == (0, "")
    assert f"output   {tmp_path / NAMES[form]}" in out
    assert command("export", saved, *words, "--overwrite", "--quiet") == (0, "", "")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--format", "fbx", "--out", "x"], "unknown format 'fbx'"),
        (["--out", "x.abc"], "the format must be named"),
        (["--format", "glb"], "--out"),
        (["--out", "x.glb", "--faces", "grid:2x2"], "must be the number of points, 48"),
        (["--out", "x.glb", "--faces", "none.npz"], "none.npz"),
        (["--out", "x.glb", "--image", "none.png"], "cannot read 'none.png'"),
        (["--out", "x.glb", "--mask", "none.png"], "cannot read 'none.png'"),
        (["--out", "x.glb", "--colours", "image"], "the image of the reference frame is needed"),
        (["--out", "x.glb", "--fps", "-1"], "'fps'"),
        (["--out", "x.glb", "--colors", "depth"], "did you mean '--colours'"),
    ],
)
def test_what_is_wrong_is_one_line_and_code_2(command, saved, tmp_path, monkeypatch, words, text):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    code, out, err = command("export", saved, *words)
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1
    assert list((tmp_path / "here").iterdir()) == []


def test_the_reconstruction_itself_is_never_replaced(command, saved):
    before = (saved / "reconstruction.npz").read_bytes()
    code, _, err = command("export", saved, "--out", saved / "reconstruction.npz", "--overwrite")
    assert code == 2
    assert "another file than the reconstruction itself" in err
    assert (saved / "reconstruction.npz").read_bytes() == before


def test_files_that_are_no_reconstruction(command, tmp_path):
    for name, content in (("empty.npz", b""), ("other.npz", b"PK")):
        (tmp_path / name).write_bytes(content)
        code, _, err = command("export", tmp_path / name, "--out", tmp_path / "x.glb")
        assert code == 2
        assert "is not a reconstruction" in err
    assert command("export", tmp_path, "--out", tmp_path / "x.glb")[0] == 2
