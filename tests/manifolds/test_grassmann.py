"""Grassmann points, Γ and the projection distance, against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.manifolds.grassmann import grassmann_points, projection_distance, projection_kernel, similarity_graph


@st.composite
def stacks(draw):
    """A stack of orthonormal bases (K, d, p), random, some of them close together."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count, ambient = draw(st.integers(1, 7)), draw(st.integers(2, 12))
    dimension = draw(st.integers(1, min(5, ambient)))
    spread = draw(st.sampled_from([1e-6, 0.1, 10.0]))
    blocks = rng.standard_normal((ambient, dimension)) + spread * rng.standard_normal((count, ambient, dimension))
    return np.linalg.qr(blocks)[0], rng


@settings(max_examples=60)
@given(stacks())
def test_kernel_is_the_trace_definition_and_positive(given_stack):
    points, _ = given_stack
    kernel = projection_kernel(points)
    for i, a in enumerate(points):
        for j, b in enumerate(points):
            assert kernel[i, j] == pytest.approx(np.trace((b.T @ a) @ (a.T @ b)), abs=1e-10)
    assert np.linalg.eigvalsh(kernel).min() > -1e-10 * len(points)
    assert np.all(kernel <= points.shape[2] + 1e-10)


@settings(max_examples=60)
@given(stacks())
def test_distance_is_the_definition(given_stack):
    points, _ = given_stack
    squared = projection_distance(points)
    for i, a in enumerate(points):
        for j, b in enumerate(points):
            assert squared[i, j] == pytest.approx(0.5 * np.linalg.norm(a @ a.T - b @ b.T) ** 2, abs=1e-10)
    assert not squared.diagonal().any()
    np.testing.assert_allclose(similarity_graph(points), np.exp(-squared))


@settings(max_examples=40)
@given(stacks())
def test_the_basis_does_not_matter_nor_the_coordinates(given_stack):
    points, rng = given_stack
    count, ambient, dimension = points.shape
    turned = points @ np.linalg.qr(rng.standard_normal((count, dimension, dimension)))[0]
    np.testing.assert_allclose(projection_kernel(turned), projection_kernel(points), atol=1e-10)
    moved = np.linalg.qr(rng.standard_normal((ambient, ambient)))[0] @ points
    np.testing.assert_allclose(projection_kernel(moved), projection_kernel(points), atol=1e-10)


@settings(max_examples=80)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 12), st.integers(1, 14), st.integers(1, 12))
def test_points_are_the_leading_left_singular_vectors(seed, count, ambient, columns, dimension):
    rng = np.random.default_rng(seed)
    dimension = min(dimension, ambient)
    blocks = rng.standard_normal((count, ambient, columns))
    points = grassmann_points(blocks, dimension)
    assert points.shape == (count, ambient, dimension)
    for block, basis in zip(blocks, points, strict=True):
        np.testing.assert_allclose(basis.T @ basis, np.eye(dimension), atol=1e-9)
        full = min(dimension, columns, ambient)
        expected = np.linalg.svd(block)[0][:, :full]
        values = np.linalg.svd(block, compute_uv=False)
        if full < len(values) and values[full - 1] - values[full] < 1e-4:
            continue  # a tie: any of the directions will do
        if full == dimension:
            np.testing.assert_allclose(basis @ basis.T, expected @ expected.T, atol=1e-6)
        else:
            np.testing.assert_allclose(basis @ (basis.T @ expected), expected, atol=1e-6)


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_a_cell_of_low_rank_is_completed_alike_from_few_and_many_columns(rank):
    """The completion may depend on the cell's span only: not on the number of columns, nor on rounding."""
    rng = np.random.default_rng(rank)
    block = rng.standard_normal((9, rank)) @ rng.standard_normal((rank, 4))
    wide = block @ np.linalg.qr(rng.standard_normal((30, 4)))[0].T  # the same columns seen through an isometry
    few, many = grassmann_points(block[None], 4)[0], grassmann_points(wide[None], 4)[0]
    np.testing.assert_allclose(few.T @ few, np.eye(4), atol=1e-10)
    np.testing.assert_allclose(many @ many.T, few @ few.T, atol=1e-9)


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("columns", [2, 7])
def test_the_whole_space_is_the_largest_subspace(complete, columns):
    blocks = np.random.default_rng(0).standard_normal((2, 3, columns))
    points = grassmann_points(blocks, 5, complete)
    assert points.shape == (2, 3, 3)
    np.testing.assert_allclose(np.linalg.norm(points, axis=(1, 2)) ** 2, 3 if complete or columns > 2 else 2)


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_an_incomplete_point_follows_the_coordinates(rank):
    rng = np.random.default_rng(rank)
    block = rng.standard_normal((2, 9, rank)) @ rng.standard_normal((2, rank, 4))
    isometry = np.linalg.qr(rng.standard_normal((25, 9)))[0]
    points = grassmann_points(block, 4, complete=False)
    assert np.linalg.matrix_rank(points[0]) == rank
    moved = grassmann_points(isometry @ block, 4, complete=False)
    np.testing.assert_allclose(projection_kernel(moved), projection_kernel(points), atol=1e-10)
