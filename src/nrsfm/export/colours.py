"""Colours of points: from the reference frame's image, groups, confidence, depth, one colour, or an array.

Always (P, 3) uint8 in sRGB, what images and screens use. Formats that want light itself (glTF, USD) get it by
:func:`linear`, the transfer curve of IEC 61966-2-1.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError, OptionError, suggest
from nrsfm.reconstruction import Reconstruction

SOURCES = ("image", "groups", "confidence", "depth")
_HEX = re.compile(r"#[0-9a-fA-F]{6}")
_CLAY = (205, 188, 172)  # where nothing is asked for and a file needs something
_OUTSIDE = (128, 128, 128)  # a point that has no group
_BAD, _GOOD = np.array([178.0, 24.0, 43.0]), np.array([33.0, 102.0, 172.0])  # confidence 0 and 1
_GOLDEN = 0.618033988749895


def point_colours(source: Any, result: Reconstruction, reference: int, image: np.ndarray | None) -> np.ndarray | None:
    """Return (P, 3) uint8 sRGB, or ``None`` where no colours are asked for.

    Parameters
    ----------
    source
        One of ``SOURCES``, a colour as ``"#rrggbb"``, an array (P, 3) or (P, 4) of uint8, or of floats from 0 to 1.
    result
        P points; those that were not reconstructed get some colour that nobody will see.
    reference
        Frame of the image and of the depth.
    image
        (H, W, 3) uint8, for ``"image"``.

    Raises
    ------
    OptionError, InputError
        A colour or source is unknown, what it needs is not there, or an array does not fit.
    """
    if source is None:
        return None
    if not isinstance(source, str):
        return _array(source, result.n_points)
    if _HEX.fullmatch(source):
        colour = [int(source[i : i + 2], 16) for i in (1, 3, 5)]
        return np.tile(np.array(colour, dtype=np.uint8), (result.n_points, 1))
    if source == "image":
        if image is None:
            raise OptionError("colours 'image': the image of the reference frame is needed, received none")
        return _sampled(image, result, reference)
    if source == "groups":
        if result.groups is None:
            raise InputError("colours 'groups': the reconstruction has none, its method has no subspaces")
        return group_colours(result.groups)
    if source == "confidence":
        if result.confidence is None:
            raise InputError("colours 'confidence': the reconstruction has none, every measurement was used fully")
        mean = result.confidence.mean(axis=0, dtype=np.float64)[:, None]
        return np.asarray((_BAD + mean * (_GOOD - _BAD) + 0.5).astype(np.uint8))
    if source == "depth":
        return _depth(result, reference)
    hint = suggest(source, SOURCES)
    raise OptionError(f"colours must be one of {', '.join(SOURCES)} or a colour as #rrggbb, received {source!r}{hint}")


def clay(points: int) -> np.ndarray:
    """(points, 3) uint8: the colour of a surface about which nothing is known."""
    return np.tile(np.array(_CLAY, dtype=np.uint8), (points, 1))


def group_colours(groups: np.ndarray) -> np.ndarray:
    """(P, 3) uint8: hues far apart for neighbouring labels, grey for negative ones."""
    from colorsys import hls_to_rgb

    labels, inverse = np.unique(groups, return_inverse=True)
    table = [
        _OUTSIDE
        if label < 0
        else tuple(round(255 * v) for v in hls_to_rgb(label * _GOLDEN % 1.0, 0.42 + 0.16 * (label % 3) / 2, 0.65))
        for label in labels.tolist()
    ]
    return np.array(table, dtype=np.uint8)[inverse.reshape(-1)]


def linear(colours: np.ndarray) -> np.ndarray:
    """Light (…, 3) float32 from 0 to 1 of sRGB colours uint8."""
    levels = np.arange(256) / 255.0
    curve = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    return np.asarray(curve.astype(np.float32)[colours])


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """(H, W, 3) uint8 of a picture file. Raises ``FileError`` where it cannot be read."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(Path(path)) as picture:
            return np.asarray(picture.convert("RGB"))
    except UnidentifiedImageError as error:
        raise FileError(f"cannot read '{path}': it is not a picture, or it is truncated") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise FileError(f"cannot read '{path}': {reason}") from error


def image_array(value: Any) -> np.ndarray:
    """(H, W, 3) uint8 of a picture file, or of an array (H, W), (H, W, 3) or (H, W, 4)."""
    if isinstance(value, str | os.PathLike):
        return read_image(value)
    array = np.asarray(value)
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (3, 4)):
        raise InputError(f"image: uint8 (height, width, 3) is needed, received {array.dtype} {array.shape}")
    if array.size == 0:
        raise InputError(f"image: at least one pixel is needed, received {array.shape}")
    return np.repeat(array[..., None], 3, axis=2) if array.ndim == 2 else array[..., :3]


def _array(value: Any, points: int) -> np.ndarray:
    array = np.asarray(value)
    if array.shape not in ((points, 3), (points, 4)):
        raise InputError(f"colours: shape ({points}, 3) is needed, one for each point, received {array.shape}")
    array = array[:, :3]
    if array.dtype == np.uint8:
        return array
    if array.dtype.kind != "f" or not (np.isfinite(array).all() and array.min() >= 0 and array.max() <= 1):
        raise InputError(f"colours: uint8, or floats from 0 to 1, are needed, received {array.dtype}")
    return np.asarray((array * 255 + 0.5).astype(np.uint8))


def _sampled(image: np.ndarray, result: Reconstruction, reference: int) -> np.ndarray:
    """Bilinear between pixels, whose centres are at whole coordinates; beyond the border the border's colour."""
    shape = np.asarray(result.shapes[reference], dtype=np.float64)
    seen = result.scales[reference] * (shape @ result.rotations[reference, :2].T) + result.translations[reference]
    height, width = image.shape[:2]
    known = np.isfinite(seen).all(axis=1)
    x = np.clip(np.where(known, seen[:, 0], 0.0), 0, width - 1)
    y = np.clip(np.where(known, seen[:, 1], 0.0), 0, height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[:, None], (y - top)[:, None]
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[bottom, left] * (1 - across) + image[bottom, right] * across
    return np.asarray((upper * (1 - down) + lower * down + 0.5).astype(np.uint8))


def _depth(result: Reconstruction, reference: int) -> np.ndarray:
    """Near is light and yellow, far is dark and blue (the map of :mod:`matplotlib` named viridis)."""
    from matplotlib import colormaps

    depth = np.asarray(result.shapes[reference], dtype=np.float64) @ result.rotations[reference, 2]
    known = np.isfinite(depth)
    low, high = np.percentile(depth[known], [1, 99])
    near = np.where(known, (high - np.where(known, depth, 0.0)) / max(high - low, np.finfo(float).tiny), 0.0)
    return np.asarray((colormaps["viridis"](np.clip(near, 0, 1))[:, :3] * 255 + 0.5).astype(np.uint8))
