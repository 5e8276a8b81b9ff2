"""The sections about the default method: tracks made on purpose, scores that can fail, kept results, tables."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import (
    ablation,
    auto,
    auto_speed,
    calibration,
    never_worse,
    robust,
    runs,
    scores,
    store,
    targets,
    tracks,
)
from benchmarks.tracks import Data, sequence_of

from nrsfm import Tracks, datasets
from nrsfm.datasets import Sequence


@pytest.fixture(autouse=True)
def _tuned_on_faces(monkeypatch):
    monkeypatch.setattr(targets, "TUNED", ("face-seq1", "face-seq2", "face-seq3", "face-seq4"))


@pytest.fixture
def sheet(monkeypatch, tmp_path):
    """A small moving sheet under every name."""
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(20, 90, 3)) * 0.1 + rng.normal(size=(90, 3))
    rotations = np.linalg.qr(rng.normal(size=(20, 3, 3)))[0]
    rotations *= np.sign(np.linalg.det(rotations))[:, None, None]
    points = np.einsum("fij,fpj->fpi", rotations[:, :2], shapes)
    faces = rng.integers(0, 90, size=(150, 3))
    sequence = Sequence("sheet", Tracks(points), shapes, rotations, faces=faces, note={"frame": "object"})
    monkeypatch.setattr(datasets, "load", lambda name, folder: sequence)
    monkeypatch.setattr(store, "data_folder", lambda: tmp_path)
    return sequence


def test_the_words_tell_all_tracks_apart_and_are_those_of_before_where_nothing_is_new():
    many = [
        Data("a", noise, seed, points, damage)
        for noise, seed in ((0.0, 0), (0.03, 0), (0.03, 1))
        for points in (None, 100)
        for damage in ("", *robust.DAMAGES[1:])
    ]
    assert len({data.words for data in many}) == len(many)
    assert Data("a").words == "a | clean"
    assert Data("a", 0.03, 2).words == "a | noise 0.03 seed 2"


def test_thinned_tracks_keep_their_truth(sheet):
    thin = sequence_of(Data("sheet", points=30))
    assert thin.tracks.n_points == 30
    seen = np.einsum("fij,fpj->fpi", thin.rotations[:, :2], thin.shapes)
    np.testing.assert_allclose(seen, thin.tracks.points, atol=1e-12)
    assert len(np.unique(thin.tracks.points[0], axis=0)) == 30
    assert sequence_of(Data("sheet", points=91)).tracks.n_points == 90


@pytest.mark.parametrize("damage", robust.DAMAGES[1:])
def test_damage_is_as_large_as_it_says_and_leaves_the_rest_alone(sheet, damage):
    found = sequence_of(Data("sheet", damage=damage))
    share = float(damage.split("%")[0]) / 100
    wrong, visible = found.note["wrong"], found.tracks.visible
    assert (wrong is None) != (visible is None)
    touched = wrong if visible is None else ~visible
    assert touched.mean() == pytest.approx(share, abs=0.02)
    np.testing.assert_array_equal(found.tracks.points[~touched], sheet.tracks.points[~touched])
    again = sequence_of(Data("sheet", damage=damage))
    np.testing.assert_array_equal(found.tracks.points, again.tracks.points)


def test_thinned_points_face_away_when_they_do_on_the_whole_surface(sheet):
    damage = f"30% {tracks.BACK}"
    whole = sequence_of(Data("sheet", damage=damage)).tracks.visible
    thin = sequence_of(Data("sheet", points=30, damage=damage)).tracks.visible
    np.testing.assert_array_equal(thin, whole[:, ::3])


def test_damage_that_is_not_known_is_refused(sheet):
    with pytest.raises(ValueError, match="received '30% rain'"):
        sequence_of(Data("sheet", damage="30% rain"))


def _estimate(sequence, shapes, confidence=None):
    reconstructed = np.isfinite(shapes[0, :, 0])
    return SimpleNamespace(shapes=shapes, reconstructed=reconstructed, confidence=confidence, method="auto")


def test_robust_scores_only_what_was_seen_is_right_and_has_a_shape(sheet, monkeypatch):
    data = Data("sheet", damage=f"10% {tracks.OUTLIERS}")
    found = sequence_of(data)
    wrong = found.note["wrong"]
    monkeypatch.setattr(scores, "_complete", lambda data, method: found.shapes)
    shapes = found.shapes.copy()
    shapes[wrong] += 5.0 * np.random.default_rng(1).normal(
        size=shapes[wrong].shape
    )  # however wrong these are, they do not count
    shapes[:, 4] = np.nan
    confidence = np.where(wrong, 0.0, 1.0)
    confidence[:, 4] = 0.0
    score = scores._robust(_estimate(found, shapes, confidence), found)
    assert score["error"] == pytest.approx(0.0, abs=1e-12)
    assert score["hidden"] > 1.0
    assert score["precision"] == score["recall"] == 1.0
    assert score["not_reconstructed"] == pytest.approx(1 / 90)
    shapes[~wrong] += 0.1 * np.random.default_rng(0).normal(size=shapes[~wrong].shape)
    assert scores._robust(_estimate(found, shapes, confidence), found)["error"] > 0.01


def test_precision_and_recall_of_an_accusation_that_is_half_right(sheet, monkeypatch):
    found = sequence_of(Data("sheet", damage=f"10% {tracks.OUTLIERS}"))
    wrong = found.note["wrong"]
    monkeypatch.setattr(scores, "_complete", lambda data, method: found.shapes)
    accused = np.zeros_like(wrong)
    accused.flat[np.flatnonzero(wrong)[::2]] = True
    accused.flat[np.flatnonzero(~wrong)[:90]] = True
    score = scores._robust(_estimate(found, found.shapes, np.where(accused, 0.2, 1.0)), found)
    assert score["recall"] == pytest.approx(0.5)
    assert score["precision"] == pytest.approx(0.5)
    nothing = scores._robust(_estimate(found, found.shapes), found)
    assert nothing["precision"] is None
    assert nothing["recall"] == 0.0


def _kept(monkeypatch, tmp_path, section, records):
    monkeypatch.setattr(store, "OUTPUT", tmp_path)
    monkeypatch.setattr(store, "data_folder", lambda: tmp_path)
    monkeypatch.setattr(store, "code_digest", lambda *_: "now")
    store.write(section, {"records": records})


@pytest.mark.parametrize(
    ("record", "taken"),
    [
        ({"per_frame": 0.1, "code": "now"}, True),
        ({"per_frame": 0.1, "code": "before"}, False),
        ({"global": 0.1, "code": "now"}, False),
        ({"per_frame": 0.1, "error": "no", "code": "now"}, False),
    ],
)
def test_a_section_takes_from_another_what_holds_and_nothing_else(monkeypatch, tmp_path, record, taken):
    case = runs.Case(Data("sheet"), "auto", "estimated")
    _kept(monkeypatch, tmp_path, "other", {case.key: record})
    context = store.Context(only=("nothing",))
    found = runs.run_cases("own", [case], ("per_frame",), context, borrow=("other",))
    assert found["records"] == ({case.key: record} if taken else {})


def _values(cases, record):
    return {"records": {case.key: record | {"code": "now", "seconds": 1.0} for case in cases}}


def _grid(own, other):
    return {
        "records": {
            never_worse._case(s, noise, method).key: {
                never_worse._measure(s): own if method == "auto" else other if method == "grassmann" else 2 * other
            }
            for s in never_worse.SEQUENCES
            for noise in never_worse.NOISES
            for method in ("auto", *targets.OWN)
        }
    }


@pytest.mark.parametrize(("own", "passed"), [(0.1, True), (0.1049, True), (0.1051, False)])
def test_the_grid_compares_with_the_better_of_the_two(own, passed):
    checks = never_worse.checks(_grid(own, 0.1))
    assert len(checks) == len(never_worse.SEQUENCES) * len(never_worse.NOISES)
    assert all(check.passed == passed for check in checks)
    values = _grid(own, 0.1)
    del values["records"][never_worse._case("shark", 0.0, "geometry-aware").key]
    missed = [check.what for check in never_worse.checks(values) if check.value is None]
    assert missed == ["`auto` / the better of two, shark, noise 0%"]


def test_the_targets_of_robustness_are_ratios_to_the_same_entries_of_complete_tracks():
    def found(error):
        record = {"robust": {"error": error, "complete": 0.02}, "seconds": 1.0}
        return {
            "records": {
                robust._case(s, noise, damage).key: record
                for s in robust.SEQUENCES
                for noise in robust.NOISES
                for damage in robust.DAMAGES
            }
        }

    assert set(targets.ROBUST) <= set(robust.DAMAGES)
    assert all(check.passed for check in robust.checks(found(0.0229)))
    between = {check.what.split(", ")[2].split(":")[0] for check in robust.checks(found(0.024)) if check.passed}
    assert between == {"30% missing in blocks"}
    assert not any(check.passed for check in robust.checks(found(0.026)))


@pytest.mark.parametrize(("value", "passed"), [(0.003, 21), (0.03, 12), (1.0, 0)])
def test_cells_of_the_table_of_the_default_method_pass_and_fail(value, passed):
    cases = [c for s in targets.SEQUENCES for n in (0.0, targets.NOISE) for c in auto._dense(s, n, "auto")]
    cases += [auto._sparse(s, "auto") for s in targets.AUTO_MOCAP]
    cases += [runs.Case(data, "auto", "estimated") for data in auto._REAL]
    record = dict.fromkeys(("per_frame", "global", "camera_frame", "similarity", "rotation"), value)
    values = _values(cases, record)
    checks = auto.checks(values)
    assert len(checks) == 12 + 6 + 3
    assert sum(check.passed for check in checks) == passed
    del values["records"][auto._dense("ict-rom99", targets.NOISE, "auto")[3].key]
    missing = [check.what for check in auto.checks(values) if check.value is None]
    assert missing == ["`auto`, 3% noise: ict-rom99", "`auto`, 3% noise: mean of the five"]


def test_tuned_sequences_are_marked(monkeypatch):
    monkeypatch.setattr(targets, "TUNED", ("ict-rom99",))
    assert targets.marked("ict-rom99") == "ict-rom99 (tuned)"
    assert targets.marked("pickup") == "pickup"
    assert any("ict-rom99 (tuned)" in line for line in auto.render({"records": {}}))


def test_the_time_of_the_default_method_is_compared_in_medians():
    run = {"iterations": 3, "stages": [{"cameras": 1.0}] * 3}
    values = {
        "runs": {
            f"face-seq3 {noise:g} {method}": run | {"seconds": seconds}
            for noise in (0.0, targets.NOISE)
            for method, seconds in (("auto", [7.9, 8.1, 20.0]), ("geometry-aware", [1.0, 2.0, 3.0]))
        },
        "others": 0.0,
        "threads": 2,
    }
    assert [check.value for check in auto_speed.checks(values)] == pytest.approx([4.05, 4.05])
    assert not any(check.passed for check in auto_speed.checks(values))
    assert any("4.05× > 4× ✗" in line for line in auto_speed.render(values))


def test_every_switch_is_an_option_and_differs_from_its_default():
    from nrsfm.methods import get_method
    from nrsfm.options import split_options
    from nrsfm.pipeline import STAGE_OPTIONS

    own = get_method("auto").Options
    found = [switch for switch in ablation.switches() if switch is not None]
    assert {f.name for f in dataclasses.fields(own) if f.default is True} <= {name for name, _ in found}
    classes = (*STAGE_OPTIONS.values(), own)
    for name, value in found:
        given = split_options(classes, {name: value}, "auto")
        default = split_options(classes, {}, "auto")
        assert given != default
    assert len({ablation._case("a", 0.0, switch).key for switch in ablation.switches()}) == len(found) + 1


@pytest.mark.parametrize("section", [auto, never_worse, robust, calibration, ablation])
def test_a_page_can_be_written_from_nothing_and_from_failures(section):
    empty = section.render({"records": {}})
    assert empty
    assert all(not check.passed for check in section.checks({"records": {}}))
    every = [robust._case(s, n, d) for s in robust.SEQUENCES for n in robust.NOISES for d in robust.DAMAGES]
    every += [calibration._case(s, n) for s in calibration.SEQUENCES for n in (0.0, targets.NOISE)]
    every += [never_worse._case(s, 0.0, "auto") for s in never_worse.SEQUENCES]
    failed = {"records": {case.key: {"error": "ValueError: no", "code": "now"} for case in every}}
    assert section.render(failed)
    assert all(not check.passed for check in section.checks(failed))
