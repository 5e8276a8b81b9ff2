"""From records to rows; trends; text."""

import numpy as np
import pytest
import scipy.stats

from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.rows import (
    collect,
    e3d,
    enough,
    error_text,
    face_number,
    listed,
    pearson,
    percent,
    sequence_title,
    spearman,
    table_lines,
    usable,
)


def test_a_failed_cell_is_a_row_with_its_error_and_a_missing_one_is_none():
    cells = [Cell(Data("yoga", 0.03), "bmm", options=(("rank", k),)) for k in (1, 2, 3)]
    records = {cells[0].key: {"x": 4}, cells[1].key: {"error": "no"}}
    rows = collect(cells, records, lambda cell, record: [{"x": record["x"]}])
    asked = {"sequence": "yoga", "noise": 0.03, "method": "bmm", "cameras": "own"}
    assert rows == [asked | {"rank": 1, "x": 4}, asked | {"rank": 2, "error": "no"}]
    assert usable(rows, "x", rank=1) == rows[:1]
    assert usable(rows, "x", rank=2) == []


def test_only_finite_numbers_are_usable():
    rows = [{"x": value} for value in (1.0, None, float("nan"), "1", 2)]
    assert [row["x"] for row in usable(rows, "x")] == [1.0, 2]


def test_where_an_alignment_has_no_meaning_the_similarity_counts():
    assert e3d({"errors": {"per-frame": None, "similarity": 0.2}}) == 0.2
    assert e3d({"errors": {"per-frame": 0.1, "similarity": 0.05}}) == 0.1
    assert e3d({}) is None


@pytest.mark.parametrize("seed", range(5))
def test_correlations_are_scipy_s(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 6, 12), rng.standard_normal(12)
    assert pearson(x, y) == pytest.approx(scipy.stats.pearsonr(x, y).statistic)
    assert spearman(x, y) == pytest.approx(scipy.stats.spearmanr(x, y).statistic)
    assert spearman(x, np.ones(12)) == 0.0


def test_enough_is_where_the_error_stays_near_its_least():
    assert enough([1, 2, 4, 8], [0.5, 0.104, 0.2, 0.1]) == 8
    assert enough([1, 2, 4, 8], [0.5, 0.104, 0.1, 0.1]) == 2
    assert enough([1, 2, 4, 8], [0.1, 0.1, 0.1, 0.1]) == 1


def test_numbers_and_names_as_text():
    assert [error_text(v) for v in (0.0623, 1.234, None, float("nan"))] == [".0623", "1.23", "–", "–"]
    assert [percent(v) for v in (0.121, -0.03, 0.001)] == ["+12%", "−3%", "±0%"]
    assert [listed(list(words)) for words in ("a", "ab", "abc")] == ["a", "a and b", "a, b and c"]
    assert sequence_title("face-seq3") == "face 3"
    assert [face_number(n) for n in ("face-seq2", "original-face4", "built-in-face1", "face1", "pickup")] == [
        2, 4, 1, None, None,
    ]  # fmt: skip
    assert table_lines(["a", "b"], [["1", "2"]]) == ["| a | b |", "|---|---|", "| 1 | 2 |", ""]
