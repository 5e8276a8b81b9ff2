"""Points that were not always seen, from the shapes of those that were."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.reconstruction import Reconstruction
from nrsfm.repair import resection
from nrsfm.repair.options import Repaired
from nrsfm.repair.resection import resect, resect_by_cells, trusted_points

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


@pytest.fixture
def parts():
    """Two parts of 200 points, each with 2 basis shapes of its own, found with errors; noisy tracks, 40% unseen."""
    rng = np.random.default_rng(1)
    count, noise = 400, 0.1
    coefficients = rng.normal(size=(FRAMES, 5))
    coefficients[:, 0] = 1.0
    basis = np.zeros((5, count, 3))
    basis[0] = 3.0 * rng.normal(size=(count, 3))
    basis[1:3, :200] = rng.normal(size=(2, 200, 3))
    basis[3:, 200:] = rng.normal(size=(2, 200, 3))
    basis[0, 200:, 0] += 20.0
    shapes = np.einsum("fk,kpa->fpa", coefficients, basis)
    rotations = np.linalg.qr(rng.normal(size=(FRAMES, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    scales, translations = rng.uniform(0.8, 1.2, FRAMES), rng.normal(size=(FRAMES, 2))
    points = scales[:, None, None] * (shapes @ rotations[:, :2].transpose(0, 2, 1)) + translations[:, None]
    points += noise * rng.normal(size=points.shape)
    seen = rng.random(points.shape[:2]) < 0.6
    seen[:, ::4] = True
    rough = np.einsum("fk,kpa->fpa", coefficients, basis + 0.2 * (basis != 0) * rng.normal(size=basis.shape))
    return Reconstruction(rough, rotations, translations, scales), shapes, points, seen, noise, rng


def test_cells_know_more_than_all_points_together(parts):
    result, shapes, points, seen, noise, rng = parts
    points[~seen] = np.nan
    together = resect(result, points, seen, noise)
    found = resect_by_cells(result, result.shapes, points, seen, noise, rng)
    assert size(found.shapes - shapes) < 0.97 * size(together.shapes - shapes) < size(result.shapes - shapes)


def test_the_noise_is_found_though_it_was_told_wrong_and_entries_are_wrong(parts):
    result, _, points, seen, noise, rng = parts
    bad = seen & (rng.random(seen.shape) < 0.03)
    points[bad] += rng.normal(size=(int(bad.sum()), 2)) * 30
    first = resect_by_cells(result, result.shapes, points, seen, 4 * noise, rng)
    found = resect_by_cells(result, first.shapes, points, seen, first.noise, rng)
    assert found.noise == pytest.approx(noise, rel=0.1)
    assert found.wrong[bad].mean() > 0.9
    assert found.wrong[~bad].mean() < 0.001


def test_what_missing_entries_add_to_the_deviation(parts):
    result, shapes, points, seen, noise, rng = parts
    found = resect_by_cells(result, result.shapes, points, seen, noise, rng)
    always = seen.all(axis=0)
    assert found.deviation[:, always].max() < 1e-3 * noise
    assert (found.deviation[:, ~always] > 0).all()
    depths = np.einsum("fpa,fa->fp", found.shapes - shapes, result.rotations[:, 2])
    spread = np.mean(depths[:, ~always] ** 2) - np.mean(depths[:, always] ** 2)
    assert 0.7 < np.sqrt(np.mean(found.deviation[:, ~always] ** 2) / spread) < 1.4


def test_the_result_may_be_of_fewer_points(parts):
    result, shapes, points, seen, noise, rng = parts
    few = Reconstruction(
        result.shapes[:, ::2],
        result.rotations,
        result.translations,
        result.scales,
        groups=np.zeros(200, dtype=np.int64),
        depth_deviation=np.ones((FRAMES, 200)),
    )
    found = resect_by_cells(few, result.shapes, points, seen, noise, rng)
    assert size(found.shapes - shapes) < size(result.shapes - shapes)


def test_points_in_one_place_stay_there(parts):
    result, _, points, seen, noise, rng = parts
    flat = np.repeat(result.shapes[:, :1], len(points[0]), axis=1)
    found = resect_by_cells(result, flat, points, seen, noise, rng)
    assert np.isfinite(found.shapes).all()
    assert np.isfinite(found.deviation).all()


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


def test_distributions_have_the_leading_directions_alone():
    """A point costs the cube of their number."""
    rng = np.random.default_rng(0)
    scales = np.geomspace(1.0, 1e-2, 150)
    coefficients = rng.standard_normal((2_000, 150)) * scales
    mean, root = resection._distribution(coefficients)
    np.testing.assert_allclose(mean, coefficients.mean(axis=0))
    assert root.shape == (150, 96)
    values, vectors = np.linalg.eigh(np.cov(coefficients.T, ddof=0))
    leading = vectors[:, -96:]
    np.testing.assert_allclose(root @ root.T, (leading * values[-96:]) @ leading.T, atol=1e-12)
    everyone = coefficients.mean(axis=0), np.cov(coefficients.T, ddof=0)
    assert resection._of_cell(coefficients[:300], everyone, 1e-3)[1].shape == (150, 96)
    assert resection._of_cell(coefficients[:300, :5], (everyone[0][:5], everyone[1][:5, :5]), 1e-3)[1].shape == (5, 5)
