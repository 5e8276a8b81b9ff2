"""A short animation of a reconstruction, for a page or a talk: the tracks, or the video, beside the shape in 3D.

Time goes to the last frame and back, and the view swings to both sides, so that the end meets the beginning. Frames are
shown as they are: where there are few, each is held longer, and none is made up between them.

:func:`make_animation` draws the pictures, :func:`write_animation` writes them.

Source: ours.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.progress import Report, silent
from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.animation.files import MEGABYTES, SUFFIXES, Animation, check_animation_path, write_animation
from nrsfm.viewing.animation.panels import InputPanel, ShapePanel
from nrsfm.viewing.style import GREY, PAPER

__all__ = [
    "MEGABYTES",
    "PACE",
    "SUFFIXES",
    "Animation",
    "check_animation_path",
    "make_animation",
    "schedule",
    "write_animation",
]

_WIDTH, _TALLEST = 680, 400
_GAP, _FOOT = 24, 30  # pixels between the panels, and below them
PACE = {".gif": (27, 70), ".webp": (48, 50), ".mp4": (48, 50)}
"""Pictures one way, at most, and milliseconds between them: a GIF stores what changes almost as it is."""
_SHARE = 0.6  # of the pictures one way are there at least: where frames are few, each is held


def schedule(frames: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the frame (N,) of each picture, there and back, and its place (N,) in the loop, from 0 to 1.

    ``most`` is the largest number of frames shown.
    """
    chosen = np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(int))
    loop = np.concatenate([chosen, chosen[-2:0:-1]])
    loop = np.repeat(loop, max(1, math.ceil(2 * _SHARE * most / len(loop))))
    return loop, np.arange(len(loop)) / len(loop)


def make_animation(
    result: Reconstruction,
    *,
    tracks: Any = None,
    pictures: Any = None,
    faces: np.ndarray | None = None,
    edges: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    pace: tuple[int, int] = PACE[".gif"],
    report: Report = silent,
) -> Animation:
    """Draw the pictures of an animation.

    Parameters
    ----------
    tracks
        ``Tracks`` that it was made from; without them the points are drawn where the cameras see them.
    pictures
        The input's frames (:func:`nrsfm.viewing.viewer.pictures.open_pictures`), or ``None``.
    faces, edges
        (T, 3) triangles and (E, 2) lines of points, or ``None``.
    colours
        (P, 3) uint8 of the points, or ``None``: one colour.
    pace
        Pictures one way, at most, and milliseconds between them; ``PACE`` has them for each format.

    Raises ``InputError`` where the tracks are of another size.
    """
    from PIL import Image

    if tracks is not None and (tracks.n_frames, tracks.n_points) != (result.n_frames, result.n_points):
        raise InputError(
            f"tracks: {result.n_frames} frames of {result.n_points} points are needed, as the reconstruction has, "
            f"received {tracks.n_frames} frames of {tracks.n_points} points"
        )
    frames, places = schedule(result.n_frames, pace[0])
    left = InputPanel(result, tracks, pictures)
    right = ShapePanel(result, frames, faces, edges, colours)
    tall = min(_TALLEST, int((_WIDTH - 3 * _GAP) / (left.aspect + right.aspect)))
    wide = [round(tall * panel.aspect) for panel in (left, right)]
    size = (sum(wide) + 3 * _GAP, tall + _GAP + _FOOT)
    size = (size[0] + size[0] % 2, size[1] + size[1] % 2)  # videos want even numbers
    out = np.empty((len(frames), size[1], size[0], 3), dtype=np.uint8)
    for k, (frame, place) in enumerate(zip(frames.tolist(), places.tolist(), strict=True)):
        report("drawing", k / len(frames))
        image = Image.new("RGB", size, PAPER)
        image.paste(left.draw(frame, wide[0], tall), (_GAP, _GAP))
        image.paste(right.draw(frame, place, wide[1], tall), (2 * _GAP + wide[0], _GAP))
        _label(image, left.label, _GAP + wide[0] / 2)
        _label(image, "shape", 2 * _GAP + wide[0] + wide[1] / 2)
        out[k] = np.asarray(image)
    return Animation(out, pace[1])


@cache
def _font(size: int) -> Any:
    import matplotlib as mpl
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)


def _label(image: Any, text: str, x: float) -> None:
    from PIL import ImageDraw

    ImageDraw.Draw(image).text((x, image.height - _FOOT / 2), text, fill=GREY, font=_font(13), anchor="mm")
