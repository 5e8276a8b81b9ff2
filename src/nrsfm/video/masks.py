"""Where the object is: masks from images, from a folder of images, or from a polygon.

A mask image is white (brighter than half) where the object is. A mask has the size of the video before or after
resizing, and nothing else is accepted; one of the size before is brought to the size after by areas, at half.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError, suggest
from nrsfm.video.folders import EXTENSIONS, image_files, read_image
from nrsfm.video.frames import Frames
from nrsfm.video.libraries import import_cv2

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_POLYGON = re.compile(rf"\s*{_NUMBER}\s*,\s*{_NUMBER}(?:[\s;]+{_NUMBER}\s*,\s*{_NUMBER})*\s*")


def read_mask(spec: str | os.PathLike[str] | np.ndarray, frames: Frames) -> np.ndarray:
    """Return where the object is: bool (H, W), or (F, H, W) where every frame has its own mask.

    Parameters
    ----------
    spec
        An image; a folder (or pattern) of images, one per chosen frame, or one per frame of the video, or named by
        the same numbers; a polygon in pixels of the video as given, ``"x,y x,y x,y"``; a ``.json`` file with
        ``[[x, y], ...]`` or several such polygons; or a bool array.
    frames
        The video.

    Raises
    ------
    FileError
        A file cannot be read, or the number of masks fits neither the frames nor their names.
    InputError
        A mask has another size than the video, or is empty.
    """
    if isinstance(spec, np.ndarray):
        return _given(spec, frames)
    text = os.fspath(spec)
    if _POLYGON.fullmatch(text):
        pairs = np.array(re.findall(_NUMBER, text), dtype=np.float64).reshape(-1, 2)
        return _checked(polygon_mask([pairs], frames), "polygon")
    path = Path(text)
    if path.is_dir() or (not path.exists() and any(c in path.name for c in "*?[")):
        return _folder(path, frames)
    if not path.exists():
        raise FileError(
            f"cannot read mask '{text}': there is no such file or folder, and it is no polygon 'x,y x,y x,y'"
        )
    if path.suffix.lower() == ".json":
        return _checked(polygon_mask(_json(path), frames), f"polygon '{text}'")
    if path.suffix.lower() not in EXTENSIONS:
        raise FileError(
            f"cannot use mask '{text}': an image ({', '.join(EXTENSIONS)}), .json, a folder or a polygon is needed"
            f"{suggest(path.suffix, EXTENSIONS)}"
        )
    return _checked(_image(path, frames), f"'{text}'")


def polygon_mask(polygons: list[np.ndarray], frames: Frames) -> np.ndarray:
    """Return the pixels (H, W) whose centre lies in one of the polygons (n, 2), given in pixels before resizing.

    The even–odd rule decides within each polygon.
    """
    height, width = frames.shape[1:]
    factor = np.array([width / frames.original_size[1], height / frames.original_size[0]])
    mask = np.zeros((height, width), dtype=bool)
    x = np.arange(width)
    for polygon in polygons:
        if len(polygon) < 3 or not np.isfinite(polygon).all():
            raise InputError(f"mask: a polygon needs at least 3 finite corners, received {len(polygon)}")
        # Pixel centres are whole numbers, so areas scale about the outer corner at (-0.5, -0.5).
        corners = (polygon + 0.5) * factor - 0.5
        following = np.roll(corners, -1, axis=0)
        for y in range(height):
            crosses = (corners[:, 1] <= y) != (following[:, 1] <= y)
            if crosses.any():
                a, b = corners[crosses], following[crosses]
                at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
                mask[y] |= (np.searchsorted(np.sort(at), x, side="right") % 2).astype(bool)
    return mask


def _json(path: Path) -> list[np.ndarray]:
    rule = f"cannot use mask '{path}': [[x, y], ...] or a list of such polygons is needed"
    try:
        held: Any = json.loads(path.read_text(encoding="utf-8"))
        if held and isinstance(held[0][0], (int, float)):
            held = [held]
        polygons = [np.array(polygon, dtype=np.float64) for polygon in held]
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise FileError(f"{rule} ({' '.join(str(error).split())})") from error
    if not polygons or any(p.ndim != 2 or p.shape[1] != 2 for p in polygons):
        raise FileError(rule)
    return polygons


def _image(path: Path, frames: Frames) -> np.ndarray:
    values = read_image(path, grey=True)
    return _fitted(values > 127, frames, f"'{path}'")


def _fitted(mask: np.ndarray, frames: Frames, name: str) -> np.ndarray:
    height, width = frames.shape[1:]
    if mask.shape == (height, width):
        return mask
    if mask.shape != frames.original_size:
        raise InputError(
            f"mask {name}: the size of the video, {frames.original_size[1]} x {frames.original_size[0]}, is needed, "
            f"received {mask.shape[1]} x {mask.shape[0]}"
        )
    cv2 = import_cv2()
    shrunk: np.ndarray = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.5
    return shrunk


def _folder(path: Path, frames: Frames) -> np.ndarray:
    files = image_files(path)
    if len(files) == 1:
        return _checked(_image(files[0], frames), f"'{files[0]}'")
    last = int(frames.numbers[-1])
    if len(files) == len(frames):
        chosen = files
    else:
        # Named like the frames: the last number in each name, counted from that of the first.
        found = [re.findall(r"\d+", p.stem) for p in files]
        by_number = {int(n[-1]): p for n, p in zip(found, files, strict=True) if n}
        first = min(by_number, default=0)
        base = 0 if first <= int(frames.numbers[0]) and first != 1 else first
        missing = [int(n) for n in frames.numbers if int(n) + base not in by_number]
        if missing:
            raise FileError(
                f"cannot use masks '{path}': one per frame is needed, {len(frames)} or {last + 1}, or names with the "
                f"frames' numbers; found {len(files)}, and none for frame {missing[0]}"
            )
        chosen = [by_number[int(n) + base] for n in frames.numbers]
    masks = np.empty(frames.shape, dtype=bool)
    for f, file in enumerate(chosen):
        masks[f] = _image(file, frames)
    return _checked(masks, f"'{path}'")


def _given(mask: np.ndarray, frames: Frames) -> np.ndarray:
    if mask.dtype != np.bool_ or mask.ndim not in (2, 3) or (mask.ndim == 3 and len(mask) != len(frames)):
        raise InputError(
            f"mask: bool of shape {frames.shape[1:]} or {frames.shape} is needed, received {mask.dtype} {mask.shape}"
        )
    if mask.ndim == 2:
        return _checked(_fitted(mask, frames, "array"), "array")
    return _checked(np.stack([_fitted(m, frames, "array") for m in mask]), "array")


def _checked(mask: np.ndarray, name: str) -> np.ndarray:
    if not mask.any():
        raise InputError(f"mask {name}: at least one pixel of the object is needed, it is empty")
    return mask
