"""Jumps at borders, on made-up accelerations, and the borders that Algorithm 1 reports."""

import numpy as np
import pytest

from nrsfm import reconstruct
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.experiments.base import Scope
from nrsfm.experiments.temporal_tearing import TemporalTearing, jump, kind

EXPERIMENT = TemporalTearing()
SCOPE = Scope(False, ("face-seq3", "ict-rom99"))
FRAMES = 40


def test_a_jump_is_the_ratio_of_means():
    acceleration = [1.0] * 10
    acceleration[3] = acceleration[4] = 5.0  # frames 4 and 5, either side of a border at 5
    assert jump(acceleration, [5]) == pytest.approx(5.0)
    assert jump(acceleration, [9]) == pytest.approx(1.0 / (16.0 / 8))
    assert jump(acceleration, []) is None
    assert jump(acceleration, range(12)) is None
    assert jump([0.0] * 10, [5]) is None


def test_variants_have_names_of_their_own():
    cells = EXPERIMENT.cells(SCOPE)
    assert len({kind(dict(c.options), c.method) for c in cells}) == len(cells) / 4


def rows(torn):
    """Rows in which the error accelerates ``torn(options)`` times at borders."""
    cells = EXPERIMENT.cells(SCOPE)
    records = {}
    for cell in cells:
        given = dict(cell.options)
        has = "temporal_cells" in given
        borders = [FRAMES * k // given["temporal_cells"] for k in range(1, given["temporal_cells"])] if has else None
        error = np.ones(FRAMES - 2)
        for b in borders or ():
            error[[b - 2, b - 1]] = torn(given)
        records[cell.key] = {
            "errors": {"per-frame": 0.05},
            "chosen": {"temporal_borders": borders} if has else {},
            "acceleration": {
                "error": error.tolist(),
                "truth": [1.0] * (FRAMES - 2),
                "track": [0.0] * FRAMES,
                "true_track": [0.1] * FRAMES,
            },
        }
    return EXPERIMENT.rows(cells, records)


@pytest.mark.parametrize(
    ("torn", "verdicts"),
    [
        (lambda given: 4.0 if "temporal_dimension" in given else 1.0, ["reproduced", "reproduced"]),
        (lambda given: 4.0, ["reproduced", "not reproduced"]),
        (lambda given: 1.0, ["not reproduced", "not reproduced"]),
        (lambda given: 4.0 if given.get("temporal_dimension") == 5 else 1.0, ["in part", "reproduced"]),
    ],
)
def test_findings_follow_the_numbers(torn, verdicts):
    assert [finding.verdict for finding in EXPERIMENT.findings(rows(torn))] == verdicts


def test_what_tears_without_groups_is_not_blamed_on_them():
    found = [row | {"jump": 3.0} for row in rows(lambda given: 3.0)]
    assert EXPERIMENT.findings(found)[0].verdict == "not reproduced"


def test_pictures_and_table():
    found = rows(lambda given: 4.0)
    trajectory, jumps = EXPERIMENT.pictures(found)
    assert len(trajectory.figure.axes) == 6
    assert len(jumps.figure.axes) == 4
    table = "\n".join(EXPERIMENT.table(found))
    assert "| Algorithm 1, 2 runs of frames, dimension 5 | 4.00× (.0500) | 4.00× (.0500) |" in table


def test_a_record_without_acceleration_is_told():
    cells = EXPERIMENT.cells(SCOPE)[:1]
    (row,) = EXPERIMENT.rows(cells, {cells[0].key: {"errors": {}, "acceleration": None, "chosen": {}}})
    assert "not known" in row["error"]


@pytest.mark.parametrize("temporal_kind", ["consecutive", "kmeans"])
def test_algorithm_1_reports_the_borders_of_its_groups(temporal_kind):
    sequence = face_sequence(24, 80)
    options = {"temporal_cells": 4, "temporal_kind": temporal_kind, "grouping": False, "max_iterations": 3}
    found = reconstruct(sequence.tracks, "grassmann", sequence.rotations, **options).diagnostics["chosen"]
    borders = found["temporal_borders"]
    assert borders == [6, 12, 18] if temporal_kind == "consecutive" else 3 <= len(borders) < 24
    off = reconstruct(sequence.tracks, "grassmann", sequence.rotations, temporal=False, max_iterations=3)
    assert "temporal_borders" not in off.diagnostics["chosen"]
