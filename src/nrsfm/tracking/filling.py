"""Flow where there is none: what is known, continued over what is not.

An affine flow, fitted robustly to the trusted part, carries large motion; what it leaves is spread by a pyramid of
trust-weighted averages, pushed down and pulled up again (after Gortler, Grzeszczuk, Szeliski, Cohen: "The Lumigraph",
SIGGRAPH 1996).
"""

from __future__ import annotations

import numpy as np

from nrsfm.video.libraries import import_cv2

_NOTHING = 1e-12


def spread(flow: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Return ``flow`` (H, W, k) where ``trust`` (H, W) is 1, and averages of ever wider surroundings where it falls."""
    cv2 = import_cv2()

    values, weights = [flow * trust[..., None]], [trust]
    while min(weights[-1].shape) >= 4:
        values.append(_planes(cv2.pyrDown(values[-1])))
        weights.append(cv2.pyrDown(weights[-1]))
    result: np.ndarray = values[-1] / (weights[-1][..., None] + _NOTHING)
    for value, weight in zip(values[-2::-1], weights[-2::-1], strict=True):
        wide = _planes(cv2.pyrUp(result, dstsize=(weight.shape[1], weight.shape[0])))
        share = np.clip(weight, 0, 1)[..., None]
        result = wide + share * (value / (weight[..., None] + _NOTHING) - wide)
    return result


def _planes(image: np.ndarray) -> np.ndarray:
    """OpenCV drops a last dimension of one; give it back."""
    return image if image.ndim == 3 else image[..., None]


def affine(flow: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Return the affine flow (H, W, 2) that fits the trusted part best, with weights against outliers."""
    height, width = trust.shape
    y, x = np.nonzero(trust > 0.05)
    if len(y) < 50:
        return np.zeros_like(flow)
    chosen = np.linspace(0, len(y) - 1, min(len(y), 4000)).astype(int)
    y, x = y[chosen], x[chosen]
    basis = np.stack([np.ones(len(y)), x / width, y / height], axis=1)
    target, own = flow[y, x].astype(np.float64), trust[y, x].astype(np.float64)
    weights = own
    for _ in range(3):
        root = np.sqrt(weights)[:, None]
        found = np.linalg.lstsq(basis * root, target * root, rcond=None)[0]
        away = np.hypot(*(target - basis @ found).T)
        weights = own / np.maximum(1, away / (1.5 * np.median(away) + 0.1))
    rows, columns = np.arange(height)[:, None, None] / height, np.arange(width)[None, :, None] / width
    plane: np.ndarray = (found[0] + found[1] * columns + found[2] * rows).astype(np.float32)
    return plane


def fill(flow: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Return the flow (H, W, 2) float32 with what has little trust replaced by what its surroundings say."""
    plane = affine(flow, trust)
    return plane + spread(flow - plane, trust)
