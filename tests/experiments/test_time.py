"""The experiment on time, on records that are made up."""

import pytest

from nrsfm.experiments import get_experiment
from nrsfm.experiments.base import Cell, Data, Scope
from nrsfm.experiments.timing import slope

TIME = get_experiment("time")


def rows_of(seconds, sizes=((10, 200), (20, 200), (40, 200), (10, 1000), (10, 4000)), failed=()):
    """seconds: {method: function of (frames, points)}."""
    cells, records = [], {}
    for f, p in sizes:
        for method, function in seconds.items():
            cell = Cell(Data("built-in-face3", frames=f, points=p), method, measures=("seconds",), alone=True)
            value = function(f, p)
            cells.append(cell)
            records[cell.key] = {
                "seconds": {"total": value, "cameras": 0.1, "method": value / 2, "shared_cameras": None},
                "memory": 1000,
                "iterations": 5,
            }
            if (method, f, p) in failed:
                records[cell.key] = {"error": "killed after 600 s"}
    return TIME.rows(cells, records)


def power(scale, frames, points):
    return lambda f, p: scale * f**frames * p**points


GOOD = {"grassmann": power(1, 2, 0.1), "geometry-aware": power(1.2, 2, 0.1), "ds": power(5, 1.5, 1)}


def verdicts(rows):
    return [finding.verdict for finding in TIME.findings(rows)]


def test_cells_run_alone():
    cells = TIME.cells(Scope(False, (), ("bmm",)))
    assert all(cell.alone and cell.cameras == "own" for cell in cells)
    assert max(cell.data.frames for cell in cells) == 346
    assert max(cell.data.points for cell in cells) == 100_000
    assert max(cell.data.points for cell in TIME.cells(Scope(True, (), ("bmm",)))) <= 5000


def test_slopes_are_those_of_the_power():
    rows = rows_of(GOOD)
    # The size that both series share is in both.
    assert [sum(r["against"] == a for r in rows if r["method"] == "ds") for a in ("frames", "points")] == [3, 3]
    assert slope(rows, "ds", "frames") == pytest.approx(1.5)
    assert slope(rows, "ds", "points", "seconds_method") == pytest.approx(1.0)
    assert slope(rows, "grassmann", "points") == pytest.approx(0.1)
    assert slope(rows, "nobody", "points") is None
    one_left = rows_of(GOOD, failed={("ds", 10, 1000), ("ds", 10, 4000)})
    assert slope(one_left, "ds", "points") is None


def test_findings_either_way():
    assert verdicts(rows_of(GOOD)) == ["reproduced"] * 3
    assert verdicts(rows_of({**GOOD, "geometry-aware": power(1, 2, 0.9)}))[::2] == ["not reproduced", "in part"]
    slow = {"grassmann": power(1, 2, 1), "geometry-aware": power(9, 2, 1), "ds": power(0.01, 1, 1)}
    assert verdicts(rows_of(slow)) == ["not reproduced"] * 3
    mixed = {**GOOD, "smsr": power(0.01, 1, 0.1), "geometry-aware": power(0.35, 2, 0.3)}
    found = TIME.findings(rows_of(mixed))
    assert [f.verdict for f in found][1] == "in part"
    assert "SMSR" in found[1].text
    assert verdicts(rows_of({"bmm": power(1, 1, 1)})) == ["not measured"] * 3


def test_the_times_of_both_may_be_alike_on_the_whole():
    uneven = {**GOOD, "geometry-aware": lambda f, p: GOOD["grassmann"](f, p) * (3.0 if f == 40 else 1.0)}
    assert verdicts(rows_of(uneven))[0] == "in part"


def test_the_picture_and_the_table():
    rows = rows_of(GOOD, failed={("ds", 10, 4000)})
    (picture,) = TIME.pictures(rows)
    assert picture.name == "time"
    assert len(picture.figure.axes) == 4
    lines = TIME.table(rows)
    head = next(line for line in lines if line.startswith("|"))
    assert "s at 40 × 200" in head
    assert "s at 10 × 4,000" in head
    assert any(line.startswith("| DS |") and "| – |" in line and "| 1.50 |" in line for line in lines)
    assert any("| 4,033 |" in line for line in lines)
