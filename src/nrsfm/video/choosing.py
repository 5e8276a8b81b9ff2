"""The reference frame: the one from which the others can best be explained.

Ours. With a mask per frame, the frames in which most of the object is seen (area within 5% of the largest) are the
candidates; without, all are. Among them the reference is the medoid in appearance: the frame whose small grey copy,
shifted as a whole to fit and freed of gain and offset, differs least from the others on average. A frame that
looks like most others shares the most visible surface with them, and flow to it is shortest. A blurred frame tells
little, so within a hair of the best the sharpest is taken.
"""

from __future__ import annotations

import numpy as np

from nrsfm.errors import InputError
from nrsfm.video.frames import Frames
from nrsfm.video.libraries import import_cv2

_SIDE = 32
_MOST = 100  # frames compared with each other
_AREA = 0.95
_HAIR = 0.01  # of correlation


def reference_frame(frames: Frames, masks: np.ndarray | None = None) -> int:
    """Return the number (within ``frames``) of the frame from which to track.

    Parameters
    ----------
    frames
        The video.
    masks
        Where the object is, bool (H, W) or (F, H, W); the rest of the image does not count.

    Raises
    ------
    InputError
        The masks do not fit the video, or are empty.
    """
    cv2 = import_cv2()
    count, height, width = frames.shape
    if masks is not None and (masks.dtype != np.bool_ or masks.shape not in ((height, width), (count, height, width))):
        raise InputError(
            f"masks: bool of shape {(height, width)} or {frames.shape} is needed, received {masks.dtype} {masks.shape}"
        )
    if masks is not None and not masks.any():
        raise InputError("masks: at least one pixel of the object is needed, they are empty")
    candidates = np.arange(count)
    if masks is not None and masks.ndim == 3:
        areas = np.array([np.count_nonzero(mask) for mask in masks])
        candidates = np.flatnonzero(areas >= _AREA * areas.max())
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST)).round().astype(int))
    if len(candidates) > _MOST:
        candidates = candidates[np.unique(np.linspace(0, len(candidates) - 1, _MOST).round().astype(int))]
    compared = np.union1d(chosen, candidates)
    window = _window(masks, height, width)
    thumbs = {int(f): _thumb(cv2, frames.small[f], window) for f in compared}
    cost = np.array([_distance(cv2, thumbs, int(f), compared) for f in candidates])
    near = candidates[cost <= cost.min() + _HAIR]
    sharp = [float(np.abs(cv2.Laplacian(frames.small[f][window], cv2.CV_32F)).mean()) for f in near]
    return int(near[int(np.argmax(sharp))])


def _window(masks: np.ndarray | None, height: int, width: int) -> tuple[slice, slice]:
    """The part of the small copies that holds the object in any frame, as relative slices."""
    if masks is None:
        return slice(None), slice(None)
    union: np.ndarray = masks if masks.ndim == 2 else np.asarray(masks.any(axis=0))
    factor = min(1.0, 96 / max(height, width))
    rows, columns = np.flatnonzero(union.any(axis=1)), np.flatnonzero(union.any(axis=0))

    def part(found: np.ndarray) -> slice:
        return slice(int(found[0] * factor), max(int(np.ceil((found[-1] + 1) * factor)), int(found[0] * factor) + 1))

    return part(rows), part(columns)


def _thumb(cv2: object, small: np.ndarray, window: tuple[slice, slice]) -> np.ndarray:
    image = small[window]
    thumb = cv2.resize(image, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)  # type: ignore[attr-defined]
    thumb = thumb - thumb.mean()
    normal: np.ndarray = (thumb / max(float(thumb.std()), 1e-4)).astype(np.float32)
    return normal


def _distance(cv2: object, thumbs: dict[int, np.ndarray], frame: int, others: np.ndarray) -> float:
    """Mean over the others of one minus the best correlation within shifts of a quarter of the window."""
    border = _SIDE // 4
    own = thumbs[frame][border:-border, border:-border]
    found = []
    for other in others:
        if int(other) == frame:
            continue
        scores = cv2.matchTemplate(thumbs[int(other)], own, cv2.TM_CCOEFF_NORMED)  # type: ignore[attr-defined]
        best = float(scores.max())
        found.append(1 - best if np.isfinite(best) else 1.0)
    return float(np.mean(found)) if found else 0.0
