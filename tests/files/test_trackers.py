"""What CoTracker, TAPIR and TAP-Vid write comes back as the same tracks."""

from pathlib import Path

import numpy as np
import pytest

from nrsfm.errors import FileError, InputError
from nrsfm.files.trackers import load_tracker

F, N = 7, 5
POINTS = np.random.default_rng(0).uniform(0, 200, (F, N, 2))
SEEN = np.random.default_rng(1).random((F, N)) < 0.7


def _logit(flags: np.ndarray) -> np.ndarray:
    return np.where(flags, 4.0, -4.0).astype(np.float32)


def _check(path: Path, **options: object) -> None:
    tracks = load_tracker(path, **options)  # type: ignore[arg-type]
    np.testing.assert_allclose(tracks.points, POINTS, atol=1e-9)
    np.testing.assert_array_equal(tracks.visible, SEEN)


@pytest.mark.parametrize("batch", [False, True])
def test_every_tracker_is_told_from_its_names(tmp_path: Path, batch: bool) -> None:
    lead = (lambda a: a[None]) if batch else (lambda a: a)
    path = tmp_path / "a b.npz"
    np.savez(path, pred_tracks=lead(POINTS), pred_visibility=lead(SEEN))
    _check(path)
    np.savez(path, tracks=lead(POINTS), visibility=lead(np.where(SEEN, 0.9, 0.2)))
    _check(path)
    first = POINTS.swapaxes(0, 1) + 0.5
    np.savez(path, tracks=lead(first), visibles=lead(SEEN.T))
    _check(path)
    np.savez(path, tracks=lead(first), occluded=lead(_logit(~SEEN.T)), expected_dist=lead(_logit(np.zeros((N, F)) > 1)))
    _check(path)
    np.savez(path, points=lead((first) / [320, 240]), occluded=lead(~SEEN.T))
    _check(path, image_size=(320, 240))


def test_an_uncertain_position_counts_as_hidden(tmp_path: Path) -> None:
    far = np.zeros((N, F), dtype=bool)
    far[2] = True
    np.savez(tmp_path / "a.npz", tracks=POINTS.swapaxes(0, 1), occluded=_logit(~SEEN.T), expected_dist=_logit(far))
    np.testing.assert_array_equal(load_tracker(tmp_path / "a.npz").visible, SEEN & ~far.T)


def test_confidence_multiplies_and_the_threshold_decides(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", tracks=POINTS, visibility=np.full((F, N), 0.8), confidence=np.where(SEEN, 0.8, 0.5))
    np.testing.assert_array_equal(load_tracker(tmp_path / "a.npz").visible, SEEN)
    assert (
        load_tracker(tmp_path / "a.npz", threshold=0.3).visible is None
        or load_tracker(tmp_path / "a.npz", threshold=0.3).visible.all()
    )  # type: ignore[union-attr]


def test_an_array_without_a_name_must_state_its_order(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    with pytest.raises(FileError, match="order of its axes is ambiguous: state it"):
        load_tracker(tmp_path / "a.npy")
    np.testing.assert_array_equal(load_tracker(tmp_path / "a.npy", order="frame-first").points, POINTS)
    turned = load_tracker(tmp_path / "a.npy", order="point-first").points
    np.testing.assert_array_equal(turned, POINTS.swapaxes(0, 1))
    np.testing.assert_array_equal(load_tracker(tmp_path / "a.npy", tracker="cotracker").points, POINTS)


def test_a_resized_image_is_scaled_back(tmp_path: Path) -> None:
    """The centre of a pixel of the small image is the centre of the area it came from."""
    np.savez(tmp_path / "a.npz", pred_tracks=np.zeros((F, N, 2)))
    tracks = load_tracker(tmp_path / "a.npz", image_size=(512, 256), seen_size=(256, 256))
    np.testing.assert_allclose(tracks.points[0, 0], [0.5, 0])
    np.savez(tmp_path / "b.npz", tracks=np.full((N, F, 2), 256.0), visibles=np.ones((N, F), bool))
    corner = load_tracker(tmp_path / "b.npz", image_size=(512, 300), seen_size=(256, 256)).points[0, 0]
    np.testing.assert_allclose(corner, [511.5, 299.5])


def test_refusals(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for arrays, options, kind, message in (
        ({"points": POINTS, "occluded": SEEN}, {}, InputError, "image_size is needed"),
        ({"points": POINTS, "occluded": SEEN}, {"image_size": (9, 9)}, FileError, "relative to the image"),
        ({"tracks": POINTS, "visibility": 3 * SEEN}, {}, FileError, "from 0 to 1"),
        ({"tracks": np.stack([POINTS] * 2), "visibility": SEEN}, {}, FileError, "batch of 2"),
        ({"tracks": POINTS, "visibility": SEEN.T}, {}, FileError, "visibility: shape"),
        ({"other": POINTS}, {}, FileError, "holds no tracks"),
        ({"tracks": POINTS}, {}, FileError, "ambiguous"),
        ({"tracks": POINTS}, {"tracker": "tapvid"}, FileError, "needs an array named points"),
        ({"tracks": POINTS}, {"tracker": "tapier"}, InputError, "did you mean 'tapir'"),
        ({"tracks": POINTS}, {"seen_size": (9, 9)}, InputError, "needs image_size"),
        ({"tracks": POINTS}, {"order": "matrix"}, InputError, "order must be"),
    ):
        np.savez(path, **arrays)
        with pytest.raises(kind, match=message):
            load_tracker(path, **options)
