"""Animations as files: GIF, WebP, MP4, each no larger than it may be.

A GIF has one palette of up to 256 colours for all its pictures (median cut; Heckbert, "Color image quantization for
frame buffer display", SIGGRAPH 1982), without dithering, which would move from picture to picture. Where the file would
be too large it is made smaller in steps, from the same pictures: first fewer colours, then fewer pixels, then every
second picture.

Source: ours.
"""

from __future__ import annotations

import dataclasses
import io
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError

SUFFIXES = (".gif", ".webp", ".mp4")
MEGABYTES = 2.0
_SMALLER = 0.88  # of the size, where the file is too large
_NARROWEST = 240

# Colours (more than 200 make the file larger, and are hardly seen), pictures from one to the next, and the least share
# of the size, one after the other until the file is small enough. Only a GIF has a palette.
_GIF_SAVES = ((200, 1, 1.0), (64, 1, 0.8), (64, 2, 0.0))
_SAVES = ((0, 1, 0.0),)


@dataclasses.dataclass(frozen=True, eq=False)
class Animation:
    """Pictures (N, h, w, 3) uint8, ``delay`` milliseconds apart, of which the last leads on to the first."""

    pictures: np.ndarray
    delay: int


def check_animation_path(path: str | os.PathLike[str]) -> str:
    """Return the suffix of an animation's name, in small letters. Raises ``FileError`` for one that is not known."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(
            f"cannot write '{path}': the name of an animation must end in {', '.join(SUFFIXES[:-1])} or "
            f"{SUFFIXES[-1]}, received '{Path(path).suffix}'"
        )
    return suffix


def write_animation(
    animation: Animation, path: str | os.PathLike[str], *, megabytes: float = MEGABYTES, overwrite: bool = False
) -> tuple[int, tuple[int, int], int]:
    """Write the animation, whole or not at all; the suffix gives the format. Return bytes, size and pictures.

    Raises ``FileError`` where the file exists and ``overwrite`` is false, cannot be written, or does not get small
    enough.
    """
    from nrsfm.files.atomic import atomic_file

    suffix = check_animation_path(path)
    with atomic_file(path, overwrite=overwrite) as stream:
        data, size, count = _small_enough(animation, suffix, megabytes, path)
        stream.write(data)
    return len(data), size, count


def _small_enough(
    animation: Animation, suffix: str, megabytes: float, path: str | os.PathLike[str]
) -> tuple[bytes, tuple[int, int], int]:
    """The file, its width and height, and the number of its pictures."""
    from PIL import Image

    height, width = animation.pictures.shape[1:3]
    for colours, every, least in _GIF_SAVES if suffix == ".gif" else _SAVES:
        share, smallest = 1.0, max(least, min(1.0, _NARROWEST / width))
        while share >= smallest:
            size = (max(2, 2 * round(width * share / 2)), max(2, 2 * round(height * share / 2)))
            images = [Image.fromarray(picture) for picture in animation.pictures[::every]]
            if size != (width, height):
                images = [image.resize(size, Image.Resampling.LANCZOS) for image in images]
            data = _ENCODERS[suffix](images, every * animation.delay, colours)
            if len(data) <= megabytes * 1e6:
                return data, size, len(images)
            # Bytes go about as the area: one step of the right size, and then small ones.
            share *= min(_SMALLER, math.sqrt(megabytes * 1e6 / len(data)) * 1.02) if share == 1.0 else _SMALLER
    raise FileError(
        f"cannot write '{path}': even {size[0]} × {size[1]} pixels need {len(data) / 1e6:.1f} MB, more than the "
        f"{megabytes:g} MB allowed"
    )


def _palette(images: Sequence[Any], colours: int) -> Any:
    """The palette of all the pictures, so that none of its colours changes from one to the next.

    Colours count by a power (0.7) of how often they are there: the background is not most of the picture to the eye.
    """
    from PIL import Image

    some = np.concatenate([np.asarray(image).reshape(-1, 3) for image in images[:: max(1, len(images) // 12)]])
    code = (some.astype(np.uint32) >> 2) @ np.array([1 << 12, 1 << 6, 1], dtype=np.uint32)
    _, first, count = np.unique(code, return_index=True, return_counts=True)
    pixels = np.repeat(some[first], np.ceil(count**0.7).astype(int), axis=0)
    return Image.fromarray(pixels[None]).quantize(colours, method=Image.Quantize.MEDIANCUT, kmeans=2)


def _gif(images: Sequence[Any], delay: int, colours: int) -> bytes:
    palette = _palette(images, colours)
    flat = [image.quantize(palette=palette, dither=0) for image in images]
    stream = io.BytesIO()
    flat[0].save(
        stream, "GIF", save_all=True, append_images=flat[1:], duration=delay, loop=0, optimize=False, disposal=1
    )
    return stream.getvalue()


def _webp(images: Sequence[Any], delay: int, _colours: int) -> bytes:
    from PIL import features

    if not features.check("webp"):
        raise FileError("cannot write WebP: this Pillow was built without it; .gif and .mp4 can be written")
    stream = io.BytesIO()
    images[0].save(stream, "WEBP", save_all=True, append_images=images[1:], duration=delay, loop=0, quality=82)
    return stream.getvalue()


def _mp4(images: Sequence[Any], delay: int, _colours: int) -> bytes:
    from nrsfm.video.libraries import import_av

    av = import_av()
    stream = io.BytesIO()
    with av.open(stream, "w", format="mp4") as container:
        try:
            video = container.add_stream("libx264", rate=round(1000 / delay), options={"crf": "20"})
        except (av.error.FFmpegError, ValueError) as error:
            raise FileError("cannot write MP4: this PyAV has no H.264 encoder; .gif and .webp go without") from error
        video.width, video.height, video.pix_fmt = images[0].width, images[0].height, "yuv420p"
        for image in images:
            for packet in video.encode(av.VideoFrame.from_image(image)):
                container.mux(packet)
        for packet in video.encode():
            container.mux(packet)
    return stream.getvalue()


_ENCODERS = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}
