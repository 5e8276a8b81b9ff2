"""Tracks without noise: every wrong entry is found, however small, and none that is right is lost."""

import numpy as np
import pytest

from nrsfm import Tracks
from nrsfm.datasets.corruption import gross_outliers, occlude
from nrsfm.repair import RepairOptions, repair, trusted_points
from nrsfm.repair.exact import exact_verdicts, is_exact
from nrsfm.repair.growth import learn
from nrsfm.repair.model import infer, inferred_mean
from nrsfm.repair.view import view_of

from .conftest import bending_sheet
from .test_model import random_model, silent


def repaired(points, visible=None):
    return repair(Tracks(points, visible), RepairOptions(), np.random.default_rng([0, 2]), silent)


@pytest.fixture(scope="module")
def dense():
    return bending_sheet(side=60)  # 3,600 points


def test_the_mean_alone_is_that_of_the_posterior(rng):
    model = random_model(rng)
    tracks = rng.standard_normal((6, 2, 9))
    weights = np.where(rng.random((6, 9)) < 0.7, rng.random((6, 9)), 0.0)
    weights[:, 3:6] = 1.0
    np.testing.assert_allclose(inferred_mean(model, tracks, weights), infer(model, tracks, weights)[0], atol=1e-10)
    whole = np.ones((6, 9))
    np.testing.assert_allclose(inferred_mean(model, tracks, whole), infer(model, tracks, whole)[0], atol=1e-10)


def test_wrong_entries_of_any_size_are_found_and_no_others(dense, rng):
    points, bad = gross_outliers(dense, 0.05, rng)
    small = rng.random(bad.shape) < 0.0001
    points = points + np.where(small & ~bad, 0.003, 0.0)[:, :, None]  # far below what neighbours could tell
    done = repaired(points)
    assert done.good is not None
    truth = bad | small
    found = ~done.good
    assert not (truth & ~found).any()
    assert np.count_nonzero(found & ~truth) < 0.001 * found.size
    trusted = trusted_points(done, len(points))
    assert trusted.mean() > 0.9
    assert np.abs(done.points[:, trusted] - dense[:, trusted]).max() < 1e-4


def test_gaps_alone_raise_no_suspicion(dense, rng):
    visible = occlude(dense, 0.3, rng)
    done = repaired(dense, visible)
    assert done.report["outliers"] == 0
    trusted = trusted_points(done, len(dense))
    assert np.abs(done.points[:, trusted] - dense[:, trusted]).max() < 1e-4


def test_a_track_that_no_verdict_makes_fit_is_not_clean(dense, rng):
    points = dense.copy()
    points[:, 7] += 0.05 * rng.standard_normal(points[:, 7].shape)  # of its own, in every frame
    view = view_of(Tracks(points), rng)
    others = np.arange(100, 700)
    part = view.columns(others)
    seen = np.ones(points.shape[:2], dtype=bool)
    model = learn(part, seen[:, others], None, rng=rng, monitor=silent).model
    assert is_exact(model)
    verdict = exact_verdicts(view, seen, np.zeros_like(seen), model)
    assert not verdict.clean[7]
    assert verdict.clean.mean() > 0.99
    assert not np.delete(verdict.wrong, 7, axis=1).any()
