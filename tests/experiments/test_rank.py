"""Two fits against K, on made-up ones."""

import pytest

from nrsfm.experiments.base import Scope
from nrsfm.experiments.rank import Rank, takes_rank
from nrsfm.methods import method_names

EXPERIMENT = Rank()
METHODS = tuple(m for m in ("bmm", "pta", "mp", "grassmann", "geometry-aware") if m in method_names())
SCOPE = Scope(True, tuple(f"face-seq{i}" for i in range(1, 5)), METHODS)


def rows(fits):
    """Rows of (reprojection, shape) by (method, cameras, K)."""
    cells = EXPERIMENT.cells(SCOPE)
    records = {}
    for cell in cells:
        reprojection, shape = fits(
            cell.method, "known" if cell.cameras == "known" else "own", dict(cell.options)["rank"]
        )
        records[cell.key] = {"fits": {"reprojection": reprojection, "shape": shape}}
    return EXPERIMENT.rows(cells, records)


def as_published(method, cameras, k):
    if method in ("grassmann", "geometry-aware"):
        return 0.1 / k, 0.2 / k
    return (0.1 / k, 0.2) if method == "mp" else (0.1 + 0.01 * k, 0.3)


def all_fall(method, cameras, k):
    return 0.1 / k, 0.2 / k


def test_the_four_take_a_rank():
    assert takes_rank("bmm")
    assert takes_rank("geometry-aware")


@pytest.mark.parametrize(
    ("fits", "verdicts"),
    [
        (as_published, {"bmm": "reproduced", "mp": "reproduced", "geometry-aware": "reproduced"}),
        (all_fall, {"bmm": "not reproduced", "mp": "not reproduced", "geometry-aware": "reproduced"}),
        (lambda m, c, k: (0.1, 0.2 + 0.01 * k), {"bmm": "reproduced", "geometry-aware": "not reproduced"}),
    ],
)
def test_findings_follow_the_numbers(fits, verdicts):
    findings = dict(zip(("bmm", "mp", "geometry-aware"), EXPERIMENT.findings(rows(fits)), strict=True))
    for method, verdict in verdicts.items():
        if method in METHODS:
            assert findings[method].verdict == verdict


def test_own_cameras_decide_and_true_ones_are_shown():
    found = rows(lambda m, cameras, k: all_fall(m, cameras, k) if cameras == "known" else (0.1, 0.2))
    assert EXPERIMENT.findings(found)[-1].verdict == "not reproduced"
    assert [picture.name for picture in EXPERIMENT.pictures(found)] == ["rank-own", "rank-known"]
    table = "\n".join(EXPERIMENT.table(found))
    assert "With true cameras" in table
    assert "| Algorithm 2 | face 3 | .1000 → .0125 | .2000 → .0250 | .0250 at K = 8 | 1.00 |" in table


def test_cameras_that_do_not_depend_on_k_are_estimated_once():
    cells = EXPERIMENT.cells(SCOPE)
    assert {cell.cameras for cell in cells if cell.method == "bmm"} == {"intersection", "known"}
    assert {row["cameras"] for row in rows(all_fall)} == {"own", "known"}


def test_failed_ranks_are_left_out():
    cells = EXPERIMENT.cells(SCOPE)
    fails = {c.key: {"error": "rank"} for c in cells if dict(c.options)["rank"] == 8}
    found = EXPERIMENT.rows(cells, {c.key: {"fits": {"reprojection": 0.1, "shape": 0.2}} for c in cells} | fails)
    assert sum("error" in row for row in found) == len(fails)
    assert EXPERIMENT.pictures(found)
