"""The section about many machines: counted messages against the formula, and the tables on paper."""

from pathlib import Path

import pytest
from benchmarks import cluster
from benchmarks.cluster_messages import Problem, simulate
from benchmarks.cluster_paper import MACHINES, levels, memory, operations, paper, sums

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def values():
    problems = Problem(24, 6_000, 4, 4), Problem(40, 6_000, 3, 8)
    return {"rows": [cluster._row(problem) for problem in problems]}


def test_messages_are_as_many_and_as_large_as_the_formula_says(values):
    assert all(check.passed for check in cluster.checks(values))
    assert [row["depth"] for row in values["rows"]] == [2, 3]
    for row in values["rows"]:
        row["found"]["second"]["sum"][1] *= 1.1
    size, _ = cluster.checks(values)
    assert not size.passed


def test_three_workers_move_no_more_sums_than_a_tree_of_them():
    counts, _ = simulate(Problem(10, 3_000, 3, 3))
    assert len(counts["second"].messages["sum"]) == 2
    assert counts["second"].depth <= 2


def test_the_section_is_written(values):
    lines = cluster.render(values)
    assert any(line.startswith("| 24 | 6,000 | 4 | 4 |") for line in lines)
    assert paper()[0] in lines


def test_the_paper_says_what_the_formulas_give():
    assert sums()["second"] == pytest.approx(1.6e9, rel=1e-2)
    assert operations()["first"] == 8e15
    assert [levels(machine) for machine in MACHINES] == [(11, 3), (12, 6), (14, 6), (17, 9)]
    assert memory(MACHINES[1]) < 40e9


def test_the_page_has_the_tables_on_paper():
    page = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text(encoding="utf-8")
    assert "\n".join(paper()) in page
