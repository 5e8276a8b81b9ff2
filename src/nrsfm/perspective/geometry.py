"""The perspective camera beside the scaled orthographic one, and the way from one to the other.

A point at (X, Y, Z) in the frame of a camera with focal length f and principal point c is seen at u = c + f (X, Y)/Z.
Let Z_f be the depth of the object's centroid in frame f, s_f = f/Z_f its scale, and z the point's depth from the
centroid. Then Z = Z_f + z and

    u − c = s_f (X, Y) / (1 + s_f z / f),       so       (u − c)(1 + s_f z / f) = s_f (X, Y)

are the scaled orthographic coordinates: exact where z is, also for an object off the image's centre. Both sides need
only s_f z, the depth in image units. A camera matrix with skew and unequal focal lengths is first brought to
square pixels, u ↦ c + f K⁻¹ u.

Source: the pinhole camera and its weak-perspective approximation (Hartley and Zisserman, Multiple View Geometry,
2004, chapter 6); the correction by depth is that of iterative pose (DeMenthon and Davis, IJCV 1995).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.errors import InputError

DEEPEST = 0.5
"""Largest |s z / f| that is undone: an object half as deep as its distance is none for affine cameras."""


def checked_intrinsics(value: Any) -> np.ndarray:
    """K (3, 3) float64 with K₃₃ = 1. Raises ``InputError`` where it is no camera matrix."""
    matrix = np.asarray(value)
    if matrix.dtype.kind not in "fiu" or matrix.shape != (3, 3):
        raise InputError(f"intrinsics: a camera matrix (3, 3) is needed, received {matrix.dtype} {matrix.shape}")
    matrix = matrix.astype(np.float64)
    if not np.isfinite(matrix).all():
        raise InputError("intrinsics: every number must be finite, received NaN or infinity")
    size = float(np.abs(matrix).max())
    below = float(np.abs(matrix[[1, 2, 2], [0, 0, 1]]).max())
    if below > 1e-9 * size or matrix[2, 2] == 0:
        raise InputError(f"intrinsics: an upper triangular matrix with 1 in its corner is needed, received {matrix}")
    matrix = matrix / matrix[2, 2]
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise InputError(f"intrinsics: focal lengths must be positive, received {matrix[0, 0]:g} and {matrix[1, 1]:g}")
    return matrix


def intrinsics_of(focal: float, centre: np.ndarray) -> np.ndarray:
    """K of square pixels with focal length and principal point (2,)."""
    return np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])


def centred_points(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Points (..., 2) as f K⁻¹ u about the principal point: square pixels of the horizontal focal length, float64."""
    (focal, skew, x), (_, vertical, y) = intrinsics[:2]
    out = np.asarray(points, dtype=np.float64) - (x, y)
    out[..., 1] *= focal / vertical
    out[..., 0] -= skew / focal * out[..., 1]
    return out


def _seen(centred: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """The inverse of :func:`centred_points`."""
    (focal, skew, x), (_, vertical, y) = intrinsics[:2]
    out = centred.copy()
    out[..., 0] += skew / focal * out[..., 1]
    out[..., 1] *= vertical / focal
    return np.asarray(out + np.array([x, y]))


def _factors(depths: np.ndarray, scale: float, focal: float) -> np.ndarray:
    return np.asarray(1.0 + np.clip(scale * np.asarray(depths, dtype=np.float64) / focal, -DEEPEST, DEEPEST))


def undo_perspective(points: np.ndarray, depths: np.ndarray, scales: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Points as the scaled orthographic camera would see them; the equation of this module's head.

    Parameters
    ----------
    points
        (F, P, 2), image unit.
    depths
        (F, P) along the camera's axis, away from the camera, from the object's centroid; object unit.
    scales
        (F,) image unit per object unit.
    intrinsics
        (3, 3).

    Returns
    -------
    (F, P, 2) in the points' float type, about the same principal point. |s z| counts up to half the focal length.
    Points that are NaN stay NaN.

    Raises ``InputError`` for arrays of other shapes, or a matrix that is no camera matrix.
    """
    matrix = checked_intrinsics(intrinsics)
    points = np.asarray(points)
    _check_shapes(points, depths, scales)
    kind = points.dtype if points.dtype in (np.float32, np.float64) else np.dtype(np.float64)
    out = np.empty(points.shape, dtype=kind)
    centre = matrix[:2, 2]
    for f, frame in enumerate(points):  # frame by frame: no float64 copy of the whole sequence
        factors = _factors(depths[f], float(scales[f]), float(matrix[0, 0]))
        out[f] = centred_points(frame, matrix) * factors[:, None] + centre
    return out


def perspective_error(points: np.ndarray, result: Any, intrinsics: np.ndarray) -> np.ndarray:
    """Root mean square distance (F,) of points from the shapes seen through the full perspective camera, image unit.

    ``points`` (F, P, 2); ``result`` has ``shapes``, ``rotations`` and ``scales``. The image position of each frame is
    the one that fits best. NaN points do not count; a frame without any gives NaN.
    """
    matrix = checked_intrinsics(intrinsics)
    points = np.asarray(points)
    errors = np.empty(len(points))
    for f, frame in enumerate(points):
        seen = np.asarray(result.shapes[f], dtype=np.float64)
        seen = float(result.scales[f]) * ((seen - seen.mean(axis=0)) @ np.asarray(result.rotations[f]).T)
        factors = _factors(seen[:, 2], 1.0, float(matrix[0, 0]))[:, None]
        good = np.isfinite(frame).all(axis=1)
        if not good.any():
            errors[f] = np.nan
            continue
        centred = centred_points(frame[good], matrix)
        seen, factors = seen[good, :2], factors[good]
        # Least squares in the image: centred ≈ (seen + t) / factors.
        inverse = 1.0 / factors
        shift = np.sum((centred - seen * inverse) * inverse, axis=0) / np.sum(inverse**2)
        gap = _seen((seen + shift) * inverse, matrix) - frame[good]
        errors[f] = np.sqrt(np.mean(np.sum(gap * gap, axis=1)))
    return errors


def _check_shapes(points: np.ndarray, depths: Any, scales: Any) -> None:
    if points.ndim != 3 or points.shape[2] != 2:
        raise InputError(f"points: shape (frames, points, 2) is needed, received {points.shape}")
    for name, value, shape in (("depths", depths, points.shape[:2]), ("scales", scales, points.shape[:1])):
        if np.shape(value) != shape:
            raise InputError(f"{name}: shape {shape} is needed, received {np.shape(value)}")
