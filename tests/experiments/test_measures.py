"""Measures against quantities worked out by hand."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nrsfm.datasets.sequence import Sequence
from nrsfm.datasets.synthetic import camera_rotations
from nrsfm.errors import InputError
from nrsfm.experiments import worker
from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.kept import plain
from nrsfm.experiments.measures import Measured, get_measure
from nrsfm.tracks import Tracks

RNG = np.random.default_rng(0)
F, P = 5, 12
SHAPES = RNG.standard_normal((F, P, 3))
SHAPES -= SHAPES.mean(axis=1, keepdims=True)
ROTATIONS = camera_rotations("fast", F)
POINTS = np.einsum("fij,fpj->fpi", ROTATIONS[:, :2], SHAPES)


def sequence(**changes):
    note = {"camera": "orthographic", "frame": "object"}
    return replace(Sequence("made", Tracks(POINTS), SHAPES, ROTATIONS, note=note), **changes)


def result(shapes=SHAPES, rotations=ROTATIONS, **changes):
    values = {
        "shapes": shapes,
        "rotations": rotations,
        "scales": np.ones(F),
        "translations": np.zeros((F, 2)),
        "groups": None,
        "method": "bmm",
        "diagnostics": {
            "seconds": {"cameras": 1.0, "bmm": 2.0},
            "iterations": 3,
            "cameras": {"rank": 2, "candidates": []},
        },
    }
    return SimpleNamespace(**(values | changes))


def measured(tmp_path, of=None, **changes):
    found = Measured(of or result(), sequence(), Cell(Data("made"), "bmm"), 4.0, 1000, None, tmp_path, "stem")
    return replace(found, **changes)


def test_a_perfect_answer_has_no_error(tmp_path):
    m = measured(tmp_path)
    assert all(value < 1e-7 for value in get_measure("errors")(m).values())
    assert get_measure("rotation")(m) < 1e-5
    assert get_measure("reprojection")(m) < 1e-12
    assert get_measure("shape_fit")(m) < 1e-7
    assert get_measure("groups")(m) is None
    assert get_measure("seconds")(m) == {"total": 4.0, "cameras": 1.0, "method": 2.0, "shared_cameras": None}
    assert (get_measure("memory")(m), get_measure("iterations")(m)) == (1000, 3)
    assert get_measure("camera_report")(m)["rank"] == 2


def test_a_turned_answer_is_right_after_one_alignment(tmp_path):
    turn = camera_rotations("pan90", 3)[2]
    m = measured(tmp_path, result(SHAPES @ turn.T, ROTATIONS @ turn.T))
    errors = get_measure("errors")(m)
    assert errors["none"] > 0.5
    assert max(errors[name] for name in ("global", "per-frame", "camera-frame")) < 1e-7


def test_a_shrunk_answer_misses_by_what_is_missing(tmp_path):
    m = measured(tmp_path, result(0.9 * SHAPES))
    assert get_measure("shape_fit")(m) == pytest.approx(0.1)
    assert get_measure("reprojection")(m) == pytest.approx(0.1)
    errors = get_measure("errors")(m)
    assert errors["similarity"] < 1e-7
    assert errors["per-frame"] == pytest.approx(0.1)


def test_alignments_without_a_meaning_have_no_number(tmp_path):
    perspective = sequence(note={"camera": "perspective", "frame": "object"}, rotations=None)
    errors = get_measure("errors")(measured(tmp_path, sequence=perspective))
    assert errors["similarity"] < 1e-7
    assert [name for name, value in errors.items() if value is None] == ["none", "global", "per-frame", "camera-frame"]
    seen = np.einsum("fij,fpj->fpi", ROTATIONS, SHAPES)
    camera = sequence(note={"camera": "orthographic", "frame": "camera"}, shapes=seen, rotations=None)
    m = measured(tmp_path, sequence=camera)
    errors = get_measure("errors")(m)
    assert errors["none"] is errors["global"] is get_measure("rotation")(m) is None
    assert errors["camera-frame"] < 1e-7
    nothing = measured(tmp_path, sequence=sequence(shapes=None, rotations=None))
    assert set(get_measure("errors")(nothing).values()) == {None}
    assert get_measure("shape_fit")(nothing) is None


def test_points_without_truth_do_not_count(tmp_path):
    shapes, valid = SHAPES.copy(), np.ones((F, P), dtype=bool)
    shapes[1, 3] = np.nan
    valid[1, 3] = False
    m = measured(tmp_path, sequence=sequence(shapes=shapes, valid=valid))
    assert max(get_measure("errors")(m).values()) < 1e-7
    assert get_measure("shape_fit")(m) < 1e-7


def test_translations_and_scales_are_part_of_the_reprojection(tmp_path):
    moved = Tracks(2.0 * POINTS + 7.0)
    fits = result(scales=np.full(F, 2.0), translations=np.full((F, 2), 7.0))
    assert get_measure("reprojection")(measured(tmp_path, fits, sequence=sequence(tracks=moved))) < 1e-12
    assert get_measure("reprojection")(measured(tmp_path, sequence=sequence(tracks=moved))) > 0.4


def test_errors_are_those_of_the_metrics(tmp_path):
    from nrsfm.metrics import camera_frame_error, frame_errors, shape_error

    rough = SHAPES + 0.1 * RNG.standard_normal(SHAPES.shape) + RNG.standard_normal((F, 1, 3))
    m = measured(tmp_path, result(rough.astype(np.float32), camera_rotations("slow", F)))
    errors = get_measure("errors")(m)
    for name in ("none", "global", "per-frame", "similarity"):
        assert errors[name] == pytest.approx(shape_error(rough, SHAPES, name), rel=1e-6)
    assert errors["camera-frame"] == pytest.approx(camera_frame_error(m.result, SHAPES, ROTATIONS), rel=1e-6)
    sizes = np.linalg.norm(SHAPES, axis=(1, 2))
    fit = np.linalg.norm(frame_errors(rough, SHAPES, "per-frame") * sizes) / np.linalg.norm(sizes)
    assert get_measure("shape_fit")(m) == pytest.approx(fit, rel=1e-6)
    valid = RNG.uniform(size=(F, P)) < 0.7
    errors = get_measure("errors")(replace(m, sequence=sequence(valid=valid)))
    assert errors["global"] == pytest.approx(shape_error(rough, SHAPES, "global", valid=valid), rel=1e-6)


def test_unknown_measures_are_explained():
    with pytest.raises(InputError, match="did you mean 'errors'"):
        get_measure("error")


def test_arrays_are_kept_beside_the_record(tmp_path):
    said = measured(tmp_path).keep("shapes", shapes=SHAPES)
    assert said == {"arrays": "stem-shapes.npz"}
    with np.load(tmp_path / "stem-shapes.npz") as found:
        np.testing.assert_array_equal(found["shapes"], SHAPES)


def test_records_are_plain_json():
    value = {
        "a": np.float32(1.5),
        "b": [np.nan, np.inf, np.int64(2)],
        "c": np.arange(3),
        4: (True, None),
        "e": SHAPES.dtype,
    }
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "a": 1.5, "b": [None, None, 2], "c": [0, 1, 2], "4": [True, None], "e": "float64",
    }  # fmt: skip


def test_cells_survive_the_way_to_a_process():
    cell = Cell(Data("a", 0.1, 2, points=3), "bmm", "known", (("x", 1), ("y", (1, 2))), ("errors",), True)
    assert worker.cell_from_json(json.loads(json.dumps(worker.cell_to_json(cell)))) == cell


def test_what_is_raised_becomes_one_line(tmp_path):
    cell = Cell(Data("made"), "bmm", "known", measures=("seconds",))
    hidden = sequence(rotations=None)
    assert worker.run_cell(cell, hidden, tmp_path, "x") == {
        "frames": F,
        "points": P,
        "error": "the true cameras of 'made' are not known",
    }
    assert worker.in_one_line(ValueError("two\nlines")) == "ValueError: two lines"
    one_place = sequence(tracks=Tracks(0.0 * POINTS))
    assert "all equal" in worker.run_cell(replace(cell, cameras="own"), one_place, tmp_path, "x")["error"]


def test_memory_is_what_the_call_adds(tmp_path, monkeypatch):
    if worker._held_bytes() is None or not worker._reset_peak():
        pytest.skip("this kernel does not tell")
    import nrsfm

    def hungry(*_, **__):
        block = np.ones(25_000_000)  # 200 MB for a moment
        del block
        return result()

    monkeypatch.setattr(nrsfm, "reconstruct", hungry, raising=False)
    before = np.ones(20_000_000)  # held before, not counted
    cell = Cell(Data("made"), "bmm", measures=("memory",))
    found = worker.run_cell(cell, sequence(), tmp_path, "x")["memory"]
    assert 190e6 < found < 260e6
    del before


def test_a_mesh_goes_to_the_methods_that_take_one():
    from nrsfm.methods import get_method, method_names

    faces = np.array([[0, 1, 2]])
    for name in method_names():
        takes = "faces" in getattr(get_method(name).Options, "__dataclass_fields__", {})
        given = worker._mesh(Cell(Data("made"), name), sequence(faces=faces))
        assert list(given) == (["faces"] if takes else [])
        assert worker._mesh(Cell(Data("made"), name), sequence()) == {}
