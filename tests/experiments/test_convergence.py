"""Iterations, on made-up histories."""

import pytest

from nrsfm.experiments.base import Scope
from nrsfm.experiments.convergence import Convergence

EXPERIMENT = Convergence()
SCOPE = Scope(True, tuple(f"face-seq{i}" for i in range(1, 5)), ("bmm", "grassmann", "geometry-aware"))


def rows(iterations=lambda cell: 130, reason="gap", settled=130):
    cells = EXPERIMENT.cells(SCOPE)
    records = {}
    for cell in cells:
        count = min(dict(cell.options).get("max_iterations", 999), iterations(cell))
        error = 0.05 + 0.001 * max(0, settled - count)
        record = {"iterations": count, "errors": {"per-frame": error}}
        if "history" in cell.measures:
            record["history"] = {
                "energy": [100.0 / (i + 1) for i in range(count)],
                "gap": [0.5**i for i in range(count)],
            }
            record["stop_reason"] = reason
        records[cell.key] = record
    return EXPERIMENT.rows(cells, records)


def verdicts(found):
    return [finding.verdict for finding in EXPERIMENT.findings(found)]


def test_within_the_paper_s_range():
    assert verdicts(rows()) == ["reproduced", "reproduced", "reproduced"]


@pytest.mark.parametrize(("count", "verdict"), [(119, "not reproduced"), (120, "reproduced"), (151, "not reproduced")])
def test_the_range_has_two_ends(count, verdict):
    assert verdicts(rows(lambda cell: count))[0] == verdict


def test_some_within_is_in_part_and_the_text_counts_them():
    found = EXPERIMENT.findings(rows(lambda cell: 130 if cell.method == "grassmann" else 90))[0]
    assert found.verdict == "in part"
    assert "4 of 8 runs" in found.text
    assert "Algorithm 1 130 to 130 and Algorithm 2 90 to 90" in found.text


def test_a_limit_is_no_end():
    finding = EXPERIMENT.findings(rows(reason="iteration limit"))[1]
    assert finding.verdict == "not reproduced"
    assert "BMM on face 1" in finding.text


def test_an_error_that_settles_early():
    finding = EXPERIMENT.findings(rows(settled=20))[2]
    assert finding.verdict == "not reproduced"
    assert "Algorithm 2, face 3: 20 of 130" in finding.text


def test_pictures_and_table():
    found = rows()
    curves, dots = EXPERIMENT.pictures(found)
    assert len(curves.figure.axes) == 6
    assert [tick.get_text() for tick in dots.figure.axes[0].get_yticklabels()] == ["BMM", "Algorithm 1", "Algorithm 2"]
    assert "| BMM | 130 (gap) | 130 (gap) | 130 (gap) | 130 (gap) |" in EXPERIMENT.table(found)
