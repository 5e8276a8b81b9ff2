"""Cuts are found and nothing else is; still videos are told from moving ones; the reference shows the object."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from nrsfm.errors import InputError
from nrsfm.video import check_frames, is_still, open_frames, reference_frame, scene_cuts, write_video
from nrsfm.video.frames import Frames, _small

from .conftest import scene


def _copies(images: list[np.ndarray]) -> np.ndarray:
    return np.stack([_small(image) for image in images])


def _worse(images: list[np.ndarray], how: str) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    changed = []
    for f, image in enumerate(images):
        new = image.astype(np.float32)
        if how == "noise":
            new += 20 * rng.standard_normal(new.shape)
        elif how == "flicker":
            new = new * (0.5 if f % 6 < 3 else 1.0) + 15 * (f % 2)
        elif how == "blur" and 8 <= f < 14:
            new = cv2.GaussianBlur(new, (0, 0), 2.5)
        elif how == "salt":
            new[rng.random(new.shape[:2]) < 0.05] = 255
        changed.append(np.clip(new, 0, 255).astype(np.uint8))
    return changed


HOW = ["plain", "noise", "flicker", "blur", "salt"]


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("speed", [0.5, 3.5])
def test_one_scene_has_no_cut(how: str, speed: float) -> None:
    assert scene_cuts(_copies(_worse(scene(3, speed=speed), how))) == []


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_cut_is_found_where_it_is(how: str, seed: int) -> None:
    images = scene(seed)[:11] + scene(seed + 50)[:13]
    assert scene_cuts(_copies(_worse(images, how))) == [11]


def test_a_moving_camera_is_no_cut() -> None:
    """The window jumps by a tenth of its width in the middle of a slow pan."""
    wide = scene(5, width=400, frames=1)[0]
    places = np.cumsum([2] * 8 + [13] * 3 + [2] * 8)
    assert scene_cuts(_copies([wide[:, x : x + 120] for x in places])) == []


def test_several_cuts_and_a_black_frame() -> None:
    images = scene(0)[:9] + scene(60)[:8] + scene(61)[:8]
    assert scene_cuts(_copies(images)) == [9, 17]
    black = scene(0)[:9] + [np.zeros((90, 120, 3), np.uint8)] * 8
    assert scene_cuts(_copies(black)) == [9]


@pytest.mark.parametrize("level", [0, 2, 15])
def test_a_still_scene_under_noise_and_light_is_still(level: int) -> None:
    rng = np.random.default_rng(0)
    image = scene(2)[0].astype(float) * 0.8
    shots = [image * (1 + 0.1 * np.sin(f)) + level * rng.standard_normal(image.shape) for f in range(12)]
    assert is_still(_copies([np.clip(s, 0, 255).astype(np.uint8) for s in shots]))


@pytest.mark.parametrize("level", [0, 4])
def test_a_small_or_slow_motion_is_seen(level: int) -> None:
    rng = np.random.default_rng(0)
    still = scene(2)[0].astype(float)
    shots = []
    for f in range(12):
        image = still.copy()
        image[40:52, 50 + f // 3 : 62 + f // 3] = still[10:22, 10:22]
        shots.append(np.clip(image + level * rng.standard_normal(image.shape), 0, 255).astype(np.uint8))
    assert not is_still(_copies(shots))
    assert not is_still(_copies(scene(2, speed=0.1)[:6]))


def test_refusals_name_the_video_and_the_frame(tmp_path: Path) -> None:
    write_video(tmp_path / "cut.mkv", scene(0)[:11] + scene(50)[:13], lossless=True)
    with pytest.raises(InputError, match=r"one scene is needed, '.*cut.mkv' has a scene cut at frame 11"):
        check_frames(open_frames(tmp_path / "cut.mkv"))
    with pytest.raises(InputError, match="at frame 11"):  # by its number in the file
        check_frames(open_frames(tmp_path / "cut.mkv", start=4))
    check_frames(open_frames(tmp_path / "cut.mkv", stop=11))
    write_video(tmp_path / "still.mp4", [scene(0)[0]] * 5)
    with pytest.raises(InputError, match="something must move"):
        check_frames(open_frames(tmp_path / "still.mp4"))


def _frames(tmp_path: Path, images: list[np.ndarray]) -> Frames:
    write_video(tmp_path / "a.mkv", images, lossless=True)
    return open_frames(tmp_path / "a.mkv")


def test_the_reference_shows_most_of_the_object(tmp_path: Path) -> None:
    frames = _frames(tmp_path, scene(4))
    masks = np.zeros(frames.shape, dtype=bool)
    for f in range(24):
        masks[f, 20:50, 20 : 30 + 2 * min(f, 17)] = True  # from frame 17 on all of it
    masks[20:, 20:30] = False
    assert reference_frame(frames, masks) in (15, 16, 17, 18, 19)


def test_the_reference_looks_like_most_frames(tmp_path: Path) -> None:
    """A bar turns; half of the time it stands still, and there the reference is."""
    y, x = np.mgrid[:90, :120]
    ground = scene(8)[0].astype(float) * 0.4
    images = []
    for f in range(24):
        angle = 0.8 if 6 <= f < 18 else 0.8 + (0.35 * (6 - f) if f < 6 else 0.35 * (f - 17))
        bar = (np.abs((x - 60) * np.sin(angle) - (y - 45) * np.cos(angle)) < 9) & (np.hypot(x - 60, y - 45) < 38)
        images.append(np.where(bar[..., None], 230, ground).astype(np.uint8))
    frames = _frames(tmp_path, images)
    assert 6 <= reference_frame(frames) < 18
    mask = np.zeros((90, 120), dtype=bool)
    mask[5:85, 20:100] = True
    assert 6 <= reference_frame(frames, mask) < 18


def test_a_blurred_frame_is_no_reference(tmp_path: Path) -> None:
    images = [scene(1)[0]] * 9
    blurred = [cv2.GaussianBlur(i, (0, 0), 1.2) if f != 5 else i for f, i in enumerate(images)]
    assert reference_frame(_frames(tmp_path, blurred)) == 5


def test_masks_of_another_size_or_empty_choose_nothing(tmp_path: Path) -> None:
    frames = _frames(tmp_path, scene(1)[:4])
    with pytest.raises(InputError, match="masks: bool of shape"):
        reference_frame(frames, np.ones((4, 4), dtype=bool))
    with pytest.raises(InputError, match="empty"):
        reference_frame(frames, np.zeros((90, 120), dtype=bool))
