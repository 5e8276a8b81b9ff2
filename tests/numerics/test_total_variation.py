"""Total variation on graphs: the image's on a grid, its operators, its dual."""

import numpy as np
import pytest

from nrsfm.neighbours import Neighbours, edges_of_grid, edges_of_tracks, gradient
from nrsfm.numerics.total_variation import GraphVariation


def grid_graph(height, width):
    rows, columns = np.mgrid[:height, :width]
    grid = np.column_stack([columns.ravel(), rows.ravel()])
    return Neighbours(height * width, edges_of_grid(grid, height * width), "grid")


def test_on_a_grid_it_is_the_total_variation_of_the_image():
    height, width = 7, 9
    picture = np.random.default_rng(0).standard_normal((height, width))
    right, down = np.zeros_like(picture), np.zeros_like(picture)
    right[:, :-1], down[:-1] = np.diff(picture, axis=1), np.diff(picture, axis=0)
    graph = grid_graph(height, width)
    found = GraphVariation(*gradient(graph), 0.5).value(picture.reshape(-1, 1))
    np.testing.assert_allclose(found, 0.5 * np.sqrt(right**2 + down**2).sum() / graph.spacing)


@pytest.fixture
def variation():
    rng = np.random.default_rng(1)
    points = rng.standard_normal((50, 3))
    graph = Neighbours(50, edges_of_tracks(points.T[None, :2], 5), "tracks")
    return GraphVariation(*gradient(graph), 0.3)


def test_the_operators_are_adjoint_and_the_norm_is_a_bound(variation):
    rng = np.random.default_rng(2)
    u, p = rng.standard_normal(50), rng.standard_normal(variation.operator.shape[0])
    np.testing.assert_allclose((variation.operator @ u) @ p, u @ (variation.adjoint @ p))
    largest = np.linalg.norm(variation.operator.toarray(), 2) ** 2
    assert largest <= variation.norm2 <= 4 * largest


def test_the_dual_variable_reaches_the_variation(variation):
    """max ⟨p, Du⟩ over the balls is the variation: climb with u fixed."""
    u = np.random.default_rng(3).standard_normal((50, 40))  # more columns than one block
    variation.start(u)
    for _ in range(4):
        force = np.zeros_like(u)
        variation.ascend(u, 1e3, force)
    np.testing.assert_allclose(np.sum(force * u), variation.value(u), rtol=1e-9)


def test_columns_are_worked_on_alone(variation):
    u = np.random.default_rng(4).standard_normal((50, 30))
    alone = sum(variation.value(u[:, i : i + 1]) for i in range(30))
    np.testing.assert_allclose(variation.value(u), alone)
