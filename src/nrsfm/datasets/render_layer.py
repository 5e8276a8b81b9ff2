"""One frame of the object alone: texture, shading, anti-aliasing.

Ours. Every sample (a few per pixel) shows the texture at its surface point, times what the light there reflects plus
a gloss, both computed at the vertices and interpolated. Pixels are the mean of their samples.
"""

from __future__ import annotations

import numpy as np

from nrsfm.datasets import render_camera as camera
from nrsfm.datasets.render_camera import Effects
from nrsfm.datasets.render_raster import facing, rasterise
from nrsfm.datasets.render_scenes import Scene


def object_layer(
    made: Scene,
    frame: int,
    chosen: Effects,
    light: np.ndarray,
    surface: np.ndarray,
    uv: np.ndarray,
    width: int,
    height: int,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return premultiplied RGB and coverage (H, W, 4), premultiplied motion (H, W, 2), and mask (H, W).

    ``light`` (3,) points to the light; ``surface`` is the texture and ``uv`` (P, 2) where in it the vertices lie.
    The mask marks the pixels whose centre shows the object.
    """
    import cv2

    perspective = made.focal is not None
    seen = made.camera_points(frame)
    xy = made.image(seen)
    hits = rasterise(
        samples * (xy + 0.5) - 0.5, seen[:, 2], made.faces, samples * width, samples * height, perspective=perspective
    )
    size = (samples * height, samples * width)
    vertices = np.empty((len(xy), 6), dtype=np.float32)
    vertices[:, :2] = uv
    vertices[:, 2:4] = 1, 0
    if chosen.shading:
        vertices[:, 2], vertices[:, 3] = camera.shade(_normals(seen, made.faces), light)
    vertices[:, 4:] = _motion(made, frame, xy)
    corners, weights = made.faces[hits.triangle], hits.weights.astype(np.float32)
    values = weights[:, :1] * vertices[corners[:, 0]]
    for k in (1, 2):
        values += weights[:, k : k + 1] * vertices[corners[:, k]]
    where = np.zeros((2, *size), dtype=np.float32)
    where.reshape(2, -1)[:, hits.pixel] = values[:, :2].T
    colour = cv2.remap(surface, where[0], where[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    colour = colour.reshape(-1, 3)[hits.pixel]
    back = facing(xy, made.faces)[hits.triangle] <= 0
    colour[back] = 0.45 * surface.mean(axis=(0, 1)) + 0.15 * colour[back]
    layer = np.zeros((size[0] * size[1], 6), dtype=np.float32)
    layer[hits.pixel, :3] = colour * values[:, 2:3] + values[:, 3:4]
    layer[hits.pixel, 3] = 1
    layer[hits.pixel, 4:] = values[:, 4:]
    layer = layer.reshape(height, samples, width, samples, 6)
    mean = sum(layer[:, i, :, j] for i in range(samples) for j in range(samples)) / np.float32(samples**2)
    assert isinstance(mean, np.ndarray)  # noqa: S101  # for the type checker: sum() starts from 0
    centre = rasterise(xy, seen[:, 2], made.faces, width, height, perspective=perspective)
    mask = np.zeros(height * width, dtype=bool)
    mask[centre.pixel] = True
    return mean[..., :4], np.ascontiguousarray(mean[..., 4:]), mask.reshape(height, width)


def _motion(made: Scene, frame: int, xy: np.ndarray) -> np.ndarray:
    """Image motion (P, 2) of the vertices in pixels per frame: central difference, one-sided at the ends."""
    before, after = max(frame - 1, 0), min(frame + 1, made.n_frames - 1)
    if before == after:
        return np.zeros_like(xy)
    first = xy if before == frame else made.image(made.camera_points(before))
    last = xy if after == frame else made.image(made.camera_points(after))
    return (last - first) / (after - before)


def _normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (P, 3) of the vertices, weighted by area and turned towards the camera (z below 0)."""
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.stack(
        [sum(np.bincount(faces[:, k], across[:, axis], minlength=len(points)) for k in range(3)) for axis in range(3)],
        axis=1,
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals[normals[:, 2] > 0] *= -1
    return normals
