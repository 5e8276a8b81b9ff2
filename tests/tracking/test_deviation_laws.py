"""Laws of the parts that deviations are made of."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.tracking import TrackingOptions, track
from nrsfm.tracking.deviation import Deviations
from nrsfm.tracking.matching import Template, evened

from .conftest import textured

cv2 = pytest.importorskip("cv2")

SIZE = 96


def _texture() -> np.ndarray:
    image = textured(SIZE, 5)
    return (127 + 36 * image / image.std()).astype(np.float32)


def _template(image: np.ndarray) -> Template:
    return Template(evened(image, 6.0)[None], np.ones((SIZE, SIZE), dtype=bool), 0, TrackingOptions())


def test_a_window_knows_less_in_noise_on_an_edge_and_where_there_is_nothing():
    x = np.mgrid[:SIZE, :SIZE][1].astype(np.float32)
    noise = np.random.default_rng(1).normal(0, 10, (SIZE, SIZE))
    images = {"texture": _texture(), "flat": np.full_like(x, 127), "stripes": 127 + 40 * np.sin(x / 3)}
    found = {}
    for name, image in images.items():
        template = _template(image)
        told = Deviations(template)
        found[name] = [np.sqrt(np.median(told.window(template.image + k * noise))) for k in (0.5, 1, 2)]
    # Proportional while noise is well below contrast; contrasts are matched, which shrinks stronger noise.
    assert found["texture"][0] / found["texture"][1] == pytest.approx(0.5, rel=0.1)
    assert found["texture"][2] > 1.5 * found["texture"][1]
    assert found["flat"][1] > 5 * found["texture"][1]
    assert found["stripes"][1] > 5 * found["texture"][1]
    assert max(found["flat"]) < 20  # no more than how far a match is believed


def test_variance_of_a_difference_is_half_its_mean_square():
    template = _template(_texture())
    difference = np.broadcast_to(np.array([3.0, 4.0], dtype=np.float32), (*template.shape, 2))
    np.testing.assert_allclose(Deviations(template).disagreement(difference), 12.5, rtol=2e-2)


def test_direct_matching_finds_the_remaining_shift():
    template = _template(_texture())
    moved = np.roll(template.image, (0, 1), axis=(0, 1))
    rest = Deviations(template).remainder(moved)[16:-16, 16:-16]
    np.testing.assert_allclose(np.median(rest, axis=(0, 1)), (1, 0), atol=0.15)


@pytest.mark.parametrize(("count", "asked"), [(2, {}), (4, {"fine": 0, "rounds": 1, "sweeps": 0})])
def test_two_frames_and_no_photometric_fit_have_deviations_too(count, asked):
    frames = np.stack([np.roll(_texture(), f, axis=1) for f in range(count)]).clip(0, 255).astype(np.uint8)
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[16:80, 16:80] = True
    found = track(frames, mask, 0, step=4, **asked)
    told = found.deviation[found.tracks.visible]
    assert np.isfinite(told).all()
    assert (told > 0).all()
