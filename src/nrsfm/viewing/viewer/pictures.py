"""The input's frames, as pictures for the page: a folder of images, or a video.

Pictures go out as JPEG, at most 1280 pixels on the longer side; the page draws tracks in the original's pixels. Images
of a folder are read when asked for. A video is decoded once, in order, and kept as JPEG, because its frames cannot be
reached singly.

Source: ours; reading by :mod:`nrsfm.video`, which has them upright and in the order that tracking has them in.
"""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.progress import Report, silent

LARGEST = 1280
_QUALITY = 85
_KEPT = 64  # pictures of a folder that are kept as JPEG


class Pictures:
    """Pictures of F frames of one size, as JPEG and, for colours, as arrays."""

    def __init__(self, count: int, size: tuple[int, int], make: Callable[[int], bytes]) -> None:
        self.count = count
        self.width, self.height = size
        self._make = make
        self._ready: dict[int, bytes] = {}
        self._lock = threading.Lock()

    def jpeg(self, frame: int) -> bytes:
        """Return the JPEG file of a frame. Raises ``InputError`` where it cannot be read any more."""
        with self._lock:
            found = self._ready.pop(frame, None)
        if found is None:
            found = self._make(frame)
        with self._lock:
            self._ready[frame] = found  # the newest is last
            while len(self._ready) > _KEPT:
                del self._ready[next(iter(self._ready))]
        return found

    def array(self, frame: int) -> np.ndarray:
        """Return a frame as (h, w, 3) uint8; smaller than ``width`` and ``height`` where the original is large."""
        from PIL import Image

        with Image.open(io.BytesIO(self.jpeg(frame))) as picture:
            return np.asarray(picture.convert("RGB"))


def open_pictures(path: str | os.PathLike[str], frames: int, *, report: Report = silent) -> Pictures:
    """Open a folder of images (or a pattern of them, ``folder/rgb_*.png``), or a video, as :mod:`nrsfm.video` does.

    Raises
    ------
    FileError
        There is no such thing, it cannot be read, has another number of frames than ``frames``, or frames of
        different sizes.
    """
    place = Path(path)
    if place.is_dir() or (not place.exists() and any(c in place.name for c in "*?[")):
        return _folder(place, frames)
    if not place.is_file():
        raise FileError(f"cannot read '{path}': there is no such file or folder")
    return _video(place, frames, report)


def _folder(place: Path, frames: int) -> Pictures:
    from PIL import Image

    from nrsfm.video.folders import image_files, read_image

    found = image_files(place)
    _require_count(str(place), "images", len(found), frames)
    sizes: list[tuple[int, int]] = []
    for file in found:
        try:
            with Image.open(file) as picture:  # reads no more than the head
                sizes.append(picture.size)
        except OSError:
            read_image(file)  # says what is wrong
            raise
        if sizes[-1] != sizes[0]:
            raise FileError(
                f"'{file}' has {sizes[-1][0]}×{sizes[-1][1]} pixels and '{found[0].name}' {sizes[0][0]}×{sizes[0][1]}: "
                "images of one size are needed"
            )
    height, width = read_image(found[0]).shape[:2]  # upright, which the head is not always
    return Pictures(len(found), (width, height), lambda frame: _encode(read_image(found[frame])))


def _video(place: Path, frames: int, report: Report) -> Pictures:
    from nrsfm.video.decoding import VideoFile

    files: list[bytes] = []
    size = (0, 0)
    source = VideoFile(place)
    try:
        for _, image in source.walk(None):
            size = (int(image.shape[1]), int(image.shape[0]))
            files.append(_encode(image))
            report("reading the video", min(1.0, len(files) / frames))
            if len(files) > frames:
                break
    finally:
        source.close()
    more = "more than " if len(files) > frames else ""
    _require_count(str(place), "frames", len(files), frames, more)
    return Pictures(len(files), size, files.__getitem__)


def _require_count(place: str, what: str, count: int, frames: int, more: str = "") -> None:
    if count != frames:
        raise FileError(
            f"'{place}' has {more}{min(count, frames) if more else count} {what}, the reconstruction {frames} frames: "
            "one for each is needed"
        )


def _encode(image: np.ndarray) -> bytes:
    from PIL import Image

    shown = Image.fromarray(image)
    shown.thumbnail((LARGEST, LARGEST))
    stream = io.BytesIO()
    shown.save(stream, "JPEG", quality=_QUALITY)
    return stream.getvalue()


def sample_colours(pictures: Pictures, seen: np.ndarray, trusted: np.ndarray | None, frames: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 of points seen at (n, N, 2), in pixels, in the ``frames`` (n,): their median.

    ``trusted`` (n, N) bool says where a point shows itself; where it never does, all frames count. Pixels' centres are
    at whole coordinates. Raises ``InputError`` where the sizes do not fit together.
    """
    if seen.shape[:1] != frames.shape:
        raise InputError(f"seen: one array for each of the {len(frames)} frames is needed, received {seen.shape}")
    found = np.empty((*seen.shape[:2], 3), dtype=np.float32)
    for k, frame in enumerate(frames.tolist()):
        image = pictures.array(frame)
        height, width = image.shape[:2]
        x = np.nan_to_num((seen[k, :, 0] + 0.5) * (width / pictures.width) - 0.5)
        y = np.nan_to_num((seen[k, :, 1] + 0.5) * (height / pictures.height) - 0.5)
        column, row = np.clip(np.rint(x), 0, width - 1).astype(int), np.clip(np.rint(y), 0, height - 1).astype(int)
        found[k] = image[row, column]
    if trusted is not None:
        counted = trusted | ~trusted.any(axis=0)
        found[~counted] = np.nan
    return np.asarray(np.nanmedian(found, axis=0).round().astype(np.uint8))
