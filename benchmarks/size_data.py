"""Tracks of a face with any number of points, made straight into a file, and their truth for any stretch of points.

``python -m benchmarks.size_data POINTS FRAMES KIND FILE`` makes one file. Every point is a fixed mean of the vertices
of one quad, so tracks and truth of a stretch of points are one sparse product, and nothing is held as a whole.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.store import data_folder

KINDS = ("vertices", "subdivided", "shuffled", "random")
"""How points lie on the surface, and in which order.

The model's vertices; vertices of the quads split again and again, in the order in which they are made; the same
shuffled; or points anywhere on the quads, in no order.
"""

_SEED = 0
_CHUNK_BYTES = 100e6  # float64 coordinates made at once
_LONG_TAKE = 346


@dataclass(frozen=True)
class Size:
    """Which tracks; a ``kind`` of :data:`KINDS`."""

    points: int
    frames: int
    kind: str = "shuffled"

    @property
    def nbytes(self) -> int:
        """Bytes of the tracks in float32."""
        return self.points * self.frames * 8

    @property
    def file_name(self) -> str:
        """Name of the file of tracks."""
        return f"tracks-{self.points}x{self.frames}-{self.kind}.npy"


@dataclass(frozen=True)
class Surface:
    """Points on a moving surface.

    ``weights(start, stop)`` gives points as means of vertices, sparse (n, V); ``vertices`` (V, F·3) and ``seen``
    (V, F·2) are the vertices in every frame and where the camera sees them.
    """

    size: Size
    weights: Callable[[int, int], Any]
    vertices: np.ndarray
    seen: np.ndarray

    def truth(self, start: int, stop: int) -> np.ndarray:
        """True shapes (F, n, 3) of the points ``start`` to ``stop``, float64."""
        return self._made(self.vertices, 3, start, stop)

    def tracks(self, start: int, stop: int) -> np.ndarray:
        """What the camera sees of them, (F, n, 2), float64."""
        return self._made(self.seen, 2, start, stop)

    def _made(self, values: np.ndarray, axes: int, start: int, stop: int) -> np.ndarray:
        made = self.weights(start, stop) @ values
        return np.asarray(made).reshape(stop - start, self.size.frames, axes).transpose(1, 0, 2)

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Stretches of points whose shapes of all frames take a bounded amount of memory."""
        length = max(1, int(_CHUNK_BYTES / (24 * self.size.frames)))
        for start in range(0, self.size.points, length):
            yield start, min(start + length, self.size.points)


def surface(size: Size) -> Surface:
    """The surface of tracks of a size: the narrow part of the face model, moving as in the takes of its sequences."""
    if size.kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, received '{size.kind}'")
    folder = data_folder()
    with np.load(folder / "ict_face_model.npz") as model, np.load(folder / "ict_sequences.npz") as motion:
        kept = int(model["n_narrow"])
        neutral, offsets = model["neutral"][:kept].astype(np.float64), model["expr"][:, :kept].astype(np.float64)
        quads = model["quads"][(model["quads"] < kept).all(axis=1)]
        weights, rotations = _motion(motion, size.frames)
    shapes = neutral[:, None] + np.einsum("fj,jvi->vfi", weights, offsets)
    seen = np.einsum("fij,vfj->vfi", rotations[:, :2], shapes)
    points = _anywhere(quads, kept, size) if size.kind == "random" else _subdivided(quads, kept, size)
    return Surface(size, points, shapes.reshape(kept, -1), seen.reshape(kept, -1))


def _motion(motion: Any, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (F, 57) and rotations (F, 3, 3): one of the takes, or frames evenly picked from the longer one."""
    name = "rom99" if frames == len(motion["weights_rom99"]) else "rom346"
    weights, rotations = (motion[f"{what}_{name}"].astype(np.float64) for what in ("weights", "rotations"))
    if frames > len(weights):
        raise ValueError(f"frames must be at most {len(weights)}, received {frames}")
    picked = np.arange(frames) * len(weights) // frames
    return weights[picked], rotations[picked]


def _subdivided(quads: np.ndarray, count: int, size: Size) -> Callable[[int, int], Any]:
    """The vertices, or denser ones."""
    from scipy.sparse import eye_array

    from nrsfm.datasets.meshes import densify

    if size.kind != "vertices":
        rows = densify(quads, count, 0, size.points).weights
    elif size.points == count:
        rows = eye_array(count, format="csr")
    else:
        raise ValueError(f"there are {count} vertices, received points {size.points}")
    if size.kind == "shuffled":
        rows = rows[np.random.default_rng(_SEED).permutation(size.points)]
    return lambda start, stop: rows[start:stop]


def _anywhere(quads: np.ndarray, count: int, size: Size) -> Callable[[int, int], Any]:
    """Points on quads picked by chance, at coordinates from 0 to 1 along two of their sides."""
    from scipy.sparse import csr_array

    rng = np.random.default_rng(_SEED)
    which = rng.integers(len(quads), size=size.points, dtype=np.int32)
    place = rng.random((size.points, 2), dtype=np.float32)

    def weights(start: int, stop: int) -> Any:
        u, v = place[start:stop].astype(np.float64).T
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=1)
        corners = quads[which[start:stop]]
        return csr_array((shares.ravel(), corners.ravel(), np.arange(0, corners.size + 1, 4)), (stop - start, count))

    return weights


def write_tracks(made: Surface, path: Path) -> None:
    """Write the tracks as float32 .npy (F, P, 2) in C order, every byte once; the file appears when it is whole."""
    frames, points = made.size.frames, made.size.points
    aside = path.with_name(f".{path.name}.tmp")
    try:
        with aside.open("wb") as stream:
            head = {"descr": "<f4", "fortran_order": False, "shape": (frames, points, 2)}
            np.lib.format.write_array_header_1_0(stream, head)
            stream.flush()
            begin = stream.tell()
            for start, stop in made.chunks():
                block = np.ascontiguousarray(made.tracks(start, stop), dtype="<f4")
                for f in range(frames):
                    _write(stream.fileno(), block[f], begin + (f * points + start) * 8)
            os.fsync(stream.fileno())  # what is timed later must not wait for this
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def _write(handle: int, row: np.ndarray, offset: int) -> None:
    view = row.data.cast("B")
    while len(view):
        done = os.pwrite(handle, view, offset)
        view, offset = view[done:], offset + done


def main() -> None:
    """Make one file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.size_data", description=main.__doc__)
    parser.add_argument("points", type=int)
    parser.add_argument("frames", type=int, help=f"at most {_LONG_TAKE}")
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("file", type=Path)
    given = parser.parse_args()
    from benchmarks.peak import peak_bytes

    start = time.perf_counter()
    size = Size(given.points, given.frames, given.kind)
    write_tracks(surface(size), given.file)
    sys.stderr.write(
        f"{given.file}: {size.nbytes / 1e9:.2f} GB in {time.perf_counter() - start:.1f} s, "
        f"peak memory {peak_bytes() / 1e6:.0f} MB\n"
    )


if __name__ == "__main__":
    main()
