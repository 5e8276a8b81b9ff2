"""The section about the viewer: a case that does not play at 30 frames a second is a target missed."""

import pytest
from benchmarks import viewer


def _values(**rates):
    cases = {name: {"rate": 30.1, "milliseconds": 60.0, "size": "640 × 480", "others": 0.0} for name in viewer._CASES}
    for name, rate in rates.items():
        cases[name]["rate"] = rate
    return {"cases": cases, "browser": "1.2", "cores": 2, "others": 0.0}


@pytest.mark.parametrize(("rate", "passed"), [(29.4, False), (29.6, True), (30.0, True), (0.0, False)])
def test_each_case_has_to_play_at_thirty_frames_a_second(rate, passed):
    for name in viewer._CASES:
        values = _values(**{name: rate})
        missed = [check for check in viewer.checks(values) if not check.passed]
        assert len(missed) == (not passed)
        assert all(
            check.what.endswith(name) and check.cell() == f"{rate:.1f} of 30 frames a second ✗" for check in missed
        )
        assert "\n".join(viewer.render(values)).count("✗") == len(missed)


def test_the_target_names_the_size():
    assert all("28,880 points × 99 frames" in check.what for check in viewer.checks(_values()))
