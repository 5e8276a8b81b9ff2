"""Every method gives the same shapes on the compressed tracks as on all points: the claim of ``compression``."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.compression import compress, measure
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.options import build_options

LIMIT = 1e-6


def bending_tracks(frames, points, rank, noise, rng):
    """Tracks (F, P, 2) in pixels of a shape with ``rank`` modes under turning cameras (F, 2, 3)."""
    rotations = np.ascontiguousarray(np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0][:, :2])
    weights = 0.4 * rng.standard_normal((frames, rank))
    weights[:, 0] = 1.5
    shapes = np.einsum("fk,kip->fip", weights, rng.standard_normal((rank, 3, points)))
    seen = rotations @ shapes + noise * rng.standard_normal((frames, 2, points))
    return 70.0 * seen.transpose(0, 2, 1) + 300.0 * rng.standard_normal((frames, 1, 2)), rotations


def compressed_and_direct(points, rotations, labels, method, options, noise):
    """Solve on the virtual tracks and on all P columns of W; both as (F, P, 3) in the unit of the tracks' rms."""
    measured = measure(points)
    small = compress(measured, labels)
    order = np.argsort(labels, kind="stable")
    everything = measured.columns(order).reshape(measured.frames, 2, -1)
    offsets = np.concatenate([[0], np.cumsum(small.sizes)])
    solver, chosen = get_method(method), build_options(get_method(method).Options, {"gap": 1e-8} | options)
    virtual = Problem(small.factors, small.offsets, small.sizes, rotations, noise)
    direct = Problem(everything, offsets, small.sizes, rotations, noise)
    a = solver.solve(virtual, chosen, np.random.default_rng(5), lambda _: None)
    b = solver.solve(direct, chosen, np.random.default_rng(5), lambda _: None)
    full = np.empty((measured.frames, measured.count, 3))
    full[:, order] = b.shapes.transpose(0, 2, 1)
    return small.expand(a.shapes, np.dtype(np.float64)) / measured.unit, full, a, b


def assert_same(points, rotations, labels, method, options, noise):
    mine, direct, a, b = compressed_and_direct(points, rotations, labels, method, options, noise)
    assert np.linalg.norm(mine - direct) <= LIMIT * np.linalg.norm(direct)
    assert (a.groups is None) == (b.groups is None)
    if a.groups is not None:
        np.testing.assert_array_equal(a.groups, b.groups)
    np.testing.assert_allclose(a.history["energy"][-1], b.history["energy"][-1], rtol=1e-6, atol=1e-9)


@st.composite
def layouts(draw):
    """Random sizes and cells: some of one point, some with fewer points than 2F, W often of lower rank than 2F."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames, points = draw(st.integers(3, 10)), draw(st.integers(8, 80))
    cells = draw(st.integers(1, min(8, points // 2)))
    labels = rng.integers(cells, size=points)
    labels[:cells] = np.arange(cells)
    if cells > 1 and draw(st.booleans()):
        labels[labels == 0] = 1
        labels[0] = 0
    tracks, rotations = bending_tracks(frames, points, draw(st.integers(1, 3)), draw(st.sampled_from([0, 0.05])), rng)
    return tracks, rotations, labels, draw(st.sampled_from([0.0, 0.05]))


COMMON = {
    "reweight": st.sampled_from([0.0, 0.01, 0.1]),
    "gamma": st.sampled_from([None, 0.01, 0.1]),
    "growth": st.sampled_from([1.1, 1.3]),
}
SPATIAL = {
    "spatial_dimension": st.integers(1, 6),
    "regroup_every": st.integers(1, 8),
    "grouping": st.booleans(),
}


@settings(max_examples=15)
@given(layouts(), st.fixed_dictionaries(COMMON))
def test_bmm(layout, options):
    tracks, rotations, labels, noise = layout
    assert_same(tracks, rotations, labels, "bmm", options, noise)


TEMPORAL = {
    "temporal": st.booleans(),
    "temporal_cells": st.integers(1, 4),
    "temporal_kind": st.sampled_from(["consecutive", "kmeans"]),
    "temporal_dimension": st.sampled_from([None, 1, 2, 3]),
    "lambda1": st.sampled_from([1e-3, 0.1, 1.0]),
    "lambda2": st.sampled_from([1e-3, 0.1, 1.0]),
}


@settings(max_examples=60)
@given(layouts(), st.fixed_dictionaries(COMMON | SPATIAL | TEMPORAL))
def test_algorithm_1(layout, options):
    tracks, rotations, labels, noise = layout
    assert_same(tracks, rotations, labels, "grassmann", options, noise)


PROJECTED = {
    "projection": st.booleans(),
    "tau": st.floats(0.3, 1.0),
    "beta1": st.sampled_from([1e-3, 0.1, 1.0]),
}


@settings(max_examples=60)
@given(layouts(), st.fixed_dictionaries(COMMON | SPATIAL | PROJECTED))
def test_algorithm_2(layout, options):
    tracks, rotations, labels, noise = layout
    assert_same(tracks, rotations, labels, "geometry-aware", options, noise)


@pytest.mark.parametrize("seed", [0, 1, 54])
def test_temporal_points_of_low_rank(seed):
    """Early on S♯ has fewer directions than p_t; what completes the points must not depend on the compression."""
    rng = np.random.default_rng(seed)
    tracks, rotations = bending_tracks(24, 60, 3, 0.05, rng)
    labels = rng.integers(3, size=60)
    labels[:3] = range(3)
    options = {"spatial_dimension": 8, "temporal_cells": 6, "temporal_dimension": 4, "regroup_every": 1 + seed % 3}
    options |= {"lambda2": [1e-3, 0.1][seed % 2], "reweight": [0.0, 0.01][seed % 2]}
    assert_same(tracks, rotations, labels, "grassmann", options, 0.05)


@pytest.mark.parametrize("method", ["grassmann", "geometry-aware"])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_with_nothing_set(method, noise):
    """The defaults choose dimensions from the data; on cells with rank 2F they choose the same ones."""
    rng = np.random.default_rng(8)
    tracks, rotations = bending_tracks(6, 150, 2, 0.05, rng)
    assert_same(tracks, rotations, np.arange(150) % 5, method, {}, noise)


@pytest.mark.parametrize("method", ["grassmann", "geometry-aware"])
def test_ranks_chosen_for_few_frames_and_many_points(method):
    """The noise edge of a cell depends on its real points, of which there are many more than virtual ones."""
    rng = np.random.default_rng(2)
    tracks, rotations = bending_tracks(4, 480, 1, 0.5, rng)
    assert_same(tracks, rotations, np.arange(480) % 3, method, {"grouping": False}, 2.0)


def test_one_point_per_cell():
    rng = np.random.default_rng(1)
    tracks, rotations = bending_tracks(5, 9, 2, 0.05, rng)
    assert_same(tracks, rotations, np.arange(9), "geometry-aware", {"spatial_dimension": 2}, 0.05)


def test_the_comparison_can_fail():
    """A compression that loses a thousandth is seen."""
    rng = np.random.default_rng(3)
    tracks, rotations = bending_tracks(6, 60, 2, 0.05, rng)
    mine, direct, *_ = compressed_and_direct(tracks, rotations, np.arange(60) % 3, "bmm", {}, 0.0)
    assert np.linalg.norm(1.001 * mine - direct) > LIMIT * np.linalg.norm(direct)
