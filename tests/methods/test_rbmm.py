"""R-BMM: the proximal step against reweighting, the answer against exact low rank, what the weights change."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.rbmm import logarithmic_penalty
from nrsfm.metrics import shape_error
from nrsfm.numerics.low_rank import shrink_over_frames, threshold_over_frames
from nrsfm.options import build_options
from nrsfm.pipeline import reconstruct

EXACT = {"tolerance": 0.0, "noise_level": 0.0, "precision": "float64"}


@pytest.mark.parametrize("threshold", [0.1, 3.0, 40.0])
def test_proximal_step_is_the_limit_of_reweighting(threshold):
    values = np.linspace(0.01, 30.0, 60)[::-1]
    penalty = logarithmic_penalty(30.0, 0.1)
    x = values.copy()
    for _ in range(200_000):
        fresh = np.maximum(values - threshold * 3.0 / (x + 3.0), 0.0)
        if np.abs(fresh - x).max() < 1e-12:
            break
        x = fresh
    # Where the two roots nearly meet, reweighting takes forever.
    inside = (values + 3.0) ** 2 - 12.0 * threshold
    clear = np.abs(inside) > 1e-2
    np.testing.assert_allclose(penalty.proximal(values, threshold)[clear], x[clear], atol=1e-6)


def test_proximal_step_is_a_minimum():
    """Brute force near the step: ½(x − σ)² + τφ(x) is not lower beside it."""
    penalty = logarithmic_penalty(10.0, 0.05)
    values, threshold = np.array([10.0, 6.0, 3.0, 1.0, 0.2]), 1.5
    found = penalty.proximal(values, threshold)
    for i, (value, x) in enumerate(zip(values, found, strict=True)):
        grid = np.maximum(x + np.linspace(-0.05, 0.05, 101), 0.0)
        cost = 0.5 * (grid - value) ** 2 + threshold * np.array([penalty.value(np.array([g])) for g in grid])
        at = 0.5 * (x - value) ** 2 + threshold * penalty.value(np.array([x]))
        assert at <= cost.min() + 1e-12, i


def test_penalty_is_between_the_norm_and_the_rank():
    values = np.array([5.0, 1.0, 0.0])
    assert logarithmic_penalty(5.0, 1e6).value(values) == pytest.approx(6.0, rel=1e-5)
    assert logarithmic_penalty(5.0, 0.1).value(values) < 6.0


def test_first_threshold_leaves_nothing():
    penalty = logarithmic_penalty(7.0, 0.02)
    values = np.array([7.0, 1.0])
    np.testing.assert_allclose(penalty.proximal(values, 1.001 * penalty.first), 0.0)
    assert penalty.proximal(values, 0.999 * penalty.first)[0] > 0


@pytest.mark.parametrize("shape", [(6, 3, 20), (30, 3, 4)])
def test_shrinking_by_a_rule_is_what_thresholding_does(shape):
    shapes = np.random.default_rng(0).normal(size=shape)
    left, values, right = np.linalg.svd(shapes.reshape(len(shapes), -1), full_matrices=False)
    found, kept = shrink_over_frames(shapes, lambda given: np.maximum(given - 1.5, 0.0))
    expected, same = threshold_over_frames(shapes, 1.5)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(kept, same)
    np.testing.assert_allclose(found, ((left * np.maximum(values - 1.5, 0)) @ right).reshape(shape), atol=1e-9)


def test_exact_low_rank_is_found_to_solver_accuracy(sequence):
    data = sequence(frames=60, points=70, rank=3)
    result = reconstruct(data.tracks, "rbmm", data.rotations, gamma=1e-6, gap=1e-9, **EXACT)
    assert shape_error(result, data.shapes, "none") < 1e-7
    assert result.diagnostics["chosen"]["rank"] == 3


def test_weights_find_what_the_plain_norm_misses(sequence):
    data = sequence(frames=50, points=70, rank=6)
    options = EXACT | {"denoise": False}
    error = {
        m: shape_error(reconstruct(data.tracks, m, data.rotations, **options), data.shapes, "none")
        for m in ("rbmm", "bmm")
    }
    assert error["rbmm"] < 0.5 * error["bmm"]


def test_very_large_reweight_is_the_plain_norm(sequence):
    data = sequence(noise=0.01)
    options = EXACT | {"denoise": False, "gamma": 0.02, "gap": 1e-8}
    plain = reconstruct(data.tracks, "bmm", data.rotations, **options)
    heavy = reconstruct(data.tracks, "rbmm", data.rotations, reweight=1e5, **options)
    np.testing.assert_allclose(heavy.shapes, plain.shapes, atol=1e-3 * np.abs(plain.shapes).max())


def test_own_cameras_and_shape_of_an_exact_sequence(sequence):
    data = sequence(frames=60, points=70, rank=2)
    result = reconstruct(data.tracks, "rbmm", **EXACT)
    assert result.diagnostics["cameras"]["method"] == "smoothest"
    assert shape_error(result, data.shapes, "per-frame") < 1e-3


@pytest.mark.parametrize("method", ["smsr", "rbmm", "organic"])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_compression_changes_nothing(method, noise, sequence):
    """Solved on 2F virtual tracks, and on all 200 columns of W."""
    data = sequence(frames=12, points=200, rank=2, noise=0.02)
    measured = measure(data.tracks)
    small = compress(measured, np.zeros(200, dtype=int))
    everything = measured.columns(slice(None)).reshape(12, 2, -1)
    rows, sizes = np.ascontiguousarray(data.rotations[:, :2]), np.array([200])
    solver = get_method(method)
    options = build_options(solver.Options, {"gap": 1e-8})
    shapes, energies = [], []
    for tracks in (small.factors, everything):
        problem = Problem(tracks, np.array([0, tracks.shape[2]]), sizes, rows, noise)
        solution = solver.solve(problem, options, np.random.default_rng(0), lambda _: None)
        shapes.append(solution.shapes)
        energies.append(solution.history["energy"])
    assert small.factors.shape[2] == 24
    expanded = small.expand(shapes[0], np.dtype(np.float64)) / measured.unit
    np.testing.assert_allclose(expanded, shapes[1].transpose(0, 2, 1), atol=1e-6 * np.abs(expanded).max())
    np.testing.assert_allclose(energies[0], energies[1], rtol=1e-6, atol=1e-9)
