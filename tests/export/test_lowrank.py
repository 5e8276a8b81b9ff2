import numpy as np
import pytest

from nrsfm.export import lowrank
from nrsfm.export.lowrank import blendshapes


def low_rank(frames=12, points=50, rank=3, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((frames, rank)) @ (rng.standard_normal((rank, 3 * points)) * 10)
    return values + 100 * rng.standard_normal(3 * points) + noise * rng.standard_normal((frames, 3 * points))


def blend_of(values, **options):
    return blendshapes(lambda part: values[:, part].astype(float), *values.shape, **{"tolerance": 1e-4, **options})


def rebuilt(blend):
    return blend.base + blend.weights.astype(float) @ blend.targets.astype(float)


def distances(values, blend):
    return np.linalg.norm((values - rebuilt(blend)).reshape(len(values), -1, 3), axis=2)


def test_shapes_of_low_rank_come_back_with_as_many_targets():
    values = low_rank()
    blend = blend_of(values)
    assert blend.targets.shape == (3, 150)
    np.testing.assert_allclose(rebuilt(blend), values, atol=1e-3)


def test_weights_are_from_0_to_1_and_reach_both():
    blend = blend_of(low_rank(noise=1.0), tolerance=0.5)
    assert blend.weights.min(axis=0).tolist() == [0.0] * len(blend.targets)
    assert blend.weights.max(axis=0).tolist() == [1.0] * len(blend.targets)


@pytest.mark.parametrize("criterion", ["rms", "max"])
def test_as_few_targets_as_the_tolerance_allows(criterion):
    values = low_rank(noise=1.0)
    tolerance = {"rms": 1.0, "max": 2.5}[criterion]
    blend = blend_of(values, tolerance=tolerance, criterion=criterion)
    count = len(blend.targets)
    assert 0 < count < 11
    error = {"rms": lambda d: np.sqrt(np.mean(d**2)), "max": np.max}[criterion]
    assert error(distances(values, blend)) <= tolerance
    assert error(distances(values, blend_of(values, targets=count - 1))) > tolerance


def test_the_error_told_is_that_of_the_stored_numbers_and_the_best_of_its_rank():
    values = low_rank(noise=1.0)
    blend = blend_of(values, targets=2)
    found = distances(values, blend)
    assert blend.rms == pytest.approx(np.sqrt(np.mean(found**2)), rel=1e-6)
    assert blend.largest == pytest.approx(found.max(), rel=1e-6)
    singular = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
    assert blend.rms == pytest.approx(np.sqrt(np.sum(singular[2:] ** 2) / found.size), rel=1e-5)


def test_chunks_change_nothing(monkeypatch):
    values = low_rank(noise=1.0)
    whole = blend_of(values, targets=4)
    monkeypatch.setattr(lowrank, "_CHUNK", 12 * 21)
    parts = blend_of(values, targets=4)
    np.testing.assert_allclose(rebuilt(parts), rebuilt(whole), atol=1e-3)
    assert parts.largest == pytest.approx(whole.largest, rel=1e-6)


@pytest.mark.parametrize("frames", [1, 5])
def test_what_does_not_move_has_no_targets(frames):
    values = np.tile(low_rank(frames=1), (frames, 1))
    blend = blend_of(values)
    assert blend.targets.shape == (0, 150)
    assert blend.weights.shape == (frames, 0)
    np.testing.assert_allclose(blend.base, values[0], rtol=1e-6)


def test_no_more_targets_than_the_sequence_has():
    assert len(blend_of(low_rank(), targets=50).targets) == 3
    assert len(blend_of(low_rank(noise=1.0), targets=50).targets) == 11
    assert len(blend_of(low_rank(noise=1.0), tolerance=1e-12).targets) == 11
