"""The photometric fit, landmarks and revisiting against known motion; noise and specks against known ones."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.tracking import TrackingOptions, track
from nrsfm.tracking.landmarks import Landmarks
from nrsfm.tracking.matching import Template, despeckled, evened, noise_level, smoothing
from nrsfm.tracking.photometric import FINE_BAND, FINE_WINDOW, fit
from nrsfm.tracking.revisiting import continued, revisit

from .conftest import textured, warped

cv2 = pytest.importorskip("cv2")

SIZE = 120
FRAMES = 12


def _texture(size: int = SIZE) -> np.ndarray:
    image = textured(size, 5)
    return (127 + 36 * image / image.std()).astype(np.float32)


def _motion() -> np.ndarray:
    """Displacements (F, H, W, 2) of three trajectories, 0 in frame 0."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32) / SIZE - 0.5
    time = np.linspace(0, 2 * np.pi, FRAMES, dtype=np.float32)[:, None, None]
    dx = 5 * np.sin(time) * (0.6 + x) + 2 * (np.cos(time) - 1) * np.sin(4 * y)
    return np.stack([dx, 4 * np.sin(time) * y + (np.cos(time) - 1) * np.cos(3 * x)], axis=-1).astype(np.float32)


@pytest.fixture(scope="module")
def video() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    motion = _motion()
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[20:100, 20:100] = True
    return np.stack([warped(_texture(), m) for m in motion]), mask, motion


def _templates(images: np.ndarray, mask: np.ndarray, **options: int) -> tuple[Template, Template]:
    chosen = TrackingOptions(**options)
    wide = np.stack([evened(image, chosen.normalisation) for image in images])
    fine = np.stack([evened(image, *FINE_BAND) for image in images])
    return Template(wide, mask, 0, chosen), Template(fine, mask, 0, chosen, FINE_WINDOW)


def test_fit_removes_drift_and_spans_what_has_no_texture(video):
    images, mask, motion = video
    images = images.copy()
    images[:, :, :] += np.random.default_rng(0).normal(0, 4, images.shape).astype(np.float32)
    wide, fine = _templates(images, mask, rank=6, fine=12)
    box = (slice(wide.top, wide.top + wide.shape[0]), slice(wide.left, wide.left + wide.shape[1]))
    true = motion[:, box[0], box[1]]
    drift = np.linspace(0, 2.5, FRAMES, dtype=np.float32)[:, None, None, None]
    flows = (true + drift * np.array([1, -0.5], dtype=np.float32)).astype(np.float32)
    found = fit(wide, fine, flows, lambda: None)
    away = np.linalg.norm(flows - true, axis=-1)[:, wide.inside]
    assert np.median(away) < 0.15
    assert away.mean() < 0.25
    assert not flows[0].any()
    assert found.basis.shape[1] <= 7


def test_landmarks_find_a_far_shift_and_refuse_chance():
    big = _texture(240)
    images = np.stack([big[60:180, 60:180], big[30:150, 85:205]])  # moved by (-25, +30)
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[20:80, 40:110] = True
    template, _ = _templates(images, mask)
    suggested = Landmarks(template).suggestion(1)
    assert suggested is not None
    assert np.abs(np.median(suggested[template.inside], axis=0) - (-25, 30)).max() < 0.3
    other = np.random.default_rng(1).uniform(0, 255, (SIZE, SIZE)).astype(np.float32)
    template, _ = _templates(np.stack([images[0], other]), mask)
    assert Landmarks(template).suggestion(1) is None


def test_revisiting_finds_again_what_is_far_off_and_leaves_what_is_right():
    big = _texture(240)
    images = np.stack([big[60:180, 60:180], big[58:178, 63:183], big[30:150, 85:205]])
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[20:80, 40:110] = True
    template, _ = _templates(images, mask)
    flows = np.zeros((3, *template.shape, 2), dtype=np.float32)
    flows[1] = (-3, 2)
    trusts = np.stack([template.seen(f, flows[f]) for f in range(3)])
    flows, _ = revisit(template, flows, trusts, 2, lambda: None)
    np.testing.assert_allclose(np.median(flows[1][template.inside], axis=0), (-3, 2), atol=0.1)
    np.testing.assert_allclose(np.median(flows[2][template.inside], axis=0), (-25, 30), atol=0.3)


def test_trusted_flow_goes_on_affinely():
    y, x = np.mgrid[:80, :90].astype(np.float32)
    flow = np.dstack([3 - 0.3 * x, 1 + 0.1 * y])
    trust = np.zeros((80, 90), dtype=np.float32)
    trust[:, :50] = 1
    broken = np.where(trust[..., None] > 0, flow, 40).astype(np.float32)
    found = continued(broken, trust)
    assert np.abs(found - flow)[20:60, 50:60].max() < 1.0
    assert np.abs(found - flow)[20:60, 20:40].max() < 0.2
    np.testing.assert_array_equal(continued(broken, np.zeros_like(trust)), broken)


def test_specks_go_and_noise_and_texture_stay():
    image = _texture()
    rng = np.random.default_rng(2)
    hit = rng.random(image.shape) < 0.05
    speckled = np.where(hit, rng.choice([0.0, 255.0], image.shape), image).astype(np.float32)
    clean = despeckled(speckled)
    assert np.abs(clean - image)[hit].mean() < 0.15 * np.abs(speckled - image)[hit].mean()
    assert (np.abs(despeckled(image) - image) > 0).mean() < 0.01
    noisy = image + rng.normal(0, 50, image.shape).astype(np.float32)
    assert (np.abs(despeckled(noisy) - noisy) > 0).mean() < 0.01


def test_noise_is_measured_and_smoothed_for():
    flat = cv2.GaussianBlur(_texture(), (0, 0), 4)
    for sigma in (5.0, 20.0):
        noisy = flat + np.random.default_rng(3).normal(0, sigma, flat.shape).astype(np.float32)
        assert abs(noise_level(noisy) / sigma - 1) < 0.1
    assert smoothing(0.7, 0.0) == 0.7
    assert smoothing(0.7, 1000.0) == 2.0


def test_fit_is_repeatable_and_can_be_left_out(video):
    images, mask, _ = video
    frames = np.clip(images[:5], 0, 255).astype(np.uint8)
    asked = {"reference": 0, "rounds": 1, "step": 2}
    first, second = (track(frames, mask, fine=4, sweeps=1, **asked).tracks.points for _ in range(2))
    np.testing.assert_array_equal(first, second)
    without = track(frames, mask, fine=0, sweeps=0, **asked)
    assert "photometric fit" not in without.diagnostics.seconds
    assert np.median(np.abs(without.tracks.points - first)) < 0.5
