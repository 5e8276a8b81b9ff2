"""Points in view coordinates to a shaded picture: surfaces from triangles, or discs that follow them.

View coordinates are the camera's: x right, y down, z away from the viewer. Row 0 of a picture is its top.
"""

from __future__ import annotations

import numpy as np

from nrsfm.viewing.raster import Hits, rasterise_discs, rasterise_triangles
from nrsfm.viewing.style import PAPER, rgb


def _direction(*vector: float) -> np.ndarray:
    return np.array(vector, dtype=np.float32) / np.float32(np.linalg.norm(vector))


_KEY = _direction(-0.42, -0.62, -0.70)  # from above, left of the viewer
_FILL = _direction(0.80, -0.05, -0.60)
_SHINE = _direction(_KEY[0], _KEY[1], _KEY[2] - 1.0)  # halfway between light and viewer


def vertex_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (P, 3), averaged by area over the triangles around each point; zero without any."""
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = triangles.ravel()
    total = np.stack([np.bincount(flat, np.repeat(normal[:, k], 3), minlength=len(points)) for k in range(3)], axis=1)
    total = total.astype(np.float64)  # without triangles, bincount gives integers
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def neighbour_normals(points: np.ndarray, count: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (P, 3) of the planes through each point's neighbours, and the spacing (P,) around it."""
    from scipy.spatial import cKDTree

    count = min(count, len(points))
    distance, index = cKDTree(points).query(points, k=count)
    near = points[index.reshape(len(points), count)]
    near = near - near.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    return vectors[:, :, 0], distance.reshape(len(points), count)[:, min(6, count - 1)]


def _lit(colour: np.ndarray, normal: np.ndarray, strength: float) -> np.ndarray:
    """Colour (N, 3) under the lights; strength 1 for clay, less where colour itself carries meaning."""
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-12)
    normal = np.where(normal[:, 2:] > 0, -normal, normal)  # both sides of a surface are lit alike
    key = np.clip(normal @ _KEY, 0.0, None)
    fill = np.clip(normal @ _FILL, 0.0, None)
    rim = 1.0 - np.clip(-normal[:, 2], 0.0, 1.0)
    shine = np.clip(normal @ _SHINE, 0.0, 1.0) ** 32
    light = 0.34 + 0.62 * key + 0.24 * fill - 0.08 * rim * rim * rim
    light = 1.0 + strength * (light - 1.0)
    return np.clip(colour * light[:, None] + 0.07 * strength * shine[:, None], 0.0, 1.0)


def _blend(weights: np.ndarray, values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Mean (N, 3) of the corners' values under the weights; one row where all corners share it."""
    if values.strides[0] == 0:
        return np.broadcast_to(values[0], (len(corners), 3))
    out = weights[:, :1] * values[corners[:, 0]]
    for k in (1, 2):
        out += weights[:, k : k + 1] * values[corners[:, k]]
    return out


def render(
    points: np.ndarray,
    colours: np.ndarray,
    *,
    half_size: tuple[float, float],
    pixels_per_unit: float,
    triangles: np.ndarray | None = None,
    strength: float = 1.0,
    crisp: bool = False,
) -> np.ndarray:
    """Picture (height, width, 3) uint8 of points (P, 3) in view coordinates, centred on the origin.

    Parameters
    ----------
    colours
        (3,) for all or (P, 3), 0 to 1.
    half_size
        Half the width and half the height shown, in the points' unit.
    triangles
        (M, 3); without them each point becomes a disc.
    strength
        How strongly light changes the colours, 0 to 1.
    crisp
        Colours do not blend inside a triangle: for labels.

    Points that are not finite, and triangles that use them, are left out.
    """
    width, height = (max(2, round(2 * h * pixels_per_unit)) for h in half_size)
    image = np.tile(rgb(PAPER).astype(np.float32), (height * width, 1))
    points = np.asarray(points, dtype=np.float64)
    known = np.isfinite(points).all(axis=1)
    xy = points[:, :2] * pixels_per_unit + (width / 2, height / 2)
    each = np.broadcast_to(np.asarray(colours, dtype=np.float32), (len(points), 3))
    if triangles is not None and len(triangles):
        triangles = triangles[known[triangles].all(axis=1)]
        hits = rasterise_triangles(xy, points[:, 2], triangles, width, height)
        corners = triangles[hits.element]
        normals = vertex_normals(np.where(known[:, None], points, 0.0), triangles).astype(np.float32)
        normal = _blend(hits.weights, normals, corners)
        if crisp:
            colour = each[corners[np.arange(len(corners)), np.argmax(hits.weights, axis=1)]]
        else:
            colour = _blend(hits.weights, each, corners)
    elif known.any():
        normals, spacing = neighbour_normals(points[known])
        normals = normals.astype(np.float32)
        widest = max(1.3, min(0.65 * pixels_per_unit * float(np.percentile(spacing, 95)), 24.0))
        radius = np.clip(0.65 * spacing * pixels_per_unit, 1.3, widest)
        hits = rasterise_discs(xy[known], points[known, 2], radius, width, height)
        normal, colour = normals[hits.element], each[known][hits.element]
    else:
        hits = Hits(*(np.zeros(0, dtype=np.int64),) * 2, np.zeros((0, 3)))
        normal = colour = np.zeros((0, 3))
    image[hits.pixels] = _lit(colour, normal, strength)
    return (image.reshape(height, width, 3) * 255.0 + 0.5).astype(np.uint8)


def surface_triangles(points: np.ndarray) -> np.ndarray | None:
    """Triangles (M, 3) joining points (P, 3) in view coordinates that lie on one sheet, else ``None``.

    The points are triangulated as the viewer sees them; long and steep triangles are dropped. When too many
    are steep, or too few are left, the points are not a surface seen from the front.
    """
    from scipy.spatial import Delaunay, QhullError

    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(known) < 20:
        return None
    try:
        simplices = known[Delaunay(points[known, :2]).simplices]
    except QhullError:
        return None
    corners = points[simplices]
    edges = corners - np.roll(corners, 1, axis=1)
    flat = np.linalg.norm(edges[..., :2], axis=2)
    longest = flat.max(axis=1)
    short = longest <= 5.0 * np.median(longest)
    normal = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(normal, axis=1)
    steep = np.abs(normal[:, 2]) < 0.17 * size  # more than about 80° away from the viewer
    if np.mean(steep[short]) > 0.15 or short.sum() < 0.5 * len(known):
        return None
    return simplices[short & ~steep]
