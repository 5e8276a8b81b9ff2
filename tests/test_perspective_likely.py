"""The most likely shapes near given ones mend them, at any number of points, and leave exact ones nearly alone."""

import numpy as np
import pytest

from nrsfm import datasets
from nrsfm.metrics import shape_error
from nrsfm.perspective import likely_shapes


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray]:
    """A talking face 40 frames long in camera axes about its centroid, 100 units in size, and its cameras."""
    sequence = datasets.synthetic.face_sequence(40, 80, "fast", seed=3)
    shapes = np.einsum("fij,fpj->fpi", sequence.rotations, sequence.shapes)
    shapes -= shapes.mean(axis=1, keepdims=True)
    return shapes * (100.0 / np.sqrt(np.mean(shapes[..., :2] ** 2))), sequence.rotations


def wrong(shapes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth that waves over the object, otherwise in every frame."""
    out = shapes.copy()
    waves = np.sin(shapes[..., :2] @ rng.standard_normal((len(shapes), 2, 1)) / 50.0)[..., 0]
    out[..., 2] += 12.0 * (waves - waves.mean(axis=1, keepdims=True))
    return out


def test_wrong_depth_is_mended_and_exact_shapes_stay(scene) -> None:
    shapes, rotations = scene
    begin, ones = wrong(shapes, np.random.default_rng(0)), np.ones(len(shapes))
    before = shape_error(begin, shapes, "similarity")
    found = likely_shapes(shapes[..., :2] + 300.0, begin, rotations, ones)
    assert found.dtype == np.float32
    assert shape_error(found, shapes, "similarity") < 0.6 * before
    assert shape_error(likely_shapes(shapes[..., :2], shapes, rotations, ones), shapes, "similarity") < 0.02


def test_the_answer_knows_no_number_of_points_and_no_unit(scene) -> None:
    shapes, rotations = scene
    begin, ones = wrong(shapes, np.random.default_rng(1)), np.ones(len(shapes))
    found = likely_shapes(shapes[..., :2], begin, rotations, ones)
    twice = likely_shapes(np.repeat(shapes[..., :2], 2, axis=1), np.repeat(begin, 2, axis=1), rotations, ones)
    np.testing.assert_allclose(twice[:, ::2], found, atol=0.5)
    larger = likely_shapes(7.0 * shapes[..., :2], 7.0 * begin, rotations, ones)
    np.testing.assert_allclose(larger / 7.0, found, atol=0.05)
