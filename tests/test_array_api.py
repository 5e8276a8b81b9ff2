"""The iterations, written once: arrays of other libraries give what NumPy gives."""

import sys

import numpy as np
import pytest

import nrsfm
from nrsfm.clustering import kmeans
from nrsfm.compression import compress, measure
from nrsfm.devices import is_on_device, to_host
from nrsfm.manifolds.grassmann import grassmann_points
from nrsfm.manifolds.local import ColumnCells, refine_groups
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem, Solution
from nrsfm.numerics.arrays import beside, namespace_of, on_host, taken, with_columns
from nrsfm.numerics.low_rank import threshold_over_frames


def projectors(points):
    return points @ points.transpose(0, 2, 1)


def same(got, expected, atol=1e-9):
    assert is_on_device(got)
    np.testing.assert_allclose(to_host(got), expected, rtol=0, atol=atol * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize(("frames", "points"), [(5, 7), (20, 3)])
@pytest.mark.parametrize("options", [{}, {"reweight": 0.01}, {"rank": 2}])
def test_threshold(library, frames, points, options):
    shapes = np.random.default_rng(0).standard_normal((frames, 3, points))
    expected, values = threshold_over_frames(shapes, 1.5, **options)
    got, kept = threshold_over_frames(library(shapes), 1.5, **options)
    same(got, expected)
    assert isinstance(kept, np.ndarray)  # ranks are decided on the host
    np.testing.assert_allclose(kept, values, atol=1e-9)
    cut = 1e6  # of which nothing is left
    same(threshold_over_frames(library(shapes), cut, **options)[0], threshold_over_frames(shapes, cut, **options)[0])


@pytest.mark.parametrize("shape", [(3, 8, 5), (3, 5, 8), (1, 4, 4)])
@pytest.mark.parametrize("rank", [1, 3])
@pytest.mark.parametrize("complete", [True, False])
def test_grassmann_points(library, shape, rank, complete):
    rng = np.random.default_rng(1)
    count, rows, columns = shape
    blocks = rng.standard_normal((count, rows, rank)) @ rng.standard_normal((count, rank, columns))
    expected = grassmann_points(blocks, 3, complete)
    got = grassmann_points(library(blocks), 3, complete)
    assert is_on_device(got)
    np.testing.assert_allclose(projectors(to_host(got)), projectors(expected), atol=1e-9)


def test_cells_of_columns(library):
    cells = ColumnCells(np.array([0, 4, 5, 12]))
    matrix = np.random.default_rng(2).standard_normal((9, 12))
    for given in (matrix, np.asfortranarray(matrix)):
        expected = projectors(cells.points(given, 2))
        np.testing.assert_allclose(projectors(to_host(cells.points(library(given), 2))), expected, atol=1e-9)


@pytest.mark.parametrize(("dimensions", "edge"), [([2, None], 0.0), ([None, None], 2.5), ([None, None], 0.0)])
def test_refined_groups(library, dimensions, edge):
    columns = [np.array([0, 1, 2, 9, 10]), np.array([3, 4, 5, 6, 7, 8, 11])]
    matrix = np.random.default_rng(3).standard_normal((6, 12))
    given = library(matrix)
    same(refine_groups(given, columns, dimensions, edge), refine_groups(matrix, columns, dimensions, edge))
    np.testing.assert_array_equal(to_host(given), matrix)


def test_columns_and_rows(library):
    matrix = np.arange(12.0).reshape(3, 4)
    which = np.array([2, 0])
    for axis in (0, 1):
        same(taken(library(matrix), which, axis), np.take(matrix, which, axis=axis))
    changed = [(np.array([3, 1]), -np.ones((3, 2))), (np.array([0]), np.zeros((3, 1)))]
    there = [(own, library(block)) for own, block in changed]
    same(with_columns(library(matrix), there), with_columns(matrix, changed))
    same(with_columns(library(matrix), []), matrix)


def test_numpy_stays_numpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "array_api_compat", None)  # as where the extra is not installed
    array = np.random.default_rng(4).standard_normal((4, 3, 6))
    assert namespace_of(array) is np
    assert on_host(array) is array
    assert beside(array, array) is array
    assert isinstance(threshold_over_frames(array, 0.1)[0], np.ndarray)
    assert isinstance(ColumnCells(np.array([0, 2, 6])).points(array[0], 2), np.ndarray)


PLAIN, EXACT = 0.02, 0.0  # noise of the tracks, of which the methods' shapes are truncated or not


@pytest.fixture(scope="module")
def problems():
    """Compressed tracks of a bending sheet under a turning camera: {noise: problem}, six cells."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-1, 1, (2, 900))
    time = np.arange(16)[:, None]
    z = 0.5 * np.cos(1.5 * x) + 0.2 * np.sin(0.5 * time) * x * y + 0.1 * np.cos(0.9 * time) * x**2
    angle = 0.25 * np.arange(16)
    rows = np.zeros((16, 2, 3))
    rows[:, 0, 0], rows[:, 0, 2], rows[:, 1, 1] = np.cos(angle), np.sin(angle), 1.0
    shapes = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z], axis=1)
    clean = (rows @ shapes).transpose(0, 2, 1)
    made = {}
    for noise in (PLAIN, EXACT):
        measured = measure(clean + noise * rng.standard_normal(clean.shape))
        level = noise / measured.unit
        labels = kmeans(np.stack([x, y], axis=1), 6, np.random.default_rng(0))
        small = compress(measured, labels, noise=level, tolerance=1e-4)
        made[noise] = Problem(small.factors, small.offsets, small.sizes, rows, level)
    return made


@pytest.mark.parametrize("noise", [PLAIN, EXACT])
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("geometry-aware", {}),
        ("geometry-aware", {"projection": False, "spatial_dimension": 3}),
        ("geometry-aware", {"spatial": False}),
        ("grassmann", {}),
        ("grassmann", {"temporal_kind": "kmeans", "temporal_cells": 3, "temporal_dimension": 4}),
        ("grassmann", {"spatial": False}),
        ("bmm", {}),
    ],
)
def test_iterations(library, problems, name, options, noise):
    method = get_method(name)
    problem, options = problems[noise], method.Options(**options)
    expected = method.solve(problem, options, np.random.default_rng(6), lambda _: None)
    there = problem.beside(library(np.zeros(1)))
    assert is_on_device(there.tracks)
    got = method.solve(there, options, np.random.default_rng(6), lambda _: None)
    same(got.shapes, expected.shapes, atol=1e-6)
    assert got.iterations == expected.iterations
    assert got.stop_reason == expected.stop_reason
    assert got.chosen.pop("cut", 0.0) == pytest.approx(expected.chosen.pop("cut", 0.0), abs=1e-7)
    assert got.chosen == expected.chosen
    np.testing.assert_array_equal(got.groups, expected.groups)
    for key, values in expected.history.items():
        # The first threshold is the largest singular value itself: rounding decides whether that is kept.
        np.testing.assert_allclose(got.history[key][1:], values[1:], rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in nrsfm.method_names() if not get_method(name).needs.every_point])
def test_where_the_iteration_runs(problems, name, monkeypatch):
    method = get_method(name)
    seen = []

    def solve(self, problem, options, rng, monitor):
        seen.append(is_on_device(problem.tracks))
        return Solution(problem.initial_shapes, None, 1, "gap", {})

    monkeypatch.setattr(type(method), "solve", solve)
    rng = np.random.default_rng(7)
    points = rng.standard_normal((12, 2, 3)) @ rng.standard_normal((3, 1200)) + 0.01 * rng.standard_normal(
        (12, 2, 1200)
    )
    strict = pytest.importorskip("array_api_strict")
    given = strict.asarray(points.transpose(0, 2, 1), device=strict.Device("device1"))
    result = nrsfm.reconstruct(given, name, perspective="off")
    assert seen[0] is getattr(method, "on_device", False)
    assert is_on_device(result.shapes)
