"""Cells of columns, groups of cells, and their best low-rank approximations."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.manifolds.local import ColumnCells, refine_groups, signal_rank


def best_approximation(block, rank):
    left, values, right = np.linalg.svd(block, full_matrices=False)
    return (left[:, :rank] * values[:rank]) @ right[:rank]


widths = st.lists(st.integers(1, 9), min_size=1, max_size=6)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), widths, st.integers(1, 12))
def test_truncation_is_the_best_approximation_of_each_cell(seed, sizes, rows):
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    matrix = rng.standard_normal((rows, offsets[-1]))
    ranks = np.array([rng.integers(1, min(rows, n) + 1) for n in sizes])
    got = refine_groups(matrix, ColumnCells(offsets).columns_of_groups(np.arange(len(sizes))), ranks.tolist())
    for a, b, rank in zip(offsets[:-1], offsets[1:], ranks, strict=True):
        np.testing.assert_allclose(got[:, a:b], best_approximation(matrix[:, a:b], rank), atol=1e-7)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), widths, st.integers(2, 10), st.integers(1, 4))
def test_points_see_their_own_columns_only(seed, sizes, rows, dimension):
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    matrix = rng.standard_normal((rows, offsets[-1]))
    dimension = min(dimension, rows)
    points = ColumnCells(offsets).points(matrix, dimension)
    for k, (a, b) in enumerate(itertools.pairwise(offsets)):
        full = min(dimension, b - a)
        expected = np.linalg.svd(matrix[:, a:b])[0][:, :full]
        np.testing.assert_allclose(points[k] @ (points[k].T @ expected), expected, atol=1e-6)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), widths, st.integers(1, 12))
def test_refinement_treats_groups_as_one_block(seed, sizes, rows):
    rng = np.random.default_rng(seed)
    cells = ColumnCells(np.concatenate([[0], np.cumsum(sizes)]))
    matrix = rng.standard_normal((rows, sum(sizes)))
    groups = np.unique(rng.integers(3, size=len(sizes)), return_inverse=True)[1]
    columns = cells.columns_of_groups(groups)
    np.testing.assert_array_equal(np.sort(np.concatenate(columns)), np.arange(sum(sizes)))
    ranks = [None if rng.random() < 0.3 else int(rng.integers(1, 8)) for _ in columns]
    before = matrix.copy()
    got = refine_groups(matrix, columns, ranks)
    np.testing.assert_array_equal(matrix, before)
    for own, rank in zip(columns, ranks, strict=True):
        expected = matrix[:, own] if rank is None else best_approximation(matrix[:, own], rank)
        np.testing.assert_allclose(got[:, own], expected, atol=1e-7)


def test_refining_twice_changes_nothing_more():
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((8, 20))
    groups = [np.arange(12), np.arange(12, 20)], [2, 3]
    once = refine_groups(matrix, *groups)
    np.testing.assert_allclose(refine_groups(once, *groups), once, atol=1e-10)


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_signal_rank_counts_what_stands_above_the_noise(noise):
    rng = np.random.default_rng(1)
    clean = 3 * rng.standard_normal((20, 4)) @ rng.standard_normal((4, 500))
    # As after the optimal shrinkage: what is noise is gone or far below the edge.
    left, values, _ = np.linalg.svd(clean + noise * rng.standard_normal(clean.shape), full_matrices=False)
    values[4:] = 0.05 * noise * np.sqrt(500)
    assert signal_rank(left * values, 500, noise) == 4


def test_signal_rank_is_none_where_everything_is_signal():
    tracks = np.random.default_rng(0).standard_normal((20, 3))
    assert signal_rank(tracks, 3, 1e-6) is None
    assert signal_rank(np.zeros((20, 3)), 3, 0.1) in (None, 1)


@pytest.mark.parametrize(("edge", "rank"), [(0.0, 6), (1.5, 4), (100.0, 1)])
def test_without_a_dimension_the_edge_decides(edge, rank):
    rng = np.random.default_rng(2)
    left, right = (np.linalg.qr(rng.standard_normal((n, 6)))[0] for n in (9, 7))
    matrix = (left * [8.0, 5.0, 3.0, 2.0, 1.0, 0.5]) @ right.T
    got = refine_groups(matrix, [np.arange(7)], [None], edge)
    np.testing.assert_allclose(got, best_approximation(matrix, rank), atol=1e-7)
