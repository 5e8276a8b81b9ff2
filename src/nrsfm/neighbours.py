"""Which points are neighbours: from a mesh, from a pixel grid, or found among the tracks; and its two operators.

Both operators are scaled so that a weight means the same for any number of points and any kind of graph. Tracks of
unit rms cover an area of about 4π (a disc has exactly that), so neighbours among P points are about

    ℓ = √(4π / P)

apart, and with d_i neighbours of point i, evenly spread in direction,

    |∇u|_i² ≈ 2/(d_i ℓ²) Σ_j (u_j − u_i)²        (:func:`gradient`)
    (Δu)_i  ≈ 4/(d_i ℓ²) Σ_j (u_j − u_i)         (:func:`laplacian`).

On a grid the gradient takes forward differences only, right and below, as in images: its total variation is that of
the image. ℓ is not measured on the tracks, because their noise, not the spacing, would decide it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.errors import OptionError
from nrsfm.options import option

NEAREST = 8
_COORDINATES = 10  # leading track coordinates in which neighbours are looked for


@dataclass(frozen=True)
class NeighbourOptions:
    """How the neighbours of a point are known: a mesh, a grid, or the nearest tracks where neither is given."""

    neighbours: int = option(
        NEAREST,
        "Nearest tracks that become neighbours of a point where neither faces nor grid are given; the relation is "
        "made mutual. Distances are between whole tracks, so that points close in one frame only are not joined.",
        symbol="k",
        minimum=1,
    )
    faces: np.ndarray | None = option(  # noqa: RUF009 - an immutable field, as the others
        None, "Mesh: (M, 3) triangles or (M, 4) quads as numbers of points from 0. Their sides join neighbours."
    )
    grid: np.ndarray | None = option(  # noqa: RUF009
        None,
        "Pixel grid: (P, 2) whole numbers, column and row of every point in a reference image, no pixel twice. "
        "Pixels that share a side are neighbours; pixels without a point are holes.",
    )


@dataclass(frozen=True, eq=False)
class Neighbours:
    """A graph of points.

    ``edges`` (E, 2): pairs of neighbours, each once; on a grid the second point is right of or below the first.
    ``kind``: "mesh", "grid" or "tracks".
    """

    points: int
    edges: np.ndarray
    kind: str

    @property
    def spacing(self) -> float:
        """ℓ = √(4π / P): about the distance between neighbours, in units of the tracks' rms."""
        return float(np.sqrt(4.0 * np.pi / self.points))

    @property
    def degrees(self) -> np.ndarray:
        """(P,) number of neighbours of each point."""
        return np.bincount(self.edges.reshape(-1), minlength=self.points)

    def pieces(self) -> int:
        """Number of connected pieces. Nothing joins them: each piece is made smooth by itself."""
        from scipy.sparse.csgraph import connected_components

        return int(connected_components(self._adjacency(), directed=False)[0])

    def _adjacency(self) -> Any:
        from scipy.sparse import csr_array

        first, second = self.edges.T
        ones = np.ones(2 * len(self.edges))
        where = np.concatenate([first, second]), np.concatenate([second, first])
        return csr_array((ones, where), shape=(self.points, self.points))


def find_neighbours(tracks: np.ndarray, options: NeighbourOptions, noise: float = 0.0) -> Neighbours:
    """The graph that the options ask for.

    Parameters
    ----------
    tracks
        (F, 2, P), centred, of unit rms.
    options
        A mesh, a grid, or neither: then the nearest tracks.
    noise
        Standard deviation of a coordinate; track coordinates that hold nothing else are not compared.

    Raises ``OptionError`` where faces and grid do not fit the points, or both are given.
    """
    points = tracks.shape[2]
    if options.faces is not None and options.grid is not None:
        raise OptionError("options 'faces' and 'grid': one of them may be given, received both")
    if options.faces is not None:
        return Neighbours(points, edges_of_mesh(options.faces, points), "mesh")
    if options.grid is not None:
        return Neighbours(points, edges_of_grid(options.grid, points), "grid")
    return Neighbours(points, edges_of_tracks(tracks, options.neighbours, noise), "tracks")


def edges_of_mesh(faces: np.ndarray, points: int) -> np.ndarray:
    """Sides (E, 2) of triangles (M, 3) or quads (M, 4), each once, the smaller number first."""
    if faces.ndim != 2 or faces.shape[1] not in (3, 4) or not len(faces):
        raise OptionError(f"option 'faces' must have shape (faces, 3 or 4), received {faces.shape}")
    faces = _whole(faces, "faces")
    if faces.min() < 0 or faces.max() >= points:
        raise OptionError(
            f"option 'faces' must hold numbers of points from 0 to {points - 1}, "
            f"received {faces.min()} to {faces.max()}"
        )
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    return _unique(sides, points)


def edges_of_grid(grid: np.ndarray, points: int) -> np.ndarray:
    """Pairs (E, 2) of points in pixels that share a side, the left or upper one first."""
    if grid.shape != (points, 2):
        raise OptionError(f"option 'grid' must have shape ({points}, 2), a pixel for each point, received {grid.shape}")
    pixels = _whole(grid, "grid")
    pixels = pixels - pixels.min(axis=0)
    stride = int(pixels[:, 0].max()) + 2  # an empty column: the last pixel of a row has no neighbour in the next
    keys = pixels[:, 1] * stride + pixels[:, 0]
    order = np.argsort(keys, kind="stable")
    ranked = keys[order]
    twice = np.flatnonzero(np.diff(ranked) == 0)
    if len(twice):
        pair = sorted(order[twice[0] : twice[0] + 2].tolist())
        raise OptionError(f"option 'grid' must give every point a pixel of its own, received one for points {pair}")
    pairs = []
    for step in (1, stride):
        at = np.minimum(np.searchsorted(ranked, keys + step), points - 1)
        found = np.flatnonzero(ranked[at] == keys + step)
        pairs.append(np.column_stack([found, order[at[found]]]))
    return np.concatenate(pairs)


def edges_of_tracks(tracks: np.ndarray, count: int, noise: float = 0.0) -> np.ndarray:
    """Pairs (E, 2) of points of which one is among the ``count`` nearest tracks of the other.

    ``tracks`` (F, 2, P). Distances are taken in the leading coordinates of the tracks that stand above the noise, at
    least 3 and at most 10. Points with the same track are neighbours at distance zero; more than ``count`` of
    them have one another as neighbours, and others only where these in turn find them.
    """
    from scipy.spatial import cKDTree

    frames, _, points = tracks.shape
    flat = tracks.reshape(2 * frames, points)
    squares, vectors = np.linalg.eigh(flat @ flat.T)
    edge = noise * (np.sqrt(points) + np.sqrt(2 * frames))  # largest singular value of noise alone
    above = int(np.count_nonzero(np.sqrt(np.maximum(squares, 0.0)) > 1.1 * edge))
    leading = vectors[:, ::-1][:, : min(max(above, 3), _COORDINATES)]
    coordinates = np.ascontiguousarray((leading.T @ flat).T)
    count = min(count, points - 1)
    near = cKDTree(coordinates).query(coordinates, k=count + 1)[1]
    pairs = np.column_stack([np.repeat(np.arange(points), count + 1), near.reshape(-1)])
    return _unique(pairs, points)


def gradient(graph: Neighbours) -> tuple[Any, np.ndarray]:
    """Gradient operator D (rows × P, sparse) and for each row the point that owns it, ascending.

    The total variation of u (P,) is Σ_i √(Σ_{rows of i} (D u)²). On a grid a point owns its forward differences; in
    any other graph all of its own edges, because nothing tells forward from backward there.
    """
    from scipy.sparse import csr_array

    first, second = graph.edges.T
    scale = np.full(len(graph.edges), 1.0 / graph.spacing)
    if graph.kind != "grid":
        first, second = np.concatenate([first, second]), np.concatenate([second, first])
        scale = np.sqrt(2.0 / graph.degrees[first]) / graph.spacing
    order = np.argsort(first, kind="stable")
    first, second, scale = first[order], second[order], scale[order]
    rows = np.arange(len(first))
    values = np.concatenate([-scale, scale])
    where = np.concatenate([rows, rows]), np.concatenate([first, second])
    return csr_array((values, where), shape=(len(rows), graph.points)), first


def laplacian(graph: Neighbours) -> Any:
    """𝓛 (P × P, sparse): (𝓛u)_i = 4/ℓ² · (mean of the neighbours' u − u_i); zero for a point without neighbours."""
    from scipy.sparse import diags_array

    degrees = graph.degrees
    inverse = np.where(degrees > 0, 4.0 / (np.maximum(degrees, 1) * graph.spacing**2), 0.0)
    return (diags_array(inverse) @ (graph._adjacency() - diags_array(degrees.astype(float)))).tocsr()


def _whole(values: np.ndarray, name: str) -> np.ndarray:
    """The values as integers; MATLAB files hold whole numbers as floating-point ones."""
    if not np.isfinite(values).all() or (values != np.rint(values)).any():
        raise OptionError(f"option '{name}' must hold whole numbers, received others")
    return values.astype(np.int64)


def _unique(pairs: np.ndarray, points: int) -> np.ndarray:
    """Each pair once, the smaller number first, no point with itself."""
    low, high = pairs.min(axis=1), pairs.max(axis=1)
    keys = np.unique((low * points + high)[low != high])
    return np.column_stack([keys // points, keys % points])
