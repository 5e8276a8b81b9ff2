"""The section about size: tracks with a truth at any number of points, scores in stretches, targets that can fail."""

import dataclasses
import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import long_task, page, size, size_data, size_long, size_parts, store, targets
from benchmarks.children import TaskError, run_task
from benchmarks.size_data import Size, surface, write_tracks
from benchmarks.size_scores import Moments, errors_of

from nrsfm import datasets, shape_error


@pytest.fixture
def stretches(monkeypatch):
    """Short stretches, so that a small surface has several."""
    monkeypatch.setattr(size_data, "_CHUNK_BYTES", 24 * 99 * 2000)


def test_a_subdivided_surface_is_that_of_the_data_sets(data_root, stretches, tmp_path):
    whole = datasets.load("ict-rom99", data_root, subdivide=1, dtype=np.float32)
    made = surface(Size(26_534, 99, "subdivided"))
    assert len(list(made.chunks())) > 10
    write_tracks(made, tmp_path / "tracks.npy")
    written = np.load(tmp_path / "tracks.npy", mmap_mode="r")
    assert written.dtype == np.float32
    assert written.flags.c_contiguous
    np.testing.assert_allclose(written, whole.tracks.points, atol=2e-5)
    np.testing.assert_allclose(made.truth(700, 1500), whole.shapes[:, 700:1500], atol=2e-5)
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.npy"]


@pytest.mark.parametrize(("points", "kind"), [(9_000, "shuffled"), (9_000, "random"), (6_706, "vertices")])
def test_tracks_are_the_truth_as_the_cameras_see_it(data_root, points, kind):
    with np.load(data_root / "ict_sequences.npz") as motion:
        rotations = motion["rotations_rom99"].astype(np.float64)
    made = surface(Size(points, 99, kind))
    truth = made.truth(0, points)
    np.testing.assert_allclose(made.tracks(0, points), np.einsum("fij,fpj->fpi", rotations[:, :2], truth), atol=1e-12)
    np.testing.assert_array_equal(made.truth(123, 456), truth[:, 123:456])
    np.testing.assert_array_equal(surface(made.size).tracks(50, 60), made.tracks(50, 60))
    assert len(np.unique(truth[0].round(9), axis=0)) > 0.999 * points


def test_neighbours_are_spread_over_a_shuffled_file(data_root):
    plain, mixed = (surface(Size(9_000, 25, kind)).truth(0, 9_000)[0] for kind in ("subdivided", "shuffled"))
    for axis in range(3):
        np.testing.assert_allclose(np.sort(plain[:, axis]), np.sort(mixed[:, axis]))
    steps = [np.median(np.linalg.norm(np.diff(shape, axis=0), axis=1)) for shape in (plain, mixed)]
    assert steps[1] > 5 * steps[0]


def test_shorter_sequences_are_frames_of_the_longer_take(data_root):
    whole, part = surface(Size(6_706, 346, "vertices")), surface(Size(6_706, 173, "vertices"))
    np.testing.assert_array_equal(part.truth(0, 50), whole.truth(0, 50)[::2])


@pytest.mark.parametrize("bad", [Size(6_706, 347), Size(6_707, 99, "vertices"), Size(10, 99, "round")])
def test_sizes_that_cannot_be_made_are_refused(data_root, bad):
    with pytest.raises(ValueError, match="received"):
        surface(bad)


def test_scores_in_stretches_are_those_of_the_whole(data_root, tmp_path, stretches):
    made = surface(Size(6_706, 99, "vertices"))
    truth = made.truth(0, 6_706)
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    estimate = (truth + 0.02 * truth.std() * rng.normal(size=truth.shape)) @ turn + 40.0
    np.save(tmp_path / "shapes.npy", estimate.astype(np.float32))
    shapes = np.load(tmp_path / "shapes.npy", mmap_mode="r")
    found = errors_of(shapes, made.truth, made.chunks())
    assert len(list(made.chunks())) > 3
    for align, value in found.items():
        assert value == pytest.approx(shape_error(shapes, truth, align), rel=1e-9)
    assert found["global"] == pytest.approx(found["per-frame"], rel=1e-3)


@pytest.mark.parametrize("align", ["none", "global", "per-frame"])
def test_moments_of_any_shapes(align):
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(4, 40, 3)) * [3, 2, 1] + 7
    estimate = truth + rng.normal(size=truth.shape)
    moments = Moments(4)
    for start in range(0, 40, 7):
        moments.add(estimate[:, start : start + 7], truth[:, start : start + 7])
    assert moments.error(align) == pytest.approx(shape_error(estimate, truth, align), abs=1e-12)


def test_one_measurement_in_a_process_of_its_own(data_root, tmp_path):
    small = Size(1_500, 30)
    write_tracks(surface(small), tmp_path / "tracks.npy")
    given = {"file": str(tmp_path / "tracks.npy"), "mapped": False, "shapes_file": None, "rounds": 2, "score": True}
    options = {"deviation": False, "spatial_cells": 5}
    given |= {"size": dataclasses.asdict(small), "method": "geometry-aware", "options": options}
    row = run_task("size_task", given)
    assert len(row["seconds"]) == len(row["stages"]) == len(row["gram"]) == len(row["svd"]) == 2
    assert row["cells"] == 5
    assert row["peak_bytes"] >= row["baseline_bytes"] > 1e7
    assert 0 < row["errors"]["per-frame"] <= row["errors"]["global"] < 0.5
    assert size._stage_medians(row).keys() >= {"compression", "the rest"}


def _row(made, seconds=1.0, **other):
    row = {"size": dataclasses.asdict(made), "seconds": [seconds], "flush": 0.5, "peak_bytes": 2e9, "read": 0.1}
    row |= {"stages": [{"geometry-aware": 0.3, "cameras": 0.2}], "iterations": 10, "gram": [0.1], "svd": [1.0]}
    row |= {"baseline_bytes": 1e8, "virtual_points": 700, "cells": 50, "errors": {"per-frame": 0.02, "global": 0.03}}
    return row | {"options": {}, "method": "geometry-aware", "warnings": []} | other


def _long_rows(error, turned, peak, seconds):
    """Rows of the part about long sequences, all alike but for the whole with noise."""
    rows = []
    for method in size_parts.LONG_METHODS:
        for noise in size_parts.LONG_NOISE:
            for frames in (*size_parts.LONG_FRAMES, 0):
                run = {"start": 0, "seconds": 9.0, "peak_bytes": 2e9, "per-frame": 0.01, "global": 0.02}
                run |= {"discarded": 1e-6, "virtual_points": 300, "directions": 90, "cut": 1e-5, "key_frames": None}
                if noise and frames == long_task.FRAMES:
                    run |= {"seconds": seconds, "peak_bytes": peak, "per-frame": error, "global": turned}
                runs = [run] if frames else [run] * long_task.PIECES
                rows.append({"method": method, "noise": noise, "frames": frames, "runs": runs})
    return rows


def _values(
    large=1.0,
    error=0.02,
    expansion=0.3,
    iteration=0.3,
    peak=2e9,
    solve=0.9,
    long_error=0.01,
    long_turned=0.02,
    long_peak=2e9,
    long_seconds=9.0,
):
    growing = [{"geometry-aware": iteration, "cameras": 0.2, "expansion": expansion}]
    few = _row(size.FEW, stages=[{"geometry-aware": 0.3, "cameras": 0.2, "expansion": 0.08}], seconds=0.6)
    many = _row(size.MANY, stages=growing, seconds=0.22 + expansion + iteration)
    parts = {
        "actor": {
            "large": _row(size.ACTOR, large, errors={"per-frame": error, "global": 0.03}),
            "small": _row(size.VERTICES),
        },
        "growth": {"few": few, "many": many, "fresh": many, "file": many},
        "long": {"rows": _long_rows(long_error, long_turned, long_peak, long_seconds)},
        "ten-million": {"large": _row(size.MILLIONS, options={"memory": "4GB"}, peak_bytes=peak)},
        "speed": {"runs": {"face": {"seconds": [solve], "cells": 50}}, "svd": [1.0]},
        "grid": {"rows": [_row(size.FEW)]},
    }
    assert parts.keys() == size_parts.PARTS.keys()
    records = {name: part | {"code": "now", "date": "2000-01-01", "others": 0.0} for name, part in parts.items()}
    return {"records": records, "others": 0.0, "threads": 2}


@pytest.fixture(autouse=True)
def no_page(monkeypatch, tmp_path):
    """Nothing is known of an earlier page."""
    monkeypatch.setattr(store, "PAGE", tmp_path / "benchmarks.md")


@pytest.mark.parametrize(
    ("worse", "missed"),
    [
        ({}, set()),
        ({"large": 299.6}, {"from file to file"}),
        ({"error": 0.0205}, {"difference of the error"}),
        ({"error": 0.0195}, {"difference of the error"}),
        ({"expansion": 0.41}, {"what grows"}),
        ({"iteration": 0.4}, {"time of an iteration"}),
        ({"peak": 4.1e9}, {"10,000,000 × 100: peak memory"}),
        ({"solve": 1.01}, {"one dense SVD"}),
        ({"long_seconds": 601.0}, {"longest time"}),
        ({"long_peak": 8.1e9}, {"4,030: peak memory"}),
        ({"long_error": 0.0106}, {"`geometry-aware`: error / mean", "`auto`: error / mean"}),
        ({"long_turned": 0.0211}, {"`geometry-aware`: error with one", "`auto`: error with one"}),
    ],
)
def test_each_target_can_be_missed(worse, missed):
    values = _values(**worse)
    found = [check.what for check in size.checks(values) if not check.passed]
    assert len(found) == len(missed)
    assert all(any(words in what for what in found) for words in missed)
    text = "\n".join(size.render(values))
    assert text.count("✗") == len(missed)
    assert "1,180,232 × 346" in text
    assert "`memory='4GB'`" in text


def test_only_stages_that_grow_count_and_time_in_no_stage_counts_too():
    values = _values(expansion=0.3)
    growing = size._growing(values["records"]["growth"])
    assert growing == {"expansion": pytest.approx(0.3)}
    values["records"]["growth"]["many"]["seconds"] = [5.0]
    assert size._growing(values["records"]["growth"])["the rest"] == pytest.approx(5.0 - 0.8)


def test_earlier_records_say_nothing_of_the_memory_they_worked_in():
    values = _values()
    assert "keeps the memory" in "\n".join(size.render(values))
    del values["records"]["growth"]["fresh"]
    assert "keeps the memory" not in "\n".join(size.render(values))


def test_parts_that_are_missing_or_failed_have_no_number():
    empty = {"records": {}, "others": None, "threads": 2}
    assert not any(check.passed for check in size.checks(empty))
    assert "\n".join(size.render(empty)).count("**Not measured.**") == len(size_parts.PARTS)
    values = _values()
    values["records"]["actor"] = {"error": "TaskError: no", "code": "now", "date": "2000-01-01", "others": 0.0}
    assert sum(check.value is None for check in size.checks(values)) == 3


def test_a_part_is_measured_again_only_when_asked_failed_or_old(tmp_path, monkeypatch):
    calls = []

    def part(name):
        def measured(folder):
            calls.append(name)
            assert folder.is_dir()
            (folder / "data").write_text("x")
            if name == "grid":
                raise TaskError("no room")
            return {"rows": []}

        return measured

    monkeypatch.setattr(size, "PARTS", {name: part(name) for name in ("actor", "grid")})
    monkeypatch.setattr(store, "OUTPUT", tmp_path / "kept")
    monkeypatch.setattr(store, "data_folder", lambda: tmp_path)
    monkeypatch.setattr(store, "code_digest", lambda *_: "now")
    monkeypatch.setenv("NRSFM_SCRATCH", str(tmp_path / "scratch"))
    values = size.measure(store.Context())
    assert values["records"]["grid"]["error"] == "no room"
    assert store.read("size")["values"] == values
    assert list((tmp_path / "scratch").iterdir()) == [], "data sets are deleted"
    size.measure(store.Context())
    assert calls == ["actor", "grid", "grid"]
    size.measure(store.Context(only=("actor",), fresh=True))
    assert calls == ["actor", "grid", "grid", "actor"]
    monkeypatch.setattr(store, "code_digest", lambda *_: "newer")
    size.measure(store.Context(only=("actor",)))
    assert calls[4:] == ["actor"]


def test_the_targets_are_those_of_the_project():
    assert (targets.SIZE_SECONDS, targets.SIZE_MEMORY, targets.SIZE_ERROR) == (300.0, 8.0, 2.0)
    assert (targets.SIZE_PASS, targets.SIZE_BUDGET, targets.SIZE_SVD) == (4.0, 4.0, 1.0)
    assert (targets.SIZE_LONG_SECONDS, targets.SIZE_LONG_ERROR) == (600.0, 1.05)


def test_the_cameras_of_the_long_take_are_those_that_the_page_names():
    from scipy.spatial.transform import Rotation

    angle = 2 * np.pi * np.arange(4030) / 345
    turns = [("z", 6 * np.sin(1.7 * angle + 1)), ("x", 18 * np.sin(4.3 * angle + 0.4)), ("y", 45 * np.sin(3 * angle))]
    z, x, y = (Rotation.from_euler(axis, degrees[:, None], degrees=True) for axis, degrees in turns)
    np.testing.assert_allclose(long_task.cameras(4030), (z * x * y).as_matrix(), atol=1e-12)
    assert size_long.CAMERAS in "\n".join(size.render(_values()))


@pytest.fixture
def short_take(data_root, monkeypatch, capsys):
    """Run the task on few frames and points in place of the take; gives its rows, and what it loaded."""
    made = surface(Size(1_500, 120))
    loaded = {}

    def load(name, folder, **options):
        loaded.update(options, name=name)
        tracks = SimpleNamespace(points=made.tracks(0, 1_500).astype(options["dtype"]))
        return SimpleNamespace(tracks=tracks, shapes=made.truth(0, 1_500))

    monkeypatch.setattr(long_task, "datasets", SimpleNamespace(load=load))
    for name, value in {"FRAMES": 120, "PIECE": 30, "PIECES": 4}.items():
        monkeypatch.setattr(long_task, name, value)

    def run(**settings):
        monkeypatch.setattr(
            "sys.stdin", io.StringIO(json.dumps({"method": "geometry-aware", "noise": 0.01} | settings))
        )
        long_task.main()
        return json.loads(capsys.readouterr().out)["rows"], loaded

    return run


def test_the_long_take_is_measured_from_its_beginning_and_in_pieces(short_take):
    whole, loaded = short_take(frames=60)
    assert (loaded["name"], loaded["noise"], loaded["dtype"]) == ("ict-take3", 0.01, "float32")
    assert loaded["rotations"].shape == (120, 3, 3)
    pieces, _ = short_take(frames=0)
    assert [run["start"] for run in whole] == [0]
    assert [run["start"] for run in pieces] == [0, 30, 60, 90]
    for run in [*whole, *pieces]:
        assert 0 < run["per-frame"] <= run["global"] < 0.1
        assert 0 < run["discarded"] < 0.01
        assert run["peak_bytes"] >= run["loaded_bytes"] > 1e7
        assert run["seconds"] >= sum(run["stages"].values()) > 0
    rows = [{"method": "bmm", "noise": 0.01, "frames": n, "runs": runs} for n, runs in ((60, whole), (0, pieces))]
    lines = [line for line in size_long.render({"rows": rows}) if line.startswith("| `bmm` | 1% noise | ")]
    assert len(lines) == 2


def test_every_length_of_the_long_take_is_measured_for_every_method_and_noise(monkeypatch, tmp_path):
    asked = []

    def run(module, given):
        assert module == "long_task"
        asked.append((given["method"], given["noise"], given["frames"]))
        whole = {"noise": given["noise"], "frames": given["frames"]}
        return {"rows": next(row["runs"] for row in _long_rows(0.01, 0.02, 2e9, 9.0) if whole.items() <= row.items())}

    monkeypatch.setattr(size_parts, "run_task", run)
    part = size_parts.PARTS["long"](tmp_path)
    lengths = (346, 1000, 2000, 4030, 0)
    assert asked == [(m, n, f) for m in ("geometry-aware", "auto") for n in (0.0, 0.01) for f in lengths]
    assert all(check.passed for check in size_long.checks(part))
    lines = [line for line in size_long.render(part) if line.startswith("| `")]
    assert len(lines) == len(asked)
    assert sum("10 pieces of 99" in line for line in lines) == 4


@pytest.fixture
def kept(monkeypatch, tmp_path):
    """Write the page of this section alone, from some of its parts, on a machine; gives its text."""
    monkeypatch.setattr(page, "SECTIONS", {"size": size})
    monkeypatch.setattr(page, "in_words", lambda machine: machine["name"])
    monkeypatch.setattr(store, "ROOT", tmp_path)
    monkeypatch.setattr(store, "OUTPUT", tmp_path / "kept")
    monkeypatch.setattr(store, "code_digest", lambda *_: "now")

    def write(values, machine, *names):
        monkeypatch.setattr(store, "machine", lambda: {"name": machine})
        store.write("size", values | {"records": {name: values["records"][name] for name in names}})
        page.write_page()
        return store.PAGE.read_text(encoding="utf-8")

    return write


def _below(text, part):
    return text.split(f"### {size.PAGE_PARTS[part].title}\n\n")[1].split("\n#")[0].strip()


def test_parts_that_are_not_measured_again_stay_on_the_page_with_their_targets(kept):
    first = kept(_values(expansion=0.41, large=301.0), "old machine", *size_parts.PARTS)
    second = kept(_values(long_seconds=601.0), "new machine", "long")
    for name in size_parts.PARTS:
        old, new = (_below(text, name).split("\n") for text in (first, second))
        if name == "long":
            assert "Kept" not in "".join(new)
            assert "601.0" in "".join(new)
        else:
            assert [line for line in new if "Kept from" not in line] == [*old[:1], "", *old[1:]]
            assert sum("Kept from" in line and line.endswith(": old machine") for line in new) == 1
    missed = [line for line in second.splitlines() if line.startswith("- ")]
    assert [("from file to file" in line, "what grows" in line, "longest" in line) for line in missed] == [
        (True, False, False),
        (False, True, False),
        (False, False, True),
    ]
    assert second.count("no number") == 0
    checks = len(size.checks(_values()))
    assert f"| Any size | {checks - 3} of {checks} | ✗ |" in second
    assert kept(_values(long_seconds=601.0), "new machine", "long") == second, (
        "written again from itself it is the same"
    )
    third = kept(_values(), "third machine", "actor", "growth")
    assert "Kept" not in _below(third, "actor")
    assert _below(third, "grid") == _below(second, "grid")
    assert "new machine" in _below(third, "long")


def test_a_part_that_fails_where_it_is_measured_again_is_not_kept(kept):
    values = _values()
    kept(values, "old machine", *size_parts.PARTS)
    values["records"]["speed"] = {"error": "no room", "code": "now", "date": "2000-01-02", "others": 0.0}
    text = kept(values, "new machine", "speed")
    assert _below(text, "speed") == "**Not measured.**"
    assert "- Any size: speed: no room" in text
    assert text.count("no number ✗") == 2
    assert "Not measured" not in _below(text, "actor")
