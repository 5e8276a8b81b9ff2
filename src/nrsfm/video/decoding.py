"""A video file as frames by number, through PyAV: exact also with a variable frame rate, and never all in memory.

The file is decoded once from its start to the end of the wanted range (:meth:`VideoFile.walk`), which finds damage
and notes each frame's time stamp. Afterwards any frame is found again by seeking to the key frame before it and
decoding up to its time stamp.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError
from nrsfm.video.libraries import import_av, import_cv2

_AHEAD = 48  # frames: nearer than this it is cheaper to decode on than to seek


class VideoFile:
    """The first video stream of a file.

    Frames are upright (the file's rotation is applied) and have square pixels (the file's aspect ratio is applied
    by widening).

    Raises
    ------
    FileError
        The file cannot be opened, holds no video, or needs a decoder that is not there.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file; nothing is decoded yet."""
        self.path = Path(path)
        self._av = import_av()
        self._stamps: list[int | None] = []
        self._size: tuple[int, int] | None = None  # height, width as decoded
        self._open()
        stream = self._stream
        rate = stream.average_rate or stream.guessed_rate
        self.fps = float(rate) if rate else 0.0
        self._time_base = float(stream.time_base) if stream.time_base else 0.0

    def _open(self) -> None:
        av = self._av
        try:
            if self.path.stat().st_size == 0:
                raise FileError(f"cannot read '{self.path}': it is empty (0 bytes)")
            self._container: Any = av.open(str(self.path), options={"err_detect": "explode"})
        except OSError as error:  # PyAV's errors about files are OSErrors too
            raise FileError(f"cannot read '{self.path}' as a video: {_reason(error)}") from error
        except av.error.FFmpegError as error:
            raise FileError(f"cannot read '{self.path}' as a video: {_reason(error)}") from error
        streams = self._container.streams.video
        streams = [s for s in streams if not (s.disposition & av.stream.Disposition.attached_pic)]
        if not streams:
            held = ", ".join(sorted({s.type for s in self._container.streams if s.type})) or "nothing"
            self.close()
            raise FileError(f"cannot use '{self.path}': a video stream is needed, it holds {held}")
        self._stream: Any = streams[0]
        context = self._stream.codec_context
        if context is None or context.codec is None:
            self.close()
            raise FileError(f"cannot use '{self.path}': this build of FFmpeg has no decoder for its video codec")
        self._stream.thread_type = "AUTO"
        self._frames: Iterator[Any] = self._container.decode(self._stream)
        self._next = 0  # number of the frame that comes next from self._frames

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(Exception):
            self._container.close()

    def walk(self, stop: int | None) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (number, image (H, W, 3) uint8) from the start up to ``stop``, checking each frame.

        Raises
        ------
        FileError
            The file holds no frame, is damaged or truncated, or changes its resolution.
        """
        number = 0
        while stop is None or number < stop:
            try:
                frame = next(self._frames, None)
            except (self._av.error.FFmpegError, OSError) as error:
                raise FileError(
                    f"cannot use '{self.path}': damaged or truncated, frame {number} cannot be decoded "
                    f"({_reason(error)})"
                ) from error
            if frame is None:
                break
            if frame.is_corrupt:
                raise FileError(f"cannot use '{self.path}': damaged, frame {number} is decoded with errors")
            image = self._upright(frame, number)
            self._stamps.append(frame.pts)
            self._next = number + 1
            yield number, image
            number += 1
        if stop is None or number < stop:
            self._check_end(number)

    @property
    def times(self) -> np.ndarray:
        """(n,) seconds of the frames walked over, from the first."""
        number = np.arange(len(self._stamps), dtype=np.float64)
        if not self._stamps or any(s is None for s in self._stamps) or not self._time_base:
            return number / (self.fps or 30.0)
        stamps = np.array(self._stamps, dtype=np.float64)
        return (stamps - stamps[0]) * self._time_base

    def read(self, number: int) -> np.ndarray:
        """Return one of the frames that :meth:`walk` has passed."""
        stamp = self._stamps[number]
        if not self._next <= number < self._next + _AHEAD:
            self._seek(number)
        for frame in self._frames:
            at = self._next
            self._next += 1
            if frame.pts == stamp if stamp is not None else at == number:
                self._next = number + 1
                return self._upright(frame, number)
            if stamp is not None and frame.pts is not None and frame.pts > stamp:
                break
        # Seeking landed behind the frame, as some files make it: from the start it is found for certain.
        self.close()
        self._open()
        for at, frame in enumerate(self._frames):
            if at == number:
                self._next = number + 1
                return self._upright(frame, number)
        raise FileError(f"cannot use '{self.path}': frame {number} was there and is gone; was the file changed?")

    def _seek(self, number: int) -> None:
        stamp = self._stamps[number]
        if stamp is None or any(s is None for s in self._stamps[:number]):
            self.close()
            self._open()
            return
        try:
            self._container.seek(stamp, stream=self._stream, backward=True)
        except (self._av.error.FFmpegError, OSError):
            self.close()
            self._open()
            return
        self._frames = self._container.decode(self._stream)
        self._next = 0

    def _upright(self, frame: Any, number: int) -> np.ndarray:
        if self._size is None:
            self._size = (frame.height, frame.width)
        if (frame.height, frame.width) != self._size:
            raise FileError(
                f"cannot use '{self.path}': one resolution is needed, frame {number} has {frame.width} x "
                f"{frame.height} after {self._size[1]} x {self._size[0]}"
            )
        image: np.ndarray = frame.to_ndarray(format="rgb24")
        aspect = self._stream.sample_aspect_ratio
        if aspect and aspect != 1:
            width = max(1, round(image.shape[1] * float(aspect)))
            image = import_cv2().resize(image, (width, image.shape[0]), interpolation=import_cv2().INTER_LINEAR)
        turn = round(frame.rotation)
        if turn % 90:
            raise FileError(f"cannot use '{self.path}': it asks to be turned by {turn}°; only quarter turns are known")
        return np.ascontiguousarray(np.rot90(image, turn // 90)) if turn else image

    def _check_end(self, found: int) -> None:
        """Compare what was decoded with what the file promises."""
        if not found:
            raise FileError(f"cannot use '{self.path}': its video stream holds no frame")
        # An MP4 may hold frames that its edit list leaves out; elsewhere the count of the head is that of the frames.
        promised = self._stream.frames
        if found < promised - 1 and "mov" not in self._container.format.name:
            raise FileError(f"cannot use '{self.path}': truncated, it promises {promised} frames and holds {found}")
        end = self._end()
        final = self._stamps[-1]
        if end is None or final is None:
            return
        last = final * self._time_base
        steps = np.diff(self.times)
        # A cut file ends earlier than its head says. Two frames of doubt: the last one's duration is not known.
        step = max(float(np.median(steps)) if len(steps) else 0.0, 1 / (self.fps or 30.0))
        if end - last > 2.5 * step and (not promised or found < promised):
            raise FileError(
                f"cannot use '{self.path}': truncated, it promises {end:.2f} s of video and ends after {last:.2f} s "
                f"({found} frames)"
            )

    def _end(self) -> float | None:
        """Seconds at which the video should end, as far as the file's head says."""
        stream = self._stream
        start = (stream.start_time or 0) * self._time_base
        if stream.duration:
            return start + float(stream.duration) * self._time_base
        text = str(stream.metadata.get("DURATION", ""))
        parts = text.split(":")
        if len(parts) == 3:
            with contextlib.suppress(ValueError):
                return float(parts[0]) * 3600 + float(parts[1]) * 60 + float(parts[2])
        if self._container.duration and len(self._container.streams) == 1:
            return float(self._container.duration) / 1e6
        return None


def _reason(error: BaseException) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return " ".join(str(text).split())
