"""Enlarged images: places that agree, fields brought back, small objects followed in their own pixels."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.tracking import track
from nrsfm.tracking.scale import LARGEST, Sampler, Scale

from .conftest import textured, warped

cv2 = pytest.importorskip("cv2")


def _mask(height: int, width: int, side: int) -> np.ndarray:
    mask = np.zeros((height, width), dtype=bool)
    mask[3 : 3 + side, 5 : 5 + side] = True
    return mask


@pytest.mark.parametrize(("size", "factor"), [(0, 1.0), (20, 1.0), (30, 1.5), (40, 2.0), (1000, LARGEST)])
def test_an_object_is_enlarged_to_the_size_at_most_twice(size, factor):
    scale = Scale(_mask(40, 60, 20), size)
    assert scale.shape == (40 * factor, 60 * factor)
    assert scale.factor == pytest.approx(factor)
    image = np.zeros((40, 60), dtype=np.float32)
    assert scale.enlarged(image).shape == scale.enlarged_mask(_mask(40, 60, 20)).shape == scale.shape
    if factor == 1:
        assert scale.enlarged(image) is image


@pytest.mark.parametrize("size", [20, 27, 31.7, 40])
def test_an_enlarged_ramp_has_its_value_at_every_pixels_place(size):
    scale = Scale(_mask(41, 53, 20), size)
    y, x = np.mgrid[:41, :53].astype(np.float32)
    pixels = np.stack([x, y], axis=-1)[4:-4, 4:-4].reshape(-1, 2).astype(np.int32)
    for ramp, axis in ((x, 0), (y, 1)):
        found = Sampler(scale, pixels, (0, 0))(scale.enlarged(ramp))
        np.testing.assert_allclose(found, pixels[:, axis], atol=0.05)  # cubic interpolation bends a ramp a little


def test_fields_over_a_box_are_sampled_at_the_points():
    scale = Scale(_mask(40, 60, 20), 40)
    pixels = np.array([[10, 8], [13, 8], [11, 9]], dtype=np.int32)
    field = np.zeros((30, 40, 2), dtype=np.float32)
    y, x = np.mgrid[:30, :40]
    field[..., 0], field[..., 1] = x + 12, y + 7  # where it lies in the enlarged image
    np.testing.assert_allclose(Sampler(scale, pixels, (12, 7))(field), 2 * pixels + 0.5)
    flags = Sampler(scale, pixels, (12, 7))(x + 12 > 23)
    assert flags.dtype == np.bool_
    assert flags.tolist() == [False, True, False]


def test_more_points_than_an_image_may_have_rows():
    mask = np.ones((300, 300), dtype=bool)
    scale = Scale(mask, 0)
    y, x = np.nonzero(mask)
    pixels = np.stack([x, y], axis=1).astype(np.int32)
    field = np.random.default_rng(0).random((300, 300), dtype=np.float32)
    np.testing.assert_array_equal(Sampler(scale, pixels, (0, 0))(field), field[y, x])


@pytest.mark.parametrize("method", ["dis", "subspace"])
def test_tracks_are_in_the_pixels_of_the_video(method):
    size = 72
    texture = textured(size, 2)
    texture = (0.5 + 0.14 * texture / texture.std()).astype(np.float32)
    y, x = np.mgrid[:size, :size].astype(np.float32) / size - 0.5
    time = np.sin(np.linspace(0, np.pi, 6, dtype=np.float32))[:, None, None]
    motion = np.stack([4 * time * (0.5 + x), 3 * time * y + 0 * x], axis=-1)
    frames = np.stack([warped(texture, m) for m in motion])
    mask = np.zeros((size, size), dtype=bool)
    mask[16:56, 16:56] = True
    found = {}
    for wanted in (0, 60):
        found[wanted] = track(frames, mask, 0, method, 2, rounds=2, fine=6, sweeps=1, object_size=wanted)
        px, py = found[wanted].layout.pixels.T
        away = np.linalg.norm(found[wanted].tracks.points - found[wanted].layout.pixels - motion[:, py, px], axis=2)
        assert away.mean() < 0.35
        assert np.median(found[wanted].deviation[1:]) < 1
    assert (found[0].diagnostics.scale, found[60].diagnostics.scale) == (1.0, 1.5)
    np.testing.assert_array_equal(found[0].layout.pixels, found[60].layout.pixels)
    np.testing.assert_array_equal(found[60].tracks.points[0], found[60].layout.pixels)
    assert found[60].layout.image_size == (size, size)
