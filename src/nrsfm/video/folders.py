"""A folder of images as frames by number, in the order that a person would put them."""

from __future__ import annotations

import collections
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nrsfm.errors import FileError

EXTENSIONS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
"""What counts as an image."""

_WILD = re.compile(r"[*?\[]")


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key in which ``img2`` comes before ``img10``: digits count as numbers."""
    return tuple((int(part), "") if part.isdigit() else (-1, part.casefold()) for part in re.split(r"(\d+)", name))


def image_files(path: str | os.PathLike[str]) -> list[Path]:
    """Return the images of a folder, or those that a pattern such as ``folder/rgb_*.png`` names, in natural order.

    Raises
    ------
    FileError
        There is no image, or the folder holds several series (``rgb_001.png`` and ``mask_001.png``).
    """
    given = Path(path)
    if not given.is_dir() and _WILD.search(given.name):
        if not given.parent.is_dir():
            raise FileError(f"cannot read '{path}': there is no folder '{given.parent}'")
        held = [p for p in given.parent.glob(given.name) if p.is_file()]
    else:
        held = [p for p in given.iterdir() if p.is_file()]
    files = [p for p in held if p.suffix.lower() in EXTENSIONS and not p.name.startswith(".")]
    if not files:
        raise FileError(f"cannot use '{path}': images ({', '.join(EXTENSIONS)}) are needed, found none")
    files.sort(key=lambda p: natural_key(p.name))
    series = collections.Counter(re.sub(r"\d+", "*", p.name) for p in files)
    if len(series) > 1 and sum(count > 1 for count in series.values()) > 1:
        listed = ", ".join(f"{name} ({count})" for name, count in series.most_common(4))
        raise FileError(
            f"cannot use '{path}': it holds several series of images: {listed}; name one, as '{given}/PATTERN'"
        )
    return files


def read_image(path: str | os.PathLike[str], *, grey: bool = False) -> np.ndarray:
    """Return an image file as (H, W, 3) uint8 RGB, upright as its EXIF says, or with ``grey`` as (H, W) uint8.

    16 bits are brought to 8 by leaving out the lower ones, and transparency is left out.

    Raises ``FileError`` for a file that is not an image, damaged or truncated.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as opened:
            image = ImageOps.exif_transpose(opened)
            if image.mode.startswith("I") or image.mode == "F":
                values = np.asarray(image)
                if values.size and (values.min() < 0 or values.max() > 65535):
                    raise FileError(f"cannot use '{path}': values from 0 to 65535 are needed")
                plain = (values.astype(np.uint16) >> 8).astype(np.uint8)
                return plain if grey else np.repeat(plain[..., None], 3, axis=2)
            return np.array(image.convert("L" if grey else "RGB"))
    except UnidentifiedImageError as error:
        raise FileError(f"cannot read '{path}': it is not an image, or its head is damaged") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"cannot read '{path}' as an image: {' '.join(str(error).split())}") from error


class ImageFolder:
    """The images of a folder as frames.

    Raises ``FileError`` as :func:`image_files`.
    """

    def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
        """List the files; none is read yet."""
        self.path = Path(path)
        self.files = image_files(path)
        self.fps = fps
        self._passed = 0
        self._size: tuple[int, ...] | None = None

    @property
    def times(self) -> np.ndarray:
        """(n,) seconds of the frames walked over: even steps of the stated rate."""
        return np.arange(self._passed) / self.fps

    def walk(self, stop: int | None) -> Iterator[tuple[int, np.ndarray]]:
        """Yield (number, image) up to ``stop``. Raises ``FileError`` for a damaged image or another size."""
        for number, _ in enumerate(self.files[:stop]):
            image = self.read(number)
            self._passed = number + 1
            yield number, image

    def read(self, number: int) -> np.ndarray:
        """Return one frame."""
        image = read_image(self.files[number])
        if self._size is None:
            self._size = image.shape
        if image.shape != self._size:
            raise FileError(
                f"cannot use '{self.path}': images of one size are needed, '{self.files[number].name}' has "
                f"{image.shape[1]} x {image.shape[0]}, the first has {self._size[1]} x {self._size[0]}"
            )
        return image

    def close(self) -> None:
        """Nothing is open."""
