"""What holds for every experiment that sweeps or draws, whatever its numbers are."""

import pytest

from nrsfm.experiments import get_experiment
from nrsfm.experiments.base import CAMERAS, Scope
from nrsfm.experiments.measures import get_measure
from nrsfm.experiments.paths import path_names
from nrsfm.experiments.sequences import available, sequence_names
from nrsfm.methods import get_method
from nrsfm.options import split_options
from nrsfm.pipeline import STAGE_OPTIONS

NAMES = (
    "singular-values",
    "rank",
    "ablation",
    "tau",
    "subspaces",
    "convergence",
    "gallery",
    "temporal-tearing",
    "camera-motion",
)
SEQUENCES = ("face-seq1", "face-seq2", "face-seq3", "face-seq4", "ict-rom99", "pickup", "back_real126")
SCOPES = {
    "quick": Scope(True, SEQUENCES),
    "full": Scope(False, SEQUENCES),
    "built in": Scope(False, available(None)),
    "built in, quick": Scope(True, available(None)),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", SCOPES)
def test_cells_can_be_run(name, kind):
    cells = get_experiment(name).cells(SCOPES[kind])
    assert cells
    assert len({cell.key for cell in cells}) == len(cells)
    for cell in cells:
        assert cell.data.sequence in sequence_names()
        assert cell.cameras in CAMERAS
        assert cell.data.camera_path in (None, *path_names())
        for measure in cell.measures:
            get_measure(measure)
    for method, options in {(cell.method, cell.options) for cell in cells}:
        split_options((*STAGE_OPTIONS.values(), get_method(method).Options), dict(options), method)


@pytest.mark.parametrize("name", NAMES)
def test_quick_asks_for_little(name):
    experiment = get_experiment(name)
    quick, full = (experiment.cells(SCOPES[kind]) for kind in ("quick", "full"))
    assert len(quick) < len(full)
    assert len(quick) <= 100


@pytest.mark.parametrize("name", NAMES)
def test_methods_that_were_not_asked_for_are_not_run(name):
    cells = get_experiment(name).cells(Scope(False, SEQUENCES, ("geometry-aware",)))
    assert {cell.method for cell in cells} == {"geometry-aware"}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("failed", [False, True])
def test_without_numbers_nothing_is_claimed_and_nothing_breaks(name, failed):
    experiment = get_experiment(name)
    cells = experiment.cells(SCOPES["quick"])
    records = {cell.key: {"frames": 10, "points": 40, "error": "out of memory"} for cell in cells} if failed else {}
    rows = experiment.rows(cells, records)
    assert len(rows) == (len(cells) if failed else 0)
    assert all(row["error"] == "out of memory" for row in rows)
    if not rows:
        assert experiment.pictures(rows) == []
        assert not any(any(char.isdigit() for char in line) for line in experiment.table(rows))
    else:
        experiment.pictures(rows)
        experiment.table(rows)
    findings = experiment.findings(rows)
    assert findings
    assert {finding.verdict for finding in findings} == {"not measured"}
    assert all(finding.text for finding in findings)
