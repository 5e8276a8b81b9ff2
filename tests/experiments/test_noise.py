"""The experiment on noise, on records that are made up."""

import pytest

from nrsfm.experiments import get_experiment
from nrsfm.experiments.base import Scope
from nrsfm.experiments.noise import levels

NOISE = get_experiment("noise")
METHODS = ("bmm", "grassmann", "geometry-aware", "ds", "smsr")
FACES = tuple(f"face-seq{i}" for i in range(1, 5))


def rows_of(start, slope, methods=METHODS, faces=FACES[:2], failed=lambda cell: False):
    """Rows in which the error of a method is start + slope · ratio, a little different from face to face."""
    from nrsfm.experiments.base import Cell, Data

    cells, records = [], {}
    for face in faces:
        for ratio in (0.0, 0.02, 0.05):
            for seed in range(3 if ratio else 1):
                for method in methods:
                    cell = Cell(Data(face, ratio, seed, points=50), method, "intersection", measures=("errors",))
                    value = start[method] + slope[method] * ratio + 0.001 * int(face[-1]) + 0.0001 * seed
                    cells.append(cell)
                    failure = {"points": 50, "error": "no"}
                    records[cell.key] = failure if failed(cell) else {"points": 50, "errors": {"per-frame": value}}
    return NOISE.rows(cells, records)


START = {"bmm": 0.06, "grassmann": 0.045, "geometry-aware": 0.04, "ds": 0.062, "smsr": 0.15}
SLOPE = dict.fromkeys(METHODS, 0.2)


def verdicts(rows):
    return [finding.verdict for finding in NOISE.findings(rows)]


def test_cells_are_the_paper_s():
    cells = NOISE.cells(Scope(False, FACES, ("bmm", "smsr")))
    assert {c.data.noise for c in cells} == {0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.055}
    assert {c.data.sequence for c in cells} == set(FACES)
    assert {c.data.seed for c in cells if c.data.noise == 0.01} == set(range(10))
    shared = [c for c in cells if c.cameras == "intersection"]
    assert len(shared) == 2 * 4 * (1 + 6 * 10)
    # Own cameras once, and only where they are others.
    assert {(c.method, c.data.seed) for c in cells if c.cameras == "own"} == {("smsr", 0)}
    assert len(NOISE.cells(Scope(True, FACES, ("bmm",)))) <= 12


def test_means_are_over_faces_then_repeats():
    found = levels(rows_of(START, SLOPE), "intersection")
    clean, _, strong = found["bmm"]
    assert (clean.ratio, clean.repeats, strong.repeats) == (0.0, 1, 3)
    assert clean.mean == pytest.approx(0.06 + 0.0015)
    assert strong.mean == pytest.approx(0.06 + 0.2 * 0.05 + 0.0015 + 0.0001)
    assert strong.spread == pytest.approx(0.0001)


def test_a_repeat_without_all_faces_does_not_count():
    rows = rows_of(
        START, SLOPE, failed=lambda c: c.method == "ds" and c.data.seed == 1 and c.data.sequence == "face-seq2"
    )
    found = levels(rows, "intersection")
    assert [level.repeats for level in found["ds"]] == [1, 2, 2]
    assert [level.repeats for level in found["bmm"]] == [1, 3, 3]


def test_findings_when_the_paper_is_right():
    assert verdicts(rows_of(START, SLOPE)) == ["reproduced"] * 3


def test_findings_when_it_is_right_in_part():
    equal = {**START, "geometry-aware": START["grassmann"]}
    assert verdicts(rows_of(equal, SLOPE))[0] == "in part"
    between = {**START, "ds": 0.0425}
    assert verdicts(rows_of(between, SLOPE))[:2] == ["in part", "in part"]
    steep = {**SLOPE, "grassmann": 0.9}
    assert verdicts(rows_of(START, steep))[2] == "in part"


def test_findings_when_it_is_wrong():
    best = {**START, "ds": 0.01, "geometry-aware": 0.05}
    assert verdicts(rows_of(best, SLOPE))[:2] == ["not reproduced"] * 2
    assert verdicts(rows_of(START, {**SLOPE, "grassmann": 0.9, "geometry-aware": 0.9}))[2] == "not reproduced"
    text = NOISE.findings(rows_of(best, SLOPE))[0].text
    assert "better than DS at 0 of 2 levels" in text
    assert "worse at 2" in text


def test_findings_without_the_methods():
    assert verdicts(rows_of(START, SLOPE, methods=("bmm", "ds"))) == ["not measured"] * 3
    found = NOISE.findings(rows_of(START, SLOPE, methods=("bmm", "grassmann", "geometry-aware")))
    assert found[0].verdict == "not measured"
    assert "Without numbers: DS" in found[0].text


def test_a_better_method_outside_the_comparison_is_named():
    start = {**START, "em-pnd": 0.01}
    text = NOISE.findings(rows_of(start, {**SLOPE, "em-pnd": 0.1}, methods=(*METHODS, "em-pnd")))[1].text
    assert "Outside that comparison, better still: EM-PND" in text


def test_the_picture_and_the_table():
    rows = rows_of(START, SLOPE)
    (picture,) = NOISE.pictures(rows)
    assert picture.name == "noise"
    assert len(picture.figure.axes) == 2
    lines = NOISE.table(rows)
    assert any(line.startswith("| Algorithm 1 | .0465 |") and line.endswith("| 0.20 |") for line in lines)


def test_own_cameras_have_a_picture_of_their_own():
    rows = rows_of(START, SLOPE)
    rows += [row | {"cameras": "own"} for row in rows if row["method"] == "smsr" and row["repeat"] == 0]
    names = [picture.name for picture in NOISE.pictures(rows)]
    assert names == ["noise", "noise-own"]
