"""Masks from images, folders and polygons mark the same pixels; misfits are refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nrsfm.errors import FileError, InputError
from nrsfm.video import open_frames, read_mask


@pytest.fixture
def square() -> np.ndarray:
    mask = np.zeros((90, 120), dtype=bool)
    mask[20:60, 30:80] = True
    return mask


def test_image_polygon_and_json_agree(tmp_path: Path, video: Path, square: np.ndarray) -> None:
    frames = open_frames(video, stop=4)
    Image.fromarray(square).save(tmp_path / "Maske ü.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "Maske ü.png", frames), square)
    polygon = "29.5,19.5 79.5,19.5 79.5,59.5 29.5,59.5"
    np.testing.assert_array_equal(read_mask(polygon, frames), square)
    corners = [[float(n) for n in pair.split(",")] for pair in polygon.split()]
    for held in (corners, [corners], [corners, [[0, 0], [0.2, 0], [0, 0.2]]]):
        (tmp_path / "p.json").write_text(json.dumps(held))
        mask = read_mask(tmp_path / "p.json", frames)
        np.testing.assert_array_equal(mask[1:], square[1:])
    np.testing.assert_array_equal(read_mask(square, frames), square)


def test_a_polygon_is_what_an_independent_library_fills(video: Path) -> None:
    path = pytest.importorskip("matplotlib.path")
    corners = np.random.default_rng(3).uniform(5, 85, (6, 2))
    corners = corners[np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T))]
    x, y = np.meshgrid(np.arange(120), np.arange(90))
    inside = path.Path(corners).contains_points(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(90, 120)
    spec = " ".join(f"{a:.17g},{b:.17g}" for a, b in corners)
    np.testing.assert_array_equal(read_mask(spec, open_frames(video, stop=2)), inside)


def test_resizing_takes_the_mask_along(tmp_path: Path, video: Path, square: np.ndarray) -> None:
    frames = open_frames(video, stop=4, resize=60)
    half = square[::2, ::2]
    Image.fromarray(square).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", frames), half)
    np.testing.assert_array_equal(read_mask("29.5,19.5 79.5,19.5 79.5,59.5 29.5,59.5", frames), half)
    Image.fromarray(half).save(tmp_path / "small.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "small.png", frames), half)


def test_a_folder_has_one_mask_per_frame_or_names(tmp_path: Path, video: Path, square: np.ndarray) -> None:
    for f in range(24):
        Image.fromarray(np.roll(square, f, axis=1)).save(tmp_path / f"mask_{f}.png")
    frames = open_frames(video, start=2, stop=12, stride=3)
    masks = read_mask(tmp_path, frames)
    assert masks.shape == (4, 90, 120)
    for mask, number in zip(masks, (2, 5, 8, 11), strict=True):
        np.testing.assert_array_equal(mask, np.roll(square, number, axis=1))
    np.testing.assert_array_equal(read_mask(tmp_path / "mask_?.png", open_frames(video, start=3, stop=5)), [
        np.roll(square, f, axis=1) for f in (3, 4)])  # fmt: skip
    (tmp_path / "mask_8.png").unlink()
    with pytest.raises(FileError, match=r"one per frame is needed, .* none for frame 8"):
        read_mask(tmp_path, frames)


def test_refusals(tmp_path: Path, video: Path, square: np.ndarray) -> None:
    frames = open_frames(video, stop=4)
    Image.fromarray(square[:50]).save(tmp_path / "other.png")
    Image.fromarray(np.zeros_like(square)).save(tmp_path / "empty.png")
    (tmp_path / "bad.json").write_text("{}")
    (tmp_path / "bad.xyz").write_text("")
    for spec, kind, message in (
        (tmp_path / "other.png", InputError, r"the size of the video, 120 x 90, is needed, received 120 x 50"),
        (tmp_path / "empty.png", InputError, "it is empty"),
        ("200,200 210,200 210,210", InputError, "it is empty"),
        ("1,1 2,2", InputError, "at least 3 finite corners"),
        (tmp_path / "bad.json", FileError, r"\[\[x, y\], ...\]"),
        (tmp_path / "bad.xyz", FileError, "an image .* is needed"),
        (tmp_path / "none.png", FileError, "no such file or folder"),
        (square.astype(float), InputError, "bool of shape"),
        (square[:40], InputError, "received 120 x 40"),
    ):
        with pytest.raises(kind, match=message):
            read_mask(spec, frames)
