"""The section about tracks: what is kept is not measured again, failures are shown, targets can be missed."""

import pytest
from benchmarks import store, targets, tracking
from benchmarks.children import TaskError
from benchmarks.store import Context


def _record(mean, seconds=100.0, **more):
    shares = dict.fromkeys(("under_1", "under_3", "precision", "recall"), 0.5)
    return {"mean": mean, "median": mean / 2, **shares, "entries": 10, "seconds": seconds, "frames": 99, **more}


def _shapes():
    return {
        "estimated": 0.05,
        "perfect": 0.02,
        "compared": 900,
        "points": 1000,
        "step": 3,
        "seconds": {"estimated": 1.0, "perfect": 1.0},
    }


@pytest.fixture
def kept(monkeypatch, tmp_path):
    """Results go to a folder of the test's; the tasks are counted and answered at once."""
    monkeypatch.setattr(store, "OUTPUT", tmp_path)
    monkeypatch.setattr(store, "code_digest", lambda *_: "now")
    monkeypatch.setattr(store, "data_folder", lambda: tmp_path)
    asked = []

    def task(module, settings, threads=2):
        asked.append((settings.get("scene", "cloth"), tuple(settings["methods"])))
        if settings.get("variant") == "gaussian":
            raise TaskError("out of memory")
        means = {"naive": 4.0, "dis": 3.0, "subspace": 1.0}
        return {
            method: _record(means[method], **({"shapes": _shapes()} if method == "subspace" else {}))
            for method in settings["methods"]
        }

    monkeypatch.setattr(tracking, "run_task", task)
    return asked


def test_each_video_is_one_process_and_is_kept(kept):
    values = tracking.measure(Context(only=("flag", "face, ")))
    assert ("face", tracking.METHODS) in kept
    assert len(kept) == 6
    text = "\n".join(tracking.render(values))
    assert "failed: out of memory" in text
    assert "| .0500 | .0200 | .0300 | 900 of 1,000 |" in text
    kept.clear()
    values = tracking.measure(Context(only=("flag", "face, ")))
    assert kept == [("flag", tracking.METHODS)]  # what failed is tried again
    kept.clear()
    tracking.measure(Context(only=("face, realistic",), fresh=True))
    assert len(kept) == 2  # with and without discs


def test_other_code_makes_kept_numbers_stale(kept, monkeypatch):
    tracking.measure(Context(only=("ict",)))
    monkeypatch.setattr(store, "code_digest", lambda *_: "later")
    kept.clear()
    tracking.measure(Context(only=("ict",)))
    assert kept == [("ict-rom99", tracking.METHODS)]


def test_targets_can_be_met_and_missed(kept):
    values = tracking.measure(Context(only=("face, realistic",)))
    found = {check.what: check for check in tracking.checks(values)}
    assert all(check.passed for check in found.values())
    assert len(found) == 4  # two ratios, one median, one time
    record = values["records"]["face, realistic | subspace"]
    record["mean"], record["median"], record["seconds"] = 2.1, targets.TRACK_MEDIAN * 1.01, 700.0
    missed = [check for check in tracking.checks(values) if not check.passed]
    assert len(missed) == 3


def test_without_data_the_rest_is_measured(kept, monkeypatch):
    def absent():
        raise store.DataAbsentError("no folder")

    monkeypatch.setattr(store, "data_folder", absent)
    values = tracking.measure(Context())
    assert {name for name, _ in kept} == {"face", "flag"}
    assert tracking.render(values)
