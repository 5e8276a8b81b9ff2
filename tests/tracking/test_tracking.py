"""Tracking against known motion: exact laws of the parts, and the whole on images warped by a known flow."""

from __future__ import annotations

import numpy as np
import pytest

from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.files import load_tracks
from nrsfm.tracking import TrackingOptions, save_tracking, track
from nrsfm.tracking.chaining import walk
from nrsfm.tracking.filling import affine, fill, spread
from nrsfm.tracking.matching import Template, evened
from nrsfm.tracking.subspace import estimate
from nrsfm.tracking.visibility import areas

from .conftest import textured, warped

cv2 = pytest.importorskip("cv2")

SIZE = 96


def _texture(seed: int = 0) -> np.ndarray:
    image = textured(SIZE, seed)
    return (0.5 + 0.14 * image / image.std()).astype(np.float32)


def _motion(frames: int) -> np.ndarray:
    """Displacements (F, H, W, 2) of a low-rank motion, 0 in frame 0."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32) / SIZE - 0.5
    time = np.linspace(0, 2 * np.pi, frames, dtype=np.float32)[:, None, None]
    dx = 6 * np.sin(time) * (0.4 + x) + 3 * (np.cos(time) - 1) * np.sin(4 * y)
    dy = 4 * np.sin(time) * y + 2 * (np.cos(time) - 1) * np.cos(3 * x)
    return np.stack([dx, dy], axis=-1).astype(np.float32)


@pytest.fixture(scope="module")
def video() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    motion = _motion(16)
    texture = _texture()
    frames = np.stack([warped(texture, m) for m in motion])
    # The light changes, as a gain and an offset.
    gain = 1 + 0.15 * np.sin(np.arange(16))[:, None, None]
    frames = np.clip(frames * gain + 0.02, 0, 1).astype(np.float32)
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[16:80, 16:80] = True
    return frames, mask, motion


def _errors(found, motion: np.ndarray) -> np.ndarray:
    x, y = found.layout.pixels.T
    true = found.layout.pixels + motion[:, y, x]
    return np.linalg.norm(found.tracks.points - true, axis=2)


@pytest.mark.parametrize(("method", "mean"), [("subspace", 0.35), ("dis", 0.5)])
def test_known_motion_is_found(video, method, mean):
    frames, mask, motion = video
    found = track(frames, mask, 0, method, rounds=4, fine=12, sweeps=1)
    assert _errors(found, motion).mean() < mean
    assert found.tracks.visible.mean() > 0.9
    np.testing.assert_array_equal(found.tracks.points[0], found.layout.pixels)
    assert found.tracks.points.dtype == np.float32


def test_corrected_chain_beats_the_naive_one(video):
    frames, mask, motion = video
    noisy = frames + np.random.default_rng(0).normal(0, 0.03, frames.shape).astype(np.float32)
    last = [
        _errors(track(noisy, mask, 0, method, rounds=4, fine=4), motion)[8:].mean()
        for method in ("naive", "dis", "subspace")
    ]
    assert last[1] < 0.8 * last[0]
    assert last[2] < 0.8 * last[0]


def test_what_a_disc_hides_is_marked_and_still_followed(video):
    frames, mask, motion = video
    covered = frames.copy()
    y, x = np.mgrid[:SIZE, :SIZE]
    noise = np.random.default_rng(3).random((SIZE, SIZE), dtype=np.float32)
    hidden = []
    for f in range(len(frames)):
        inside = (x - 48) ** 2 + (y - 48) ** 2 < 14**2 if 5 <= f <= 9 else np.zeros((SIZE, SIZE), dtype=bool)
        covered[f][inside] = noise[inside]
        hidden.append(inside)
    found = track(covered, mask, 0, rounds=5, fine=10)
    place = np.round(found.tracks.points).astype(int)
    truly = np.stack([hidden[f][place[f, :, 1], place[f, :, 0]] for f in range(len(frames))])
    deep = truly & (np.linalg.norm(place - 48, axis=2) < 6)  # a window at the rim sees both
    assert found.tracks.visible[deep].mean() < 0.05
    assert found.tracks.visible[truly].mean() < 0.35
    assert found.tracks.visible[~truly].mean() > 0.85
    assert np.median(_errors(found, motion)[truly]) < 1.0


def test_same_result_twice_for_read_only_and_float_and_uint8(video):
    frames, mask, _ = video
    frozen = frames[:5].copy()
    frozen.flags.writeable = False
    first, second = track(frozen, mask, 0, "dis", 3), track(frozen, mask, 0, "dis", 3)
    np.testing.assert_array_equal(first.tracks.points, second.tracks.points)
    assert (first.layout.pixels % 3 == 0).all()
    whole = track((frozen * 255).round().astype(np.uint8), mask, 0, "dis", 3)
    assert np.median(np.abs(whole.tracks.points - first.tracks.points)) < 0.1


def test_masks_of_every_frame_choose_the_reference_and_hide(video):
    frames, mask, _ = video
    masks = np.stack([mask] * 4)
    masks[0, :40] = False
    masks[2, :, 48:] = False
    found = track(frames[:4], masks, "auto", "dis", 4)
    assert found.diagnostics.reference in (1, 3)
    gone = found.tracks.points[2, :, 0] > 52
    assert gone.any()
    assert not found.tracks.visible[2, gone].any()


def test_saved_tracks_are_read_back_with_what_belongs_to_them(video, tmp_path):
    h5py = pytest.importorskip("h5py")
    frames, mask, _ = video
    found = track(np.repeat(frames[:4, ..., None], 3, axis=3), mask, 0, "dis", 2)
    for name in ("tracks été.h5", "tracks.npz"):
        save_tracking(found, tmp_path / name)
        again = load_tracks(tmp_path / name)
        np.testing.assert_array_equal(again.points, found.tracks.points)
        np.testing.assert_array_equal(again.visible, found.tracks.visible)
    with h5py.File(tmp_path / "tracks été.h5") as file:
        assert file["colours"].shape == (found.tracks.n_points, 3)
        assert int(file["reference"][()]) == 0
        faces = file["faces"][()]
    assert len(faces) == 2 * 31 * 31  # 32 × 32 points
    with pytest.raises(FileError, match=r"\.h5, \.hdf5, \.npz"):
        save_tracking(found, tmp_path / "tracks.txt")


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"method": "diss"}, OptionError, "method must be one of"),
        ({"reference": 99}, OptionError, "reference must be from 0 to"),
        ({"step": 0}, OptionError, "step must be"),
        ({"rnk": 3}, OptionError, "did you mean 'rank'"),
        ({"rank": 0}, OptionError, "at least 1"),
        ({"mask": np.zeros((SIZE, SIZE), dtype=bool)}, InputError, "received none"),
        ({"mask": np.ones((4, 4), dtype=bool)}, InputError, "mask: bool of shape"),
        ({"frames": np.zeros((1, SIZE, SIZE), np.float32)}, InputError, "at least 2"),
        ({"frames": np.zeros((4, SIZE, SIZE), int)}, InputError, "uint8 or floating"),
        ({"frames": np.full((4, SIZE, SIZE), np.nan, np.float32)}, InputError, "finite"),
    ],
)
def test_wrong_input_is_refused_in_one_line(video, change, error, text):
    frames, mask, _ = video
    asked = {"frames": frames[:3], "mask": mask, "reference": 0, "method": "dis"} | change
    with pytest.raises(error, match=text) as caught:
        track(**asked)
    assert "\n" not in str(caught.value)


def test_affine_flow_is_continued_exactly():
    y, x = np.mgrid[:60, :70].astype(np.float32)
    flow = np.dstack([2 + 0.1 * x - 0.05 * y, -1 + 0.02 * x + 0.08 * y])
    trust = np.zeros((60, 70), dtype=np.float32)
    trust[10:40, 10:40] = 1
    broken = np.where(trust[..., None] > 0, flow, 50).astype(np.float32)
    np.testing.assert_allclose(affine(broken, trust), flow, atol=1e-3)
    np.testing.assert_allclose(fill(broken, trust), flow, atol=1e-2)


def test_spreading_keeps_constants_and_what_is_trusted():
    rng = np.random.default_rng(0)
    trust = (rng.random((33, 47)) < 0.2).astype(np.float32)
    constant = np.full((33, 47, 2), 3.5, dtype=np.float32)
    np.testing.assert_allclose(spread(constant, trust), 3.5, atol=1e-4)
    own = rng.standard_normal((33, 47, 2)).astype(np.float32)
    np.testing.assert_allclose(spread(own, np.ones_like(trust)), own, atol=1e-5)


def test_subspace_completes_hidden_frames_of_a_low_rank_motion():
    motion = _motion(20)
    trust = np.ones(motion.shape[:3], dtype=np.float32)
    trust[5:9, 20:50, 20:50] = 0
    broken = np.where(trust[..., None] > 0, motion, 30).astype(np.float32)
    found = estimate(broken, trust, np.ones((SIZE, SIZE), dtype=bool), 4, 4, 1.5, 0.3)
    for f in (5, 7, 12):
        assert np.linalg.norm(found.prediction(f, (SIZE, SIZE)) - motion[f], axis=2)[10:-10, 10:-10].mean() < 0.4


def test_areas_tell_a_fold():
    y, x = np.mgrid[:40, :40].astype(np.float32)
    assert np.allclose(areas(np.dstack([0.5 * x, 0 * y]))[8:-8, 8:-8], 1.5, atol=1e-3)
    assert (areas(np.dstack([-2 * x, 0 * y]))[8:-8, 8:-8] < 0).all()


def test_light_is_evened_out_and_walk_visits_every_frame():
    image = _texture() * 255
    slow = np.linspace(0.8, 1.2, SIZE, dtype=np.float32)
    difference = evened(image * slow, 6.0).astype(int) - evened(image, 6.0)
    assert np.abs(difference).mean() < 4
    pairs = list(walk(7, 3))
    assert sorted(after for _, after in pairs) == [0, 1, 2, 4, 5, 6]
    options = TrackingOptions()
    frames = np.stack([evened(image, 6.0)] * 2)
    template = Template(frames, np.ones((SIZE, SIZE), dtype=bool), 0, options)
    still = np.zeros((*template.shape, 2), dtype=np.float32)
    assert template.likeness(template.sample(frames[1], still)).min() > 0.5


def test_command_line_tracks_a_folder_of_images(video, tmp_path, capsys):
    from nrsfm.cli import main

    frames, mask, _ = video
    folder = tmp_path / "frames é"
    folder.mkdir()
    for f in range(5):
        cv2.imencode(".png", (frames[f] * 255).round().astype(np.uint8))[1].tofile(str(folder / f"{f:03d}.png"))
    cv2.imwrite(str(tmp_path / "mask.png"), mask.astype(np.uint8) * 255)
    out = tmp_path / "tracks.h5"
    words = ["track", str(folder), "--out", str(out), "--mask", str(tmp_path / "mask.png"), "--method", "dis"]
    assert main([*words, "--step", "4"]) == 0
    assert "256 points in 5 frames" in capsys.readouterr().out
    assert load_tracks(out).n_points == 256
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words[:3], str(tmp_path / "tracks.txt")]) == 2
    assert main([*words[:3], str(tmp_path / "b.h5"), "--reference", "x"]) == 2
    assert not (tmp_path / "b.h5").exists()
