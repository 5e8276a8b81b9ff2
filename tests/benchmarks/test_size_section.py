"""The section about size: tracks with a truth at any number of points, scores in stretches, targets that can fail."""

import dataclasses

import numpy as np
import pytest
from benchmarks import long_task, size, size_data, size_parts, store, targets
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


def _long_rows(error, peak, seconds):
    """Rows of the part about long sequences, all alike but for the whole with noise."""
    rows = []
    for method in size_parts.LONG_METHODS:
        for noise in size_parts.LONG_NOISE:
            for frames in (*size_parts.LONG_FRAMES, 0):
                run = {"start": 0, "seconds": 9.0, "peak_bytes": 2e9, "per-frame": 0.01, "global": 0.02}
                run |= {"discarded": 1e-6, "virtual_points": 300, "directions": 90, "cut": 1e-5, "key_frames": None}
                if noise and frames == long_task.FRAMES:
                    run |= {"seconds": seconds, "peak_bytes": peak, "per-frame": error}
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
        "long": {"rows": _long_rows(long_error, long_peak, long_seconds)},
        "ten-million": {"large": _row(size.MILLIONS, options={"memory": "4GB"}, peak_bytes=peak)},
        "speed": {"runs": {"face": {"seconds": [solve], "cells": 50}}, "svd": [1.0]},
        "grid": {"rows": [_row(size.FEW)]},
    }
    assert parts.keys() == size_parts.PARTS.keys()
    records = {name: part | {"code": "now", "others": 0.0} for name, part in parts.items()}
    return {"records": records, "others": 0.0, "threads": 2}


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
        ({"long_peak": 8.1e9}, {"4030: peak memory"}),
        ({"long_error": 0.0106}, {"`geometry-aware`: error / mean", "`auto`: error / mean"}),
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


def test_parts_that_are_missing_or_failed_have_no_number():
    empty = {"records": {}, "others": None, "threads": 2}
    assert not any(check.passed for check in size.checks(empty))
    assert "\n".join(size.render(empty)).count("was not measured") == len(size_parts.PARTS)
    values = _values()
    values["records"]["actor"] = {"error": "TaskError: no", "code": "now", "others": 0.0}
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
