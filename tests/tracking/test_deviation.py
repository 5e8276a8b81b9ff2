"""How far a track may be off, and what a reconstruction takes of it."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm import Tracks
from nrsfm.errors import InputError, OptionError
from nrsfm.tracking import track, usable

from .conftest import textured, warped

cv2 = pytest.importorskip("cv2")

SIZE, FRAMES = 96, 8


@pytest.fixture(scope="module", params=["subspace", "dis", "naive"])
def found(request):
    """A video whose right half has little texture, with noise; tracks, and the true ones."""
    image = textured(SIZE, 0)
    image[:, SIZE // 2 :] *= 0.04
    texture = (0.5 + 0.14 * image / image.std()).astype(np.float32)
    time = np.linspace(0, np.pi, FRAMES, dtype=np.float32)[:, None, None]
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32) / SIZE - 0.5
    motion = np.stack([5 * np.sin(time) * (0.4 + x), 4 * np.sin(time) * y + (np.cos(time) - 1) * x], axis=-1)
    noise = np.random.default_rng(0).normal(size=(FRAMES, SIZE, SIZE))
    frames = np.stack([warped(texture, m) for m in motion.astype(np.float32)]) + 0.02 * noise
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[12:84, 12:84] = True
    result = track(np.clip(frames, 0, 1).astype(np.float32), mask, 0, request.param, 2, rounds=3, fine=8, sweeps=1)
    x, y = result.layout.pixels.T
    return result, result.layout.pixels + motion[:, y, x]


def test_there_is_one_for_every_visible_entry(found):
    result, _ = found
    seen = result.tracks.visible
    assert result.deviation.shape == seen.shape
    assert result.deviation.dtype == np.float32
    assert (result.deviation[seen] > 0).all()
    assert np.isfinite(result.deviation[seen]).all()
    assert np.isinf(result.deviation[~seen]).all()
    assert (result.deviation[result.diagnostics.reference] <= 0.05).all()


def test_little_texture_is_less_certain(found):
    result, _ = found
    x = result.layout.pixels[:, 0]
    flat, rich = (np.ma.masked_invalid(result.deviation[1:, part]) for part in (x > 56, x < 40))
    assert np.ma.median(flat) > 2 * np.ma.median(rich)


def test_large_deviations_are_large_errors(found):
    result, truth = found
    seen = result.tracks.visible.copy()
    seen[0] = False
    error, told = np.linalg.norm(result.tracks.points - truth, axis=2)[seen], result.deviation[seen]
    order = np.argsort(told)
    third = len(order) // 3
    assert error[order[-third:]].mean() > 1.5 * error[order[:third]].mean()
    assert 0.3 < np.mean(error / np.sqrt(2) < told) <= 1.0


@pytest.fixture
def told():
    rng = np.random.default_rng(0)
    visible = rng.random((5, 40)) < 0.9
    deviation = rng.uniform(0.5, 1.0, size=(5, 40))
    deviation[1, :4], deviation[2] = 3.0, np.linspace(5.0, 6.0, 40)
    deviation[3] = 0.05  # the reference
    return Tracks(rng.normal(size=(5, 40, 2)), visible), deviation


def test_what_is_too_uncertain_counts_as_unseen(told):
    tracks, deviation = told
    kept, level = usable(tracks, deviation, 2.0)
    before = tracks.visible
    assert not kept.visible[1, :4].any()
    assert np.array_equal(kept.visible[[0, 3, 4]], before[[0, 3, 4]])
    assert np.array_equal(kept.visible[1, 4:], before[1, 4:])
    few = np.flatnonzero(kept.visible[2])
    seen = np.flatnonzero(before[2])
    assert 0.2 * len(seen) < len(few) < 0.35 * len(seen)
    assert np.array_equal(few, seen[: len(few)]), "the most certain of a frame stay"
    used = kept.visible.copy()
    used[3] = False
    assert level == pytest.approx(np.sqrt(np.mean(deviation[used] ** 2)))
    assert kept.points is tracks.points or np.shares_memory(kept.points, tracks.points)


def test_complete_tracks_and_entries_of_which_nothing_is_known():
    points = np.random.default_rng(0).normal(size=(3, 8, 2))
    deviation = np.full((3, 8), 0.5)
    deviation[1, 2] = np.inf
    kept, level = usable(Tracks(points), deviation)
    assert kept.n_missing == 1
    assert not kept.visible[1, 2]
    assert level == 0.0  # all alike in every frame


@pytest.mark.parametrize(
    "bad", [np.full((5, 40), -1.0), np.full((5, 40), np.nan), np.ones((4, 40)), np.ones((5, 40), int)]
)
def test_bad_deviations(told, bad):
    with pytest.raises(InputError, match="deviation: "):
        usable(told[0], bad)


@pytest.mark.parametrize("bad", [0, -1.0, float("nan"), True, "2"])
def test_bad_multiples(told, bad):
    with pytest.raises(OptionError, match="multiple must be"):
        usable(*told, bad)
