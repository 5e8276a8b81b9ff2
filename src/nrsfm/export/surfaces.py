"""Which points are joined to a surface: faces given, a grid, or triangles between the points as one frame sees them.

``auto`` triangulates the image points of one frame (Delaunay) and drops what does not lie on the surface. Neighbours
on a surface stay neighbours however it moves, and are about as far apart as other neighbours there. With

    ℓ_e  the length in space of edge e = (i, j), the largest of a few frames spread over the sequence,
    d_i  the distance in space from point i to its 6th nearest point, in the frame that is triangulated,

an edge is long where ℓ_e > 3 max(d_i, d_j), and triangles with a long edge are dropped. Both sides are lengths in
space: a steep part of a surface, whose points the image crowds, keeps its triangles (on a square pixel grid up to a
slope of 1 : 9), and noise of the depths makes both sides longer. d is that of the denser or the sparser part, never
one number for the sequence. Triangles without width along the rim, between points in a row, are dropped too.

Delaunay triangles are right where the frame sees one layer, from its front. So, unless a frame is named, that one is
taken, of a few spread over the sequence, whose edges join the nearest points: of the least mean of
min(ℓ_e / max(d_i, d_j), 3).

Source: Delaunay, "Sur la sphère vide", 1934, computed by Qhull (through SciPy); the rule for edges and the choice of
the frame: ours.
"""

from __future__ import annotations

import dataclasses
import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nrsfm.errors import FileError, InputError, OptionError, suggest
from nrsfm.reconstruction import Reconstruction

NEIGHBOUR = 6
LONGEST = 3.0
_FRAMES = 8  # over which the length of an edge is taken
_CANDIDATES = 12  # frames that may be triangulated
_SAMPLE = 10_000  # points that are enough to choose between them
_FEW = 0.75  # share of edges kept, below which the points are hardly one layer
_THIN = 0.01  # height over length of a triangle in the image, below which it has no width
_GRID = re.compile(r"grid:(\d+)x(\d+)")
_MESH_FILES = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf")


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Triangles (T, 3) int32 of points; in words, where they come from; and what to know before using them."""

    faces: np.ndarray
    origin: str
    warnings: tuple[str, ...] = ()


def find_surface(
    faces: Any, result: Reconstruction, *, reference: int | None = None, mask: np.ndarray | None = None
) -> Surface | None:
    """Return the surface of a reconstruction, or ``None`` where it is to be points.

    Parameters
    ----------
    faces
        ``None`` or ``"none"``; ``"auto"``; ``"grid:ROWSxCOLS"``, where the points are a grid, row by row; (T, 3)
        triangles or (T, 4) quads as numbers of points from 0; or a file with an array ``faces``, or a mesh file with as
        many vertices as there are points.
    result
        P points. Triangles with points that were not reconstructed are left out.
    reference
        Frame to triangulate; ``None``: chosen.
    mask
        (H, W) bool: the object in the reference frame's image.

    Raises
    ------
    OptionError, InputError, FileError
        The faces do not fit the points, or none is left.
    """
    if faces is None or (isinstance(faces, str) and faces == "none"):
        if mask is not None:
            raise OptionError("a mask cuts the surface of faces='auto', and the faces asked for are none")
        return None
    if isinstance(faces, str) and faces == "auto":
        return _triangulated(result, reference, mask)
    if mask is not None:
        raise OptionError("a mask cuts the surface of faces='auto': it has no use for other faces")
    if isinstance(faces, str | os.PathLike):
        text = os.fspath(faces)
        grid = _GRID.fullmatch(text)
        if grid:
            array, origin = grid_faces(int(grid[1]), int(grid[2]), result), f"a grid of {grid[1]} × {grid[2]}"
        elif text.startswith("grid:"):
            raise OptionError(f"faces: a grid is written grid:ROWSxCOLS, received '{text}'")
        elif not Path(text).suffix and not Path(text).exists():
            hint = suggest(text, ("auto", "none")) or "; auto, none, grid:ROWSxCOLS and files are known"
            raise OptionError(f"unknown faces '{text}'{hint}")
        else:
            array, origin = read_faces(text, result.n_points), f"the file '{text}'"
    else:
        array, origin = np.asarray(faces), "given"
    triangles = checked_faces(array, result.n_points)
    left = triangles[result.reconstructed[triangles].all(axis=1)]
    if not len(left):
        raise InputError(f"faces: no face is left of {len(triangles)}: each has a point that was not reconstructed")
    return Surface(left, origin)


def checked_faces(faces: np.ndarray, points: int) -> np.ndarray:
    """Triangles (T, 3) int32 of triangles (T, 3) or quads (T, 4, split along their first diagonal).

    Raises ``InputError`` where they are no numbers of points.
    """
    if faces.ndim != 2 or faces.shape[1] not in (3, 4) or not len(faces):
        raise InputError(f"faces: shape (faces, 3) or (faces, 4) is needed, received {faces.shape}")
    if faces.dtype.kind == "f" and np.isfinite(faces).all() and (faces == np.rint(faces)).all():
        faces = faces.astype(np.int64)
    if faces.dtype.kind not in "iu":
        raise InputError(f"faces: whole numbers of points are needed, received dtype {faces.dtype}")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= points:
        raise InputError(f"faces: numbers of points from 0 to {points - 1} are needed, received {low} to {high}")
    if faces.shape[1] == 4:
        faces = faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)].astype(np.int32)


def read_faces(path: str, points: int) -> np.ndarray:
    """Faces of a file of arrays that holds ``faces``, or of a mesh file; raises ``FileError`` where it has none."""
    from nrsfm.files.container import known_extensions, listing, open_arrays, reading

    suffix = Path(path).suffix.lower()
    if suffix not in _MESH_FILES:
        if suffix not in known_extensions():
            known = ", ".join((*known_extensions(), *_MESH_FILES))
            raise FileError(f"cannot read faces from '{path}': extensions {known} are known, received '{suffix}'")
        entries = open_arrays(path)
        if "faces" not in entries and len(entries) != 1:
            raise FileError(f"'{path}' must hold an array 'faces', or one array only; it holds {listing(entries)}")
        return entries["faces" if "faces" in entries else next(iter(entries))].read()
    if not Path(path).is_file():
        raise FileError(f"cannot read '{path}': there is no such file")
    try:
        import trimesh
    except ImportError as error:
        raise FileError(f"cannot read '{path}': mesh files need trimesh (the extra 'export')") from error
    with reading(path, "a mesh file"):
        # process and maintain_order: vertices are points by their number, so none may be merged or moved.
        mesh: Any = trimesh.load(path, process=False, maintain_order=True, force="mesh")
        vertices, faces = len(mesh.vertices), np.asarray(mesh.faces)
    if vertices != points:
        raise FileError(f"'{path}' has {vertices} vertices: one for each of the {points} points is needed")
    return faces


def grid_faces(rows: int, columns: int, result: Reconstruction) -> np.ndarray:
    """Two triangles in each cell of a grid, row by row, which face the first camera."""
    if rows < 2 or columns < 2 or rows * columns != result.n_points:
        raise OptionError(
            f"faces 'grid:{rows}x{columns}': rows × columns, both at least 2, must be the number of points, "
            f"{result.n_points}"
        )
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    whole = faces[result.reconstructed[faces].all(axis=1)]
    area = _areas(_seen(result, 0), whole)
    return faces if area.sum() <= 0 else faces[:, ::-1]  # the image's y points down: facing it is clockwise there


def _triangulated(result: Reconstruction, reference: int | None, mask: np.ndarray | None) -> Surface:
    kept = np.flatnonzero(result.reconstructed)
    frame = reference
    if mask is not None:
        frame = reference or 0
    if frame is None:
        frame = _best_frame(result, kept)
    triangles, share, _ = _triangulate(result, kept, frame)
    if not len(triangles):
        raise InputError("faces 'auto': no triangle is left: the points lie on a line, or are scattered")
    warnings: tuple[str, ...] = ()
    if share < _FEW:
        warnings = (
            f"only {100 * share:.0f} % of the edges between neighbours in frame {frame} lie on the surface: the points "
            "are hardly one layer seen from the front; a mesh given as faces would be better",
        )
    origin = f"triangles in frame {frame}, {100 * (1 - share):.1f} % of the edges cut"
    if mask is not None:
        seen = _seen(result, frame)
        corners = seen[triangles]
        probes = np.concatenate([(corners + np.roll(corners, 1, axis=1)) / 2, corners.mean(axis=1)[:, None]], axis=1)
        triangles = triangles[_inside(mask, probes).all(axis=1)]
        if not len(triangles):
            raise InputError(f"mask: no triangle of frame {frame} lies inside it")
        origin += ", within the mask"
    return Surface(triangles, origin, warnings)


def _best_frame(result: Reconstruction, kept: np.ndarray) -> int:
    """The frame, of a few, in whose triangulation edges are shortest; the earliest of equals."""
    if len(kept) > _SAMPLE:
        kept = kept[np.arange(_SAMPLE) * len(kept) // _SAMPLE]
    frames = np.unique(np.linspace(0, result.n_frames - 1, _CANDIDATES).astype(int)).tolist()
    return int(min(frames, key=lambda frame: (round(_triangulate(result, kept, frame).stretch, 3), frame)))


class _Triangulation(NamedTuple):
    """Triangles (T, 3) that face the frame's camera; share of edges kept; mean of min(ℓ / max(d), 3) over edges."""

    triangles: np.ndarray
    share: float
    stretch: float


def _triangulate(result: Reconstruction, kept: np.ndarray, frame: int) -> _Triangulation:
    from scipy.spatial import Delaunay, QhullError, cKDTree

    seen = _seen(result, frame)
    try:
        simplices = kept[Delaunay(seen[kept]).simplices]
    except QhullError:
        return _Triangulation(np.empty((0, 3), dtype=np.int32), 0.0, np.inf)
    shape = np.asarray(result.shapes[frame], dtype=np.float64)
    spacing = np.zeros(result.n_points)
    count = min(NEIGHBOUR, len(kept) - 1)
    spacing[kept] = cKDTree(shape[kept]).query(shape[kept], k=[count + 1])[0][:, 0]
    sides = np.sort(np.stack([simplices, np.roll(simplices, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    keys, inverse = np.unique(sides[:, 0].astype(np.int64) * result.n_points + sides[:, 1], return_inverse=True)
    edges = np.column_stack([keys // result.n_points, keys % result.n_points])
    lengths = np.zeros(len(edges))
    for other in {frame, *np.linspace(0, result.n_frames - 1, _FRAMES).astype(int).tolist()}:
        points = np.asarray(result.shapes[other], dtype=np.float64)
        lengths = np.maximum(lengths, np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))
    beside = np.maximum(spacing[edges[:, 0]], spacing[edges[:, 1]])
    long = lengths > LONGEST * beside
    sides = inverse.reshape(-1, 3)
    short = ~long[sides].any(axis=1)
    triangles = _without_slivers(simplices[short], sides[short], seen)
    flip = _areas(seen, triangles) > 0
    triangles[flip] = triangles[flip][:, ::-1]
    ratio = lengths / np.maximum(beside, np.finfo(float).tiny)
    return _Triangulation(
        triangles.astype(np.int32), float(1.0 - long.mean()), float(np.minimum(ratio, LONGEST).mean())
    )


def _without_slivers(triangles: np.ndarray, sides: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Drop triangles without width along the rim: points in a row have a hull, and no surface, between them."""
    longest = np.zeros(len(triangles))
    for k in range(3):
        step = seen[triangles[:, k]] - seen[triangles[:, (k + 1) % 3]]
        longest = np.maximum(longest, np.sum(step * step, axis=1))
    sliver = np.abs(_areas(seen, triangles)) < _THIN * longest
    while True:
        rim = np.bincount(sides.ravel(), minlength=int(sides.max(initial=0)) + 1) == 1
        kept = ~(sliver & rim[sides].any(axis=1))
        if kept.all():
            return triangles
        triangles, sides, sliver = triangles[kept], sides[kept], sliver[kept]


def _seen(result: Reconstruction, frame: int) -> np.ndarray:
    """(P, 2) image points of a frame, float64."""
    shape = np.asarray(result.shapes[frame], dtype=np.float64)
    return np.asarray(result.scales[frame] * (shape @ result.rotations[frame, :2].T) + result.translations[frame])


def _areas(seen: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Twice the signed areas (T,), positive where anticlockwise in axes x right, y up: clockwise to the eye here."""
    a, b, c = (seen[faces[:, k]] for k in range(3))
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _inside(mask: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points (..., 2), pixels, are in the mask (H, W); its pixels' centres are at whole coordinates."""
    height, width = mask.shape
    column, row = np.rint(points[..., 0]).astype(int), np.rint(points[..., 1]).astype(int)
    within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return np.asarray(within & mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])
