"""Images to a video file, through PyAV: for tests, demonstrations and pictures of tracks."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import InputError, suggest
from nrsfm.files.atomic import atomic_file
from nrsfm.video.libraries import import_av

FORMATS = {".mp4": "mp4", ".mov": "mov", ".mkv": "matroska", ".avi": "avi", ".webm": "webm"}
"""The container of each extension."""


def write_video(
    path: str | os.PathLike[str],
    images: Iterable[np.ndarray],
    *,
    fps: float = 30.0,
    times: Iterable[float] | None = None,
    codec: str | None = None,
    quality: int = 18,
    lossless: bool = False,
    overwrite: bool = True,
) -> None:
    """Write images (H, W, 3) uint8 RGB as a video; the file appears whole or not at all.

    Parameters
    ----------
    path
        ``.mp4``, ``.mov``, ``.mkv``, ``.avi`` or ``.webm``.
    images
        One after the other, all of one size.
    fps
        Frames per second.
    times
        Seconds at which the frames are shown, rising: a variable frame rate. ``fps`` is then only a label.
    codec
        FFmpeg's name of the encoder; by default H.264 (``.webm``: VP9).
    quality
        Constant rate factor: 0 (best) to 51; 18 is hard to tell from the original.
    lossless
        Keep every bit of the images, in FFV1 (``.mkv``, ``.avi``).
    overwrite
        Replace a file of that name.

    Raises
    ------
    InputError
        An unknown extension or encoder, images of another size or type, or none.
    FileError
        The file cannot be written.
    """
    av = import_av()
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"a video's name must end in {', '.join(FORMATS)}, received '{path}'{suggest(suffix, FORMATS)}"
        )
    chosen = codec or ("ffv1" if lossless else "libvpx-vp9" if suffix == ".webm" else "libx264")
    if chosen not in av.codecs_available:
        raise InputError(f"codec: this build of FFmpeg has no '{chosen}'{suggest(chosen, av.codecs_available)}")
    rate = Fraction(fps).limit_denominator(1001)
    moments = None if times is None else list(times)
    # AVI knows even steps alone; MPEG-4 no finer clock than 1/65535 s.
    base = 1 / rate if suffix == ".avi" else Fraction(1, 60_000)
    if moments is not None and suffix == ".avi":
        raise InputError("times: AVI has a constant frame rate; write .mp4, .mkv, .mov or .webm")
    with atomic_file(path, overwrite=overwrite) as stream, av.open(stream, "w", format=FORMATS[suffix]) as container:
        video: Any = None
        for number, image in enumerate(images):
            if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
                raise InputError(
                    f"image {number}: uint8 of shape (H, W, 3) is needed, received {image.dtype} {image.shape}"
                )
            if video is None:
                video = container.add_stream(chosen, rate=rate, options={} if lossless else {"crf": str(quality)})
                video.height, video.width = image.shape[:2]
                odd = video.height % 2 or video.width % 2
                # Halved chroma needs even sizes.
                video.pix_fmt = "bgr0" if lossless else "yuv444p" if odd else "yuv420p"
                video.codec_context.time_base = base
            elif image.shape != (video.height, video.width, 3):
                raise InputError(
                    f"image {number}: {video.width} x {video.height} is needed, as the first, received "
                    f"{image.shape[1]} x {image.shape[0]}"
                )
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            at = Fraction(number) / rate if moments is None else Fraction(moments[number]).limit_denominator(10**6)
            frame.pts, frame.time_base = round(at / base), base
            container.mux(video.encode(frame))
        if video is None:
            raise InputError("images: at least one is needed, received none")
        container.mux(video.encode(None))
