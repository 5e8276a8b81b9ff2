"""Lost regions: what a low-rank model of the trusted entries predicts, and what is found again with it."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.tracking import TrackingOptions, track
from nrsfm.tracking.extrapolation import beginnings, extrapolate, factorise, matches, trust
from nrsfm.tracking.matching import Template, evened

from .conftest import textured, warped

cv2 = pytest.importorskip("cv2")

SIZE, FRAMES = 120, 14


def _motion(frames: int = FRAMES) -> np.ndarray:
    """Displacements (F, H, W, 2) of a rigid relief that turns and moves, seen orthographically; 0 in frame 0."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32) - SIZE / 2
    depth = 40 * np.exp(-6 * (x**2 + y**2) / SIZE**2) + 10 * np.sin(5 * x / SIZE) * y / SIZE
    time = np.linspace(0, 1, frames, dtype=np.float32)[:, None, None]
    yaw, pitch, roll = 0.5 * np.sin(5 * time), 0.4 * np.sin(7 * time), 0.2 * np.sin(4 * time)
    across = np.cos(yaw) * x + np.sin(yaw) * depth
    down = np.cos(pitch) * y - np.sin(pitch) * (np.cos(yaw) * depth - np.sin(yaw) * x)
    turned = np.stack(
        [np.cos(roll) * across - np.sin(roll) * down, np.sin(roll) * across + np.cos(roll) * down], axis=-1
    )
    shift = np.stack([9 * time, -4 * time], axis=-1)
    return (turned - np.stack([x, y], axis=-1) + shift).astype(np.float32)


@pytest.fixture(scope="module")
def video() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    motion = _motion()
    image = textured(SIZE, 5)
    image = (127 + 36 * image / image.std()).astype(np.float32)
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[20:100, 20:100] = True
    return np.stack([warped(image, m) for m in motion]), mask, motion


@pytest.fixture(scope="module")
def template(video) -> Template:
    images, mask, _ = video
    return Template(np.stack([evened(image, 6.0) for image in images]), mask, 0, TrackingOptions())


def _cut(template: Template, motion: np.ndarray) -> np.ndarray:
    rows = slice(template.top, template.top + template.shape[0])
    return motion[:, rows, template.left : template.left + template.shape[1]].copy()


@pytest.mark.parametrize(("outliers", "median", "most"), [(0.0, 0.02, 0.2), (0.05, 0.2, 1.0)])
def test_what_is_hidden_follows_from_what_is_trusted(outliers, median, most):
    """Half of the entries hidden, and of the others every twentieth far off: the rest determine nearly all."""
    rng = np.random.default_rng(0)
    motion = _motion()[:, 20:100, 20:100]
    flows, trusts = motion.copy(), (rng.random(motion.shape[:3]) < 0.5).astype(np.float32)
    wrong = (rng.random(trusts.shape) < outliers) & (trusts > 0)
    flows[wrong] += rng.uniform(10, 30, (np.count_nonzero(wrong), 2)).astype(np.float32)
    flows[trusts == 0] = np.float32(1e3)  # never looked at
    found = factorise(flows, trusts, np.ones((80, 80), dtype=bool), 2, 3)
    predicted = (found.basis @ found.coefficients.T).reshape(FRAMES, 2, -1)
    away = np.abs(predicted - motion[:, ::2, ::2].reshape(FRAMES, -1, 2).transpose(0, 2, 1))
    assert np.median(away) < median
    assert np.quantile(away, 0.95) < most


def test_trust_is_where_the_frame_looks_like_the_reference(template, video):
    true = _cut(template, video[2])
    wrong = true.copy()
    wrong[:, :, 60:] += 14
    right, found = trust(template, true), trust(template, wrong)
    inside = template.inside
    assert right[:, inside].mean() > 0.8
    assert found[1:, :, 70:][:, inside[:, 70:]].mean() < 0.15
    np.testing.assert_array_equal(found[0], template.weight)
    assert (right[:, ~inside] == 0).all()


def test_a_lost_region_is_found_again(template, video):
    """A quarter of the object is lost from the fifth frame on, by more than local matching can repair."""
    true = _cut(template, video[2])
    flows = true.copy()
    flows[5:, 55:, 55:] += np.array([16, -13], dtype=np.float32)
    lost = template.inside.copy()
    lost[:60], lost[:, :60] = False, False
    told = []
    found = extrapolate(template, flows.copy(), lambda: told.append(1))
    away = np.linalg.norm(found - true, axis=-1)
    assert np.linalg.norm(flows - true, axis=-1)[5:, lost].min() > 20
    assert np.median(away[5:, lost]) < 0.3
    assert np.mean(away[:, template.inside] < 1) > 0.9
    np.testing.assert_array_equal(found[0], flows[0])
    assert len(told) == matches(FRAMES)


def test_short_videos_bear_fewer_ranks():
    assert beginnings(99) == beginnings(36) == [[3, 6, 9, 12], [6, 9, 12]]
    assert beginnings(30) == [[3, 6, 9, 10], [6, 9, 10]]
    assert beginnings(14) == [[3, 4], [4]]
    assert beginnings(9) == [[3]]
    assert beginnings(3) == [[1]]


def test_nothing_trusted_changes_nothing_much(template):
    flows = np.full((FRAMES, *template.shape, 2), 40, dtype=np.float32)
    flows[0] = 0
    found = extrapolate(template, flows, lambda: None)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("frames", [3, 4])
def test_few_frames_and_the_option(video, frames):
    images, mask, motion = video
    for wanted in (True, False):
        found = track(
            images[:frames].round().clip(0, 255).astype(np.uint8), mask, 0, step=4, fine=4, extrapolate=wanted
        )
        x, y = found.layout.pixels.T
        away = np.linalg.norm(found.tracks.points - found.layout.pixels - motion[:frames, y, x], axis=-1)
        assert np.median(away) < 0.3
        assert ("extrapolation" in found.diagnostics.seconds) is wanted
