"""Points that were not always seen, from the shapes of those that were."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.reconstruction import Reconstruction
from nrsfm.repair.options import Repaired
from nrsfm.repair.resection import resect, trusted_points

FRAMES, TRUSTED, OTHERS, BASES = 30, 120, 25, 3


@pytest.fixture
def scene():
    """Shapes of rank 3 seen by scaled orthographic cameras: what a method found of the first points, and all tracks."""
    rng = np.random.default_rng(0)
    count = TRUSTED + OTHERS
    coefficients = 0.3 * rng.normal(size=(FRAMES, BASES))
    coefficients[:, 0] = 1.0
    shapes = np.einsum("fk,kpa->fpa", coefficients, rng.normal(size=(BASES, count, 3)))
    rotations = np.linalg.qr(rng.normal(size=(FRAMES, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    scales, translations = rng.uniform(0.8, 1.2, FRAMES), rng.normal(size=(FRAMES, 2))
    points = scales[:, None, None] * (shapes @ rotations[:, :2].transpose(0, 2, 1)) + translations[:, None]
    result = Reconstruction(shapes[:, :TRUSTED], rotations, translations, scales)
    return result, shapes, points, rng


def size(shapes):
    return float(np.sqrt(np.mean(shapes**2)))


def test_hidden_entries_do_not_matter_where_enough_is_seen(scene):
    result, shapes, points, rng = scene
    seen = rng.random(points.shape[:2]) < 0.6
    points[~seen] = np.nan
    found = resect(result, points, seen, 0.0)
    assert np.abs(found.shapes - shapes).max() < 1e-3 * size(shapes)
    assert not found.wrong.any()


def test_wrong_entries_are_found_and_left_out(scene):
    result, shapes, points, _ = scene
    seen = np.ones(points.shape[:2], dtype=bool)
    points[4, 130] += 3.0
    points[9, 7] -= 2.0
    found = resect(result, points, seen, 0.0)
    assert sorted(zip(*np.nonzero(found.wrong), strict=True)) == [(4, 130), (9, 7)]
    assert np.abs(found.shapes - shapes).max() < 1e-3 * size(shapes)


def test_noise_is_not_wrong_and_deviations_follow_it(scene):
    result, shapes, points, rng = scene
    seen = rng.random(points.shape[:2]) < 0.7
    noise = 0.05
    found = resect(result, points + noise * rng.normal(size=points.shape), seen, noise)
    assert not found.wrong.any()
    depths = np.einsum("fpa,fa->fp", found.shapes - shapes, result.rotations[:, 2])
    ratio = depths[:, TRUSTED:] / found.deviation[:, TRUSTED:]
    assert 0.7 < np.sqrt(np.mean(ratio**2)) < 1.4


def test_a_point_that_is_hardly_seen_falls_back_to_the_others_and_says_so(scene):
    result, _, points, _ = scene
    seen = np.ones(points.shape[:2], dtype=bool)
    seen[1:, 140] = False
    found = resect(result, points, seen, 0.01)
    assert np.isfinite(found.shapes).all()
    assert np.median(found.deviation[:, 140]) > 5 * np.median(found.deviation[:, 141])


def test_trusted_are_those_with_the_least_doubt():
    kept = np.ones(400, dtype=bool)
    kept[3] = False
    doubt = np.linspace(0.0, 1.0, 400)
    repaired = Repaired(np.zeros((5, 400, 2)), kept, None, doubt=doubt, doubt_level=0.5)
    trusted = trusted_points(repaired, frames=5)
    assert np.array_equal(np.flatnonzero(trusted), np.setdiff1d(np.flatnonzero(doubt <= 0.5), [3]))
    few = trusted_points(Repaired(np.zeros((5, 400, 2)), kept, None, doubt=doubt, doubt_level=0.0), frames=5)
    assert few.sum() == 100
    assert trusted_points(Repaired(np.zeros((200, 400, 2)), kept, None, doubt=doubt), frames=200).sum() == 399
