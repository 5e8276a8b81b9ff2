"""What the benchmark page is made of: comparisons that can fail, and a page that says so."""

from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import accuracy, page, real, runs, scores, store, targets
from benchmarks.tables import Check, Fact


def test_a_check_compares_the_unrounded_number():
    assert Check("", 0.064, 0.064).cell() == ".0640 ≤ .064 ✓"
    assert Check("", 0.06401, 0.064).cell() == ".0640 > .064 ✗"
    assert Check("", 2.5, 2.0, "×").cell() == "2.5× > 2× ✗"
    assert not Check("", None, 1.0).passed


def test_the_unreflected_error_tells_a_shape_from_its_mirror_image_whatever_its_size_and_pose():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 30, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    moved = SimpleNamespace(shapes=0.3 * truth @ turn + 5.0)
    mirrored = SimpleNamespace(shapes=moved.shapes * [1, 1, -1])
    sequence = SimpleNamespace(shapes=truth)
    assert scores._unreflected(moved, sequence) == pytest.approx(0, abs=1e-12)
    assert scores._unreflected(mirrored, sequence) > 0.1


def test_every_case_has_a_name_of_its_own():
    cases = [
        runs.Case(runs.Data("a", noise, seed), method, cameras, options)
        for noise, seed in ((0.0, 0), (0.03, 0), (0.03, 1))
        for method in targets.METHODS
        for cameras in ("known", "estimated")
        for options in ((), (("mirror", True),))
    ]
    assert len({case.key for case in cases}) == len(cases)


def _records(value):
    record = {"per_frame": value, "global": value, "rotation": 1.0, "code": "old"}
    return {
        runs.Case(data, method, cameras).key: record
        for sequence in targets.SEQUENCES
        for noise in (0.0, targets.NOISE)
        for data in accuracy._data(sequence, noise)
        for method in targets.METHODS
        for cameras in ("known", "estimated")
    }


@pytest.mark.parametrize(("value", "passed"), [(0.01, 25), (0.05, 10), (1.0, 0)])
def test_cells_of_the_table_of_targets_pass_and_fail(value, passed):
    checks = accuracy.checks({"records": _records(value)})
    assert sum(check.passed for check in checks) == passed
    assert len(checks) == 25


def test_one_missing_seed_leaves_no_number():
    records = _records(0.01)
    for method in targets.METHODS:
        del records[runs.Case(runs.Data("face-seq1", targets.NOISE, 3), method, "known").key]
    missed = [check.what for check in accuracy.checks({"records": records}) if not check.passed]
    assert missed == ["best of two, known cameras, 3% noise: face-seq1"]


def test_the_mirror_passes_when_right_or_when_the_user_is_warned():
    def fact(returned, mirrored, warnings) -> Fact:
        keys = [runs.Case(runs.Data("back_real126"), "bmm", "estimated", o).key for o in ((), (("mirror", True),))]
        records = {keys[0]: {"unreflected": returned, "warnings": warnings}, keys[1]: {"unreflected": mirrored}}
        return real._mirror({"records": records}, "bmm")

    assert fact(0.07, 0.2, []).passed
    assert not fact(0.2, 0.07, ["the camera hardly turns"]).passed
    assert fact(0.2, 0.07, ["the tracks do not tell the mirror image"]).passed


def test_the_page_lists_what_was_missed_what_failed_and_what_is_stale(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "ROOT", tmp_path)
    monkeypatch.setattr(store, "OUTPUT", tmp_path / "kept")
    monkeypatch.setattr(store, "PAGE", tmp_path / "benchmarks.md")
    monkeypatch.setattr(store, "code_digest", lambda *_: "new")
    records = _records(0.05)
    key = next(iter(records))
    records[key] = {"error": "ValueError: no", "code": "old"}
    store.write("accuracy", {"records": records})
    missed, errors = page.write_page()
    text = store.PAGE.read_text(encoding="utf-8")
    assert missed
    assert errors == {key: "ValueError: no"}
    assert all(f"- {check.what}: {check.cell()}" in text for check in missed)
    assert f"- {accuracy.TITLE}: {key}: ValueError: no" in text
    assert "Measured with an earlier state of the code: accuracy" in text
    assert text.count("**Not measured yet.**") == len(page.SECTIONS) - 1


def test_code_of_videos_makes_only_their_section_old(tmp_path, monkeypatch):
    package = tmp_path / "src" / "nrsfm"
    for part in ("tracking", "viewing", "methods"):
        (package / part).mkdir(parents=True)
        (package / part / "code.py").write_text("1")
    monkeypatch.setattr(store, "ROOT", tmp_path)

    def both() -> list[str]:
        return [store.code_digest(), store.code_digest("tracking")]

    before = both()
    (package / "viewing" / "code.py").write_text("2")
    assert both() == before
    (package / "tracking" / "code.py").write_text("2")
    changed = both()
    assert [a == b for a, b in zip(changed, before, strict=True)] == [True, False]
    (package / "methods" / "code.py").write_text("2")
    assert not set(both()) & set(changed)
