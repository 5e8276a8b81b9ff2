"""The global low-rank model and its two extensions: exact data, invariances, and how they reduce to one another."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.metrics import shape_error
from nrsfm.options import build_options
from nrsfm.pipeline import reconstruct

METHODS = ["bmm", "grassmann", "geometry-aware"]
LOCAL = ["grassmann", "geometry-aware"]
EXACT = {"tolerance": 0.0, "denoise": False, "noise_level": 0.0, "precision": "float64"}


def solved(sequence, method, labels=None, noise=0.0, **options):
    """The method's own solution on the compressed tracks, cameras known."""
    measured = measure(sequence.tracks)
    labels = np.arange(measured.count) % 4 if labels is None else labels
    small = compress(measured, labels)
    rows = np.ascontiguousarray(sequence.rotations[:, :2])
    problem = Problem(small.factors, small.offsets, small.sizes, rows, noise)
    solver = get_method(method)
    solution = solver.solve(problem, build_options(solver.Options, options), np.random.default_rng(0), lambda _: None)
    return small.expand(solution.shapes, np.dtype(np.float64)), solution


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rank", [1, 2])
def test_recovers_exact_low_rank_sequences(method, rank, sequence):
    data = sequence(rank=rank)
    result = reconstruct(data.tracks, method, data.rotations, reweight=0.01)
    assert shape_error(result, data.shapes, "none") < 0.02


@pytest.mark.parametrize("method", METHODS)
def test_noise_costs_about_as_much_as_it_is(method, sequence):
    data = sequence(rank=2, noise=0.03, points=200)
    result = reconstruct(data.tracks, method, data.rotations)
    assert shape_error(result, data.shapes, "none") < 0.08


@pytest.mark.parametrize("method", LOCAL)
def test_order_of_the_points_hardly_matters_under_noise(method, sequence):
    data = sequence(noise=0.05, points=120)
    order = np.random.default_rng(1).permutation(120)
    errors = [
        shape_error(reconstruct(data.tracks[:, o], method, data.rotations, spatial_cells=4), data.shapes[:, o])
        for o in (np.arange(120), order)
    ]
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_turning_the_image_does_not_matter(method, sequence):
    """W and R multiplied by one rotation of the image plane per frame: the same object."""
    data = sequence(noise=0.02)
    angle = np.random.default_rng(0).uniform(0, 6, len(data.tracks))
    turn = np.array([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in angle])
    moved = data.tracks @ turn[:, :2, :2].transpose(0, 2, 1)
    options = {"noise_level": 2.0, "precision": "float64"}
    plain = reconstruct(data.tracks, method, data.rotations, **options)
    other = reconstruct(moved, method, turn @ data.rotations, **options)
    np.testing.assert_allclose(other.shapes, plain.shapes, rtol=0, atol=1e-5 * np.abs(plain.shapes).max())


@pytest.mark.parametrize("method", METHODS)
def test_turning_the_object_frame_turns_the_shapes(method, sequence):
    data = sequence(noise=0.02)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    plain = reconstruct(data.tracks, method, data.rotations, precision="float64")
    other = reconstruct(data.tracks, method, data.rotations @ turn.T, precision="float64")
    np.testing.assert_allclose(other.shapes, plain.shapes @ turn.T, rtol=0, atol=1e-5 * np.abs(plain.shapes).max())


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("reweight", [0.0, 0.01])
def test_without_their_parts_both_algorithms_are_the_global_method(noise, reweight, sequence):
    data = sequence(noise=noise)
    expected, _ = solved(data, "bmm", noise=noise, reweight=reweight)
    geometry, solution = solved(data, "geometry-aware", noise=noise, reweight=reweight, spatial=False)
    assert solution.groups is None
    np.testing.assert_allclose(geometry, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    both_off, solution = solved(data, "grassmann", noise=noise, reweight=reweight, spatial=False, temporal=False)
    assert solution.groups is None
    np.testing.assert_allclose(both_off, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_without_grouping_and_time_the_two_algorithms_agree(sequence):
    """Fixed cells, no temporal subspaces: only the reconstruction is left, which they share."""
    data = sequence(noise=0.05)
    options = {"noise": 0.05, "grouping": False, "spatial_dimension": 5, "max_iterations": 120, "gap": 1e-300}
    first, _ = solved(data, "grassmann", temporal=False, **options)
    second, _ = solved(data, "geometry-aware", **options)
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("rank", [1, 3])
def test_rank_is_bounded_when_asked(method, noise, rank, sequence):
    shapes, solution = solved(sequence(noise=noise, rank=4), method, noise=noise, rank=rank)
    values = np.linalg.svd(shapes.reshape(len(shapes), -1), compute_uv=False)
    assert solution.chosen["rank"] == rank
    assert values[rank] < 1e-3 * values[0]


SWITCHES = [
    {"spatial": False},
    {"grouping": False},
    {"spatial_dimension": 3},
    {"spatial_groups": 1},
    {"reweight": 0.0},
    {"gamma": 0.1},
    {"regroup_every": 3},
]


@pytest.mark.parametrize(
    ("method", "switch"),
    [(m, s) for m in LOCAL for s in SWITCHES]
    + [("grassmann", {"temporal": False}), ("grassmann", {"temporal_cells": 4})]
    + [("grassmann", {"temporal_dimension": 3}), ("grassmann", {"lambda3": 1.0})],
)
def test_every_part_does_something(method, switch, sequence):
    data = sequence(frames=16, noise=0.1, points=160, rank=4)
    common = {"noise": 0.1, "labels": np.arange(160) % 8, "spatial_dimension": 5, "max_iterations": 60}
    common |= {"temporal_dimension": 2} if method == "grassmann" else {}
    plain, _ = solved(data, method, **common)
    other, _ = solved(data, method, **(common | switch))
    assert np.abs(other - plain).max() > 1e-4 * np.abs(plain).max()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_history_is_complete_and_finite(method, noise, sequence):
    _, solution = solved(sequence(noise=noise), method, noise=noise)
    assert set(solution.history) == {"energy", "gap", "rank", "beta"}
    for values in solution.history.values():
        assert len(values) == solution.iterations
        assert np.isfinite(values).all()
    assert solution.stop_reason == "gap"
    assert solution.history["gap"][-1] < get_method(method).Options().gap
    assert solution.history["beta"] == sorted(solution.history["beta"])
    assert solution.chosen["rank"] == solution.history["rank"][-1]


@pytest.mark.parametrize("method", LOCAL)
def test_subspaces_have_the_dimension_asked_for(method, sequence):
    labels = np.arange(80) % 4
    shapes, solution = solved(
        sequence(noise=0.2), method, labels, noise=0.2, spatial_dimension=2, grouping=False, gap=1e-12
    )
    flat = shapes.transpose(0, 2, 1).reshape(-1, 80)
    for k in range(4):
        assert np.linalg.matrix_rank(flat[:, labels == k], tol=1e-6 * np.linalg.norm(flat)) == 2
    assert solution.chosen["spatial_dimensions"] == [2, 2, 2, 2]


def two_parts(frames=24, points=160):
    """Two halves of points that move in different two-dimensional families of trajectories, cells split in 4 each."""
    rng = np.random.default_rng(4)
    families = np.linalg.qr(rng.standard_normal((3 * frames, 8)))[0]
    half = points // 2
    flat = np.concatenate(
        [families[:, :4] @ rng.standard_normal((4, half)), families[:, 4:] @ rng.standard_normal((4, half))], axis=1
    )
    shapes = 100 * flat.reshape(frames, 3, points).transpose(0, 2, 1)
    rotations = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    tracks = (shapes @ rotations.transpose(0, 2, 1))[:, :, :2]
    return tracks, rotations, np.arange(points) // (points // 8)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("grassmann", {"temporal": False}),
        ("geometry-aware", {"projection": False}),
        ("geometry-aware", {"projection": True}),
    ],
)
def test_cells_of_one_part_are_grouped(method, options, sequence):
    """Four cells see one family of trajectories, four another: two groups come out."""
    tracks, rotations, labels = two_parts()
    data = type(sequence())(tracks, tracks, rotations)
    _, solution = solved(data, method, labels, spatial_dimension=4, spatial_groups=2, **options)
    np.testing.assert_array_equal(solution.groups, [0, 0, 0, 0, 1, 1, 1, 1])


@pytest.mark.parametrize("method", LOCAL)
@pytest.mark.parametrize("groups", [1, 2, 3, 50])
def test_number_of_groups_can_be_set(method, groups, sequence):
    _, solution = solved(sequence(noise=0.05), method, np.arange(80) % 6, noise=0.05, spatial_groups=groups)
    assert solution.groups.shape == (6,)
    assert solution.groups.max() + 1 <= groups
    np.testing.assert_array_equal(np.unique(solution.groups), np.arange(solution.groups.max() + 1))


@pytest.mark.parametrize("kind", ["consecutive", "kmeans"])
@pytest.mark.parametrize("cells", [1, 2, 5, 30, 99])
def test_temporal_cells_of_any_number(kind, cells, sequence):
    shapes, solution = solved(
        sequence(noise=0.05), "grassmann", noise=0.05, temporal_cells=cells, temporal_kind=kind, max_iterations=150
    )
    assert np.isfinite(shapes).all()
    assert solution.stop_reason in ("gap", "iteration limit")


def test_lower_dimension_is_never_below_p_nor_beyond_the_span(sequence):
    for wanted in (1, 7, 500):
        _, solution = solved(
            sequence(noise=0.05),
            "geometry-aware",
            np.arange(80) % 6,
            noise=0.05,
            spatial_dimension=3,
            lower_dimension=wanted,
            max_iterations=30,
        )
        assert 3 <= solution.chosen["lower_dimension"] <= 18
        assert wanted != 7 or solution.chosen["lower_dimension"] == 7
