"""What CoTracker, TAPIR and TAP-Vid write comes back as the same tracks."""

from pathlib import Path

import numpy as np
import pytest

from nrsfm.errors import FileError, InputError
from nrsfm.files import load_tracks
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


def test_load_tracks_reads_what_a_named_tracker_wrote(tmp_path: Path) -> None:
    soft = np.where(SEEN, 0.9, 0.2)
    np.savez(tmp_path / "a.npz", pred_tracks=POINTS[None], pred_visibility=soft[None])
    with pytest.raises(FileError, match="--tracker"):
        load_tracks(tmp_path / "a.npz")
    np.testing.assert_array_equal(load_tracks(tmp_path / "a.npz", tracker="cotracker").visible, SEEN)
    first = POINTS.swapaxes(0, 1) + 0.5
    np.savez(tmp_path / "b.npz", tracks=first, occluded=_logit(~SEEN.T), expected_dist=np.full((N, F), -9.0))
    with pytest.raises(FileError, match=r"ambiguous.*--tracker"):
        load_tracks(tmp_path / "b.npz")
    found = load_tracks(tmp_path / "b.npz", tracker="tapir")
    np.testing.assert_allclose(found.points, POINTS, atol=1e-9)
    # Seen at half the size: positions double about the outer corner of the first pixel.
    found = load_tracks(tmp_path / "b.npz", tracker="tapir", image_size=(640, 480), seen_size=(320, 240))
    np.testing.assert_allclose(found.points, 2 * (POINTS + 0.5) - 0.5, atol=1e-9)
    np.savez(tmp_path / "c.npz", points=first / [320, 240], occluded=~SEEN.T)
    found = load_tracks(tmp_path / "c.npz", tracker="tapvid", image_size=(320, 240))
    np.testing.assert_allclose(found.points, POINTS, atol=1e-9)


def test_what_does_not_go_with_a_tracker_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", tracks=POINTS, visibility=SEEN)
    for wrong in ({"order": "matrix"}, {"name": "tracks"}):
        with pytest.raises(InputError, match="beside it"):
            load_tracks(tmp_path / "a.npz", tracker="cotracker", **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="seen_size needs tracker"):
        load_tracks(tmp_path / "a.npz", seen_size=(3, 4))
    with pytest.raises(InputError, match="did you mean 'cotracker'"):
        load_tracks(tmp_path / "a.npz", tracker="cotraker")


@pytest.mark.parametrize("name", ["tapvid.pkl", "out put.pt", "ä.pickle"])
def test_pickles_are_refused_with_the_way_out(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\x80\x04.")
    with pytest.raises(FileError, match=r"pickles.*numpy\.savez") as caught:
        load_tracks(tmp_path / name)
    assert "\n" not in str(caught.value)
