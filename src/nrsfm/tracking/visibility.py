"""What was seen and what was not, per point and frame.

Ours. A point counts as visible where the frame looks like the reference around it, it lies in the image and in the
frame's mask where there is one, and the surface shows it the same side as in the reference: the area of the moved pixel
grid has not turned over or shrunk to nothing. Where the reference has no texture, likeness says nothing; there the
verdict of the surroundings holds. Noise lowers every correlation, and with it the threshold.
"""

from __future__ import annotations

import numpy as np

from nrsfm.tracking.filling import spread
from nrsfm.tracking.matching import Template
from nrsfm.video.libraries import import_cv2

_FRAMES = 8  # looked at for the threshold
_BEST = (0.9, 0.85)  # quantile of the correlation, and its value without noise
_LEAST_AREA = 0.08
_TEXTURE = 60.0  # variance of evened grey levels that half tells


def areas(flow: np.ndarray) -> np.ndarray:
    """Return the signed area (h, w) that a unit pixel has after moving by ``flow`` (h, w, 2), slightly smoothed."""
    cv2 = import_cv2()

    smooth = cv2.GaussianBlur(flow, (0, 0), 1.5)
    dy, dx = np.gradient(smooth, axis=0), np.gradient(smooth, axis=1)
    found: np.ndarray = (1 + dx[..., 0]) * (1 + dy[..., 1]) - dx[..., 1] * dy[..., 0]
    return found


def threshold(template: Template, flows: np.ndarray) -> float:
    """Return the correlation above which points count as visible: the option, less where the best are low."""
    others = np.setdiff1d(np.arange(len(flows)), [template.reference])
    chosen = others[np.linspace(0, len(others) - 1, min(len(others), _FRAMES)).astype(int)]
    found = [template.likeness(template.sample(template.frames[f], flows[f]))[template.inside] for f in chosen]
    best = float(np.quantile(np.concatenate(found), _BEST[0]))
    return template.options.likeness * float(np.clip(best / _BEST[1], 0.7, 1))


def judge(
    template: Template, likeness: np.ndarray, flow: np.ndarray, mask: np.ndarray | None, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return visible (h, w) bool and confidence (h, w) float32 in [0, 1] of one frame's flow.

    ``likeness`` (h, w) is that of the frame seen through the flow; ``mask`` is where the object is in this frame,
    (H, W) bool, or ``None``; ``least`` is the :func:`threshold`.
    """
    cv2 = import_cv2()

    tells = (template.variance / (template.variance + _TEXTURE)).astype(np.float32) ** 2 * template.weight
    seen = spread(likeness[..., None], np.maximum(tells, 1e-5).astype(np.float32))[..., 0]
    possible = template.in_image(flow) & (areas(flow) > _LEAST_AREA)
    if mask is not None:
        # Masks are rarely exact to the pixel.
        wide = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        possible &= template.sample(wide.astype(np.float32), flow) > 0.5
    confidence = np.clip(0.5 + (seen - least) / (2 * max(1 - least, 1e-3)), 0, 1) * possible * template.weight
    return (seen > least) & possible & template.inside, confidence.astype(np.float32)
