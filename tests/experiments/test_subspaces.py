"""Error against the number of subspaces, on made-up errors."""

import pytest

from nrsfm.experiments.base import Scope
from nrsfm.experiments.subspaces import Subspaces

EXPERIMENT = Subspaces()
SCOPE = Scope(False, ("face-seq1", "face-seq3"), ("grassmann", "geometry-aware"))


def rows(error):
    cells = EXPERIMENT.cells(SCOPE)
    blank = EXPERIMENT.rows(cells, {c.key: {"errors": {"per-frame": 0.0}} for c in cells})
    assert {row["swept"] for row in blank} == {"spatial_cells", "temporal_cells", "spatial_groups"}
    return [row | {"e3d": error(row["swept"], row["value"])} for row in blank]


def as_published(swept, value):
    if swept == "spatial_cells":
        return 0.03 + 0.002 * max(0, 25 - value)
    return 0.04 if swept == "temporal_cells" and value == 3 else 0.05


def opposite(swept, value):
    return 0.04 + 0.001 * value


@pytest.mark.parametrize(
    ("error", "verdicts"),
    [
        (as_published, ["reproduced", "reproduced", "not reproduced"]),
        (opposite, ["not reproduced", "not reproduced", "not reproduced"]),
        (lambda swept, value: 0.1 / value, ["not reproduced", "reproduced", "reproduced"]),  # flat only beyond 25
    ],
)
def test_findings_follow_the_numbers(error, verdicts):
    assert [finding.verdict for finding in EXPERIMENT.findings(rows(error))] == verdicts


def test_options_are_given_only_where_nothing_would_be_cut():
    for cell in EXPERIMENT.cells(SCOPE):
        given = dict(cell.options)
        if "temporal_cells" in given:
            assert given["temporal_dimension"] == (4 if cell.data.sequence == "face-seq1" else 10)
        else:
            assert ("spatial_dimension" in given) == (cell.data.noise == 0)


def test_picture_and_table():
    found = rows(as_published)
    (picture,) = EXPERIMENT.pictures(found)
    assert len(picture.figure.axes) == 6
    table = "\n".join(EXPERIMENT.table(found))
    assert "e3D against K_t" in table
    assert "| 25 | .0300 | .0300 |" in table
