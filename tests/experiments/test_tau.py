"""Error and d̃ against τ, on made-up numbers."""

import pytest

from nrsfm.experiments.base import Scope
from nrsfm.experiments.tau import Tau

EXPERIMENT = Tau()
SCOPE = Scope(False, ("face-seq1", "face-seq3"))


def rows(error, dimension=lambda name, tau: int(6 + 20 * tau) + (name == "face-seq3")):
    cells = EXPERIMENT.cells(SCOPE)
    records = {}
    for cell in cells:
        tau = dict(cell.options)["tau"]
        chosen = {"lower_dimension": dimension(cell.data.sequence, tau)}
        records[cell.key] = {"errors": {"per-frame": error(tau)}, "chosen": chosen, "groups": 10}
    return EXPERIMENT.rows(cells, records)


@pytest.mark.parametrize(
    ("error", "verdicts"),
    [
        (lambda tau: 0.04 + 0.1 * max(0, 0.95 - tau), ["reproduced", "reproduced", "reproduced"]),
        (lambda tau: 0.05, ["not reproduced", "reproduced", "reproduced"]),
        (lambda tau: 0.04 + 0.1 * tau, ["not reproduced", "not reproduced", "reproduced"]),
    ],
)
def test_findings_follow_the_numbers(error, verdicts):
    assert [finding.verdict for finding in EXPERIMENT.findings(rows(error))] == verdicts


def test_one_dimension_for_all_is_not_what_the_paper_found():
    assert EXPERIMENT.findings(rows(lambda tau: 0.05, lambda name, tau: 12))[2].verdict == "not reproduced"


def test_the_reason_is_given_only_where_tau_does_nothing():
    assert "acts on nothing but" in EXPERIMENT.findings(rows(lambda tau: 0.05))[0].text
    assert "acts on nothing but" not in EXPERIMENT.findings(rows(lambda tau: 0.04 + max(0, 0.95 - tau)))[0].text


def test_picture_and_table():
    found = rows(lambda tau: 0.05)
    (picture,) = EXPERIMENT.pictures(found)
    assert len(picture.figure.axes) == 4
    assert "| 0.97 | .0500 (d̃ 25) | .0500 (d̃ 26) |" in EXPERIMENT.table(found)
