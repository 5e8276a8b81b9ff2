"""``open_frames``: a video file or a folder of images as a sequence of frames.

Opening reads the wanted range once: damage is found before anything is computed, and a small grey copy of every
frame stays in memory for the checks and choices of :mod:`nrsfm.video`. Afterwards frames are decoded when asked for
and the last used ones kept, up to a bound.
"""

from __future__ import annotations

import collections
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.video.decoding import VideoFile
from nrsfm.video.folders import ImageFolder
from nrsfm.video.libraries import import_cv2

SMALL = 96
"""Longest side of the small copies, in pixels."""

_CACHE = 512 * 1024**2


class _Source(Protocol):
    fps: float

    @property
    def times(self) -> np.ndarray: ...

    def walk(self, stop: int | None) -> Iterator[tuple[int, np.ndarray]]: ...

    def read(self, number: int) -> np.ndarray: ...

    def close(self) -> None: ...


class Frames:
    """Frames of a video, by number within the chosen range; made by :func:`open_frames`.

    ``len(frames)`` is F, ``frames[f]`` and ``frames.colour(f)`` an image (H, W, 3) uint8 RGB, read-only.

    Attributes
    ----------
    name
        The path as given.
    shape
        (F, H, W) after resizing.
    original_size
        (H, W) before.
    fps
        Mean number of the chosen frames per second.
    times
        (F,) seconds of each frame, from the start of the video.
    numbers
        (F,) number of each frame in the file.
    small
        (F, h, w) float32 grey in [0, 1], the longest side at most :data:`SMALL` pixels (area means).
    """

    def __init__(
        self,
        name: str,
        source: _Source,
        numbers: np.ndarray,
        small: np.ndarray,
        original_size: tuple[int, int],
        size: tuple[int, int],
        cache: _Cache,
    ) -> None:
        """Take what :func:`open_frames` has read."""
        self.name = name
        self.numbers = numbers
        self.small = small
        self.original_size = original_size
        self.times: np.ndarray = source.times[numbers]
        self.shape: tuple[int, int, int] = (len(numbers), *size)
        spread = float(self.times[-1] - self.times[0])
        self.fps: float = (len(numbers) - 1) / spread if spread > 0 else source.fps
        self._source = source
        self._cache = cache

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, frame: int) -> np.ndarray:
        return self.colour(frame)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self.colour(f) for f in range(len(self)))

    def __repr__(self) -> str:
        frames, height, width = self.shape
        return f"Frames({self.name!r}, {frames} frames of {width} x {height}, {self.fps:.4g} per second)"

    def __enter__(self) -> Frames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. Frames that are not in the cache cannot be read any more."""
        self._source.close()

    def colour(self, frame: int) -> np.ndarray:
        """Return a frame (H, W, 3), uint8 RGB, read-only. Raises ``IndexError`` outside the range."""
        number = int(self.numbers[range(len(self))[frame]])
        image = self._cache.get(number)
        if image is None:
            image = self._cache.put(number, _resized(self._source.read(number), self.shape[1:]))
        return image

    def grey(self, frame: int) -> np.ndarray:
        """Return a frame (H, W), float32 in [0, 1]: 0.299 R + 0.587 G + 0.114 B."""
        return to_grey(self.colour(frame))


def to_grey(image: np.ndarray) -> np.ndarray:
    """Return an RGB image (H, W, 3) uint8 as grey (H, W) float32 in [0, 1] with the weights of ITU-R BT.601."""
    weights = np.array([0.299, 0.587, 0.114], dtype=np.float32) / 255
    grey: np.ndarray = image.astype(np.float32) @ weights
    return grey


class _Cache:
    """The last used images, up to so many bytes; the newest is always kept."""

    def __init__(self, limit: int) -> None:
        self._held: collections.OrderedDict[int, np.ndarray] = collections.OrderedDict()
        self._limit = limit
        self._bytes = 0

    def get(self, key: int) -> np.ndarray | None:
        if key not in self._held:
            return None
        self._held.move_to_end(key)
        return self._held[key]

    def put(self, key: int, image: np.ndarray) -> np.ndarray:
        image = np.ascontiguousarray(image)
        image.flags.writeable = False
        self._held[key] = image
        self._bytes += image.nbytes
        while self._bytes > self._limit and len(self._held) > 1:
            self._bytes -= self._held.popitem(last=False)[1].nbytes
        return image


def open_frames(
    path: str | os.PathLike[str],
    start: int = 0,
    stop: int | None = None,
    stride: int = 1,
    resize: int | str | tuple[int, int] | None = None,
    *,
    fps: float = 30.0,
    cache_bytes: int = _CACHE,
) -> Frames:
    """Open a video file that FFmpeg decodes, or a folder of images.

    Parameters
    ----------
    path
        The file; a folder of images, in natural order; or a pattern of images, ``folder/rgb_*.png``.
    start, stop, stride
        Frames ``start``, ``start + stride``, ... before ``stop`` (by default the end), numbered from 0.
    resize
        Longest side in pixels, or ``(width, height)``, or ``"WIDTHxHEIGHT"``; by areas where it shrinks.
    fps
        Frames per second of a folder of images. A video says its own.
    cache_bytes
        Memory for decoded frames.

    Raises
    ------
    FileError
        The file is not there, holds no video stream or no frame, is damaged or truncated, changes its resolution,
        or needs a codec that is missing.
    OptionError
        A number is out of range.
    InputError
        The range leaves fewer than two frames, or starts behind the end; or a library is missing.
    """
    for what, value, least in (("start", start, 0), ("stop", stop, 1), ("stride", stride, 1)):
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if value is not None and (not whole or value < least):
            raise OptionError(f"{what} must be a whole number of at least {least}, received {value!r}")
    if stop is not None and stop <= start:
        raise OptionError(f"stop must be greater than start ({start}), received {stop}")
    if not np.isfinite(fps) or fps <= 0:
        raise OptionError(f"fps must be positive, received {fps!r}")
    wanted = parse_size(resize)
    source = _source(path, fps)
    try:
        return _read_range(str(path), source, start, stop, stride, wanted, _Cache(cache_bytes))
    except BaseException:
        source.close()
        raise


def _source(path: str | os.PathLike[str], fps: float) -> _Source:
    given = Path(path)
    if given.is_dir() or (not given.exists() and any(c in given.name for c in "*?[")):
        return ImageFolder(given, fps)
    if not given.exists():
        raise FileError(f"cannot read '{path}': there is no such file or folder")
    return VideoFile(given)


def _read_range(
    name: str,
    source: _Source,
    start: int,
    stop: int | None,
    stride: int,
    wanted: int | tuple[int, int] | None,
    cache: _Cache,
) -> Frames:
    numbers: list[int] = []
    small: list[np.ndarray] = []
    original = size = (0, 0)
    seen = 0
    for number, image in source.walk(stop):
        seen = number + 1
        if number < start or (number - start) % stride:
            continue
        if not numbers:
            original = (image.shape[0], image.shape[1])
            size = _target(original, wanted)
        resized = cache.put(number, _resized(image, size))
        numbers.append(number)
        # Rounded to 1/255 they would hide small motion; the mean over an area knows more.
        small.append(_small(resized))
    if stop is not None and seen < stop:
        raise InputError(f"stop must be at most the number of frames of '{name}', {seen}, received {stop}")
    if not numbers:
        raise InputError(f"start must be below the number of frames of '{name}', {seen}, received {start}")
    if len(numbers) < 2:
        raise InputError(
            f"at least two frames are needed, '{name}' has {seen} and the chosen range holds {len(numbers)}"
        )
    return Frames(name, source, np.array(numbers), np.stack(small), original, size, cache)


def parse_size(resize: int | str | tuple[int, int] | None) -> int | tuple[int, int] | None:
    """Return a longest side or (width, height) from what a user may type. Raises ``OptionError``."""
    if resize is None:
        return None
    value: object = resize
    if isinstance(resize, str):
        parts = resize.lower().replace("×", "x").split("x")
        value = [int(p) for p in parts] if all(p.strip().isdecimal() for p in parts) else []
        value = value[0] if isinstance(value, list) and len(value) == 1 else value
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= 8:
        return int(value)
    if isinstance(value, (tuple, list)) and len(value) == 2:
        width, height = value
        if all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) and n >= 8 for n in value):
            return int(width), int(height)
    raise OptionError(f"resize must be a longest side or WIDTHxHEIGHT of at least 8 pixels, received {resize!r}")


def _target(original: tuple[int, int], wanted: int | tuple[int, int] | None) -> tuple[int, int]:
    """(H, W) after resizing."""
    if wanted is None:
        return original
    if isinstance(wanted, tuple):
        return wanted[1], wanted[0]
    factor = wanted / max(original)
    return max(1, round(original[0] * factor)), max(1, round(original[1] * factor))


def _resized(image: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    height, width = size
    if image.shape[:2] == (height, width):
        return image
    cv2 = import_cv2()
    shrinks = height <= image.shape[0] and width <= image.shape[1]
    resized: np.ndarray = cv2.resize(
        image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    )
    return resized


def _small(image: np.ndarray) -> np.ndarray:
    factor = min(1.0, SMALL / max(image.shape[:2]))
    size = tuple(max(1, round(n * factor)) for n in image.shape[:2])
    return _resized(to_grey(image), size)
