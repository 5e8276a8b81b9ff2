"""The truth of tracked pixels: exact on true points, linear between them, silent across gaps."""

import numpy as np
import pytest

from nrsfm.errors import FileError, InputError
from nrsfm.tracks import Tracks
from nrsfm.video.truth import VideoTruth, load_video_truth, match_truth

F = 5
GRID = np.stack(np.meshgrid(np.arange(0, 40, 4.0), np.arange(0, 40, 4.0)), axis=-1).reshape(-1, 2)
RNG = np.random.default_rng(0)
MOTION = np.eye(2) + 0.2 * RNG.standard_normal((F, 2, 2))
MOTION[2] = np.eye(2)
TILT = RNG.standard_normal((F, 2, 3))
NUMBERS = np.arange(F)


def _tracks(points: np.ndarray) -> np.ndarray:
    return np.einsum("pi,fij->fpj", points, MOTION)


def _truth(**changes: object) -> VideoTruth:
    parts = {
        "tracks": Tracks(_tracks(GRID), np.ones((F, len(GRID)), dtype=bool)),
        "shapes": np.einsum("pi,fij->fpj", GRID, TILT),
        "valid": None,
        "rotations": np.tile(np.eye(3), (F, 1, 1)),
        "image_size": (40.0, 40.0),
    }
    return VideoTruth(**{**parts, **changes})  # type: ignore[arg-type]


def test_true_points_are_exact_and_affine_motion_between_them_too() -> None:
    pixels = np.concatenate([GRID[::7], RNG.integers(1, 35, (30, 2)).astype(float)])
    found = match_truth(_truth(), pixels, 2, NUMBERS, (40, 40))
    assert found.known.all()
    assert found.tracks is not None
    assert found.shapes is not None
    np.testing.assert_array_equal(found.tracks[:, : len(GRID[::7])], _tracks(GRID)[:, ::7])
    np.testing.assert_allclose(found.tracks, _tracks(pixels), atol=1e-9)
    np.testing.assert_allclose(found.shapes, np.einsum("pi,fij->fpj", pixels, TILT), atol=1e-9)


def test_a_gap_in_the_image_or_in_space_and_the_outside_have_no_truth() -> None:
    pixels = np.array([[6.0, 6.0], [18.0, 18.0], [60.0, 60.0]])
    seen = np.ones((F, len(GRID)), dtype=bool)
    seen[2, (np.abs(GRID - 18) < 9).all(axis=1)] = False  # hidden in the reference frame: a hole of 20 pixels
    found = match_truth(_truth(tracks=Tracks(_tracks(GRID), seen)), pixels, 2, NUMBERS, (40, 40))
    assert found.known.tolist() == [True, False, False]
    assert found.valid is not None
    assert not found.valid[:, 1:].any()
    cliff = np.einsum("pi,fij->fpj", GRID, TILT)
    cliff[:, GRID[:, 0] > 16, 2] += 500  # the pixel lies between two layers
    found = match_truth(_truth(shapes=cliff), pixels, 2, NUMBERS, (40, 40))
    assert found.known.tolist() == [True, False, False]


def test_visibility_is_that_of_the_nearest_corner_and_unknown_shapes_stay_unknown() -> None:
    seen = np.ones((F, len(GRID)), dtype=bool)
    seen[0, 0] = False
    valid = np.ones((F, len(GRID)), dtype=bool)
    valid[1, 0] = False
    shapes = np.einsum("pi,fij->fpj", GRID, TILT)
    shapes[1, 0] = np.nan
    truth = _truth(tracks=Tracks(_tracks(GRID), seen), valid=valid, shapes=shapes)
    found = match_truth(truth, np.array([[0.0, 0.0], [0.5, 0.5], [30.0, 30.0]]), 2, NUMBERS, (40, 40))
    assert found.visible is not None
    assert found.valid is not None
    assert found.visible[0].tolist() == [False, False, True]
    assert found.valid[1].tolist() == [False, False, True]
    assert np.isfinite(found.shapes).all()  # type: ignore[call-overload]


def test_chosen_frames_and_another_size_of_the_image() -> None:
    numbers = np.array([0, 2, 4])
    pixels = 2 * (GRID[:5] + 0.5) - 0.5
    found = match_truth(_truth(), pixels, 1, numbers, (80, 80))
    np.testing.assert_allclose(found.tracks, 2 * (_tracks(GRID)[numbers][:, :5] + 0.5) - 0.5, atol=1e-9)  # type: ignore[arg-type]
    assert len(found.rotations) == 3  # type: ignore[arg-type]
    with pytest.raises(InputError, match="3 frames are needed, or at least 10"):
        match_truth(_truth(), pixels, 1, np.array([0, 2, 9]), (40, 40))


def test_shapes_alone_are_those_of_the_pixels_in_their_order() -> None:
    found = match_truth(_truth(tracks=None), GRID, 2, NUMBERS, (40, 40))
    assert (found.tracks, found.known.all()) == (None, True)
    with pytest.raises(InputError, match="tracks beside the shapes are needed"):
        match_truth(_truth(tracks=None), GRID[:7], 2, NUMBERS, (40, 40))
    with pytest.raises(InputError, match="at least one of the tracked pixels"):
        match_truth(_truth(), GRID[:7] + 900, 2, NUMBERS, (40, 40))


def test_a_file_without_truth_is_refused(tmp_path) -> None:
    np.savez(tmp_path / "a.npz", rotations=np.tile(np.eye(3), (F, 1, 1)))
    with pytest.raises(FileError, match="tracks or shapes are needed"):
        load_video_truth(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", tracks=_tracks(GRID), shapes=np.zeros((F, 3, 3)))
    with pytest.raises(FileError, match="of the tracks, are needed"):
        load_video_truth(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", tracks=_tracks(GRID), image_size=[40, 30])
    assert load_video_truth(tmp_path / "a.npz").image_size == (40.0, 30.0)
