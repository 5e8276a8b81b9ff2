"""Exact compression: P tracks become a few virtual ones, on which every method runs; then back.

Each cell k of points has W_k = L_k Q_kᵀ with Q_k orthonormal (P_k × r_k, r_k ≤ min(2F, P_k)). All methods act on S
only from the left and look at it only through Gram matrices over points, so they can run on the *virtual tracks*
L_k (2F × r_k) and give exactly the shapes that they would give on W, after expansion by Q_kᵀ.

L_k and Q_k come from the eigendecomposition of the float64 Gram matrix W_k W_kᵀ = V Λ Vᵀ: L_k = V √Λ,
Q_kᵀ = Λ^(−1/2) Vᵀ W_k. A Gram matrix cannot tell singular values below about 1e-8 of the largest from rounding, so
directions below 1e-7 of ‖W‖ are always cut. ``tolerance`` cuts further: in every cell as many trailing directions as
together hold at most that root mean square per coordinate (unit: the rms of all tracks). With ``noise`` > 0 the
singular values are also shrunk optimally for that noise level, cell by cell: a local linear subspace whose dimension
the data choose.

P enters in four passes, each by chunks: :func:`measure`, :func:`track_coordinates` (for the cells), :func:`compress`
and :meth:`CompressedTracks.expand`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.numerics.leading import FULL, leading_eigenpairs
from nrsfm.numerics.noise import (
    noise_from_neighbours,
    noise_from_spectrum,
    risk_of_shrinking,
    shrink_singular_values,
)
from nrsfm.numerics.threads import side_by_side

_CHUNK_BYTES = 4 * 2**20  # float64 working copy of a chunk of tracks
_MANY_FRAMES = 512  # from here on chunks grow with the frames
_LARGEST = 1e35  # spread of the tracks; shapes of that size still fit into float32
_FIRST_DIRECTIONS = 128  # of a large cell of a long sequence; doubled until what is left out is negligible
_TAIL_ROWS = 800  # rows, evenly spread over a long sequence, whose smallest singular values tell the noise
_ROUNDING = 1e-7  # relative singular values below it are rounding in a float64 Gram matrix


@dataclass(frozen=True)
class Measurements:
    """The tracks seen as the paper's W: rows centred, divided by one unit, read in chunks of points.

    ``points`` (F, P, 2) is the caller's array, never copied as a whole; ``translations`` (F, 2) the row means;
    ``unit`` the root mean square of the centred coordinates; ``gram`` (2F, 2F) is W Wᵀ in that unit. Of tracks that are
    read in blocks the points are a sample, those with these ``indices``, and ``total`` is P.
    """

    points: np.ndarray
    translations: np.ndarray
    unit: float
    gram: np.ndarray
    total: int | None = None
    indices: np.ndarray | None = None

    @property
    def frames(self) -> int:
        """F."""
        return self.points.shape[0]

    @property
    def count(self) -> int:
        """P."""
        return self.points.shape[1] if self.total is None else self.total

    def columns(self, which: slice | np.ndarray) -> np.ndarray:
        """Columns of the centred, normalised W as a new float64 array (2F, n)."""
        part = np.moveaxis(self.points[:, which], 2, 1).astype(np.float64, order="C")
        part -= self.translations[:, :, None]
        part /= self.unit
        return part.reshape(2 * self.frames, -1)

    def chunks(self) -> Iterator[slice]:
        """Slices of points small enough for a float64 working copy."""
        yield from _chunks(self.frames, self.count)


def _spread(points: np.ndarray) -> float:
    """Root mean square about each frame's mean, also where its square is beyond floating-point numbers."""
    largest = float(np.abs(points).max()) or 1.0
    scaled = points.astype(np.float64) / largest
    scaled -= scaled.mean(axis=1, keepdims=True)
    extent = float(np.abs(scaled).max()) or 1.0
    return largest * extent * float(np.sqrt(np.mean((scaled / extent) ** 2)))


def _chunks(frames: int, count: int) -> Iterator[slice]:
    # Every chunk adds to a Gram matrix that grows with the square of the frames: long sequences get no fewer columns.
    step = max(1, _CHUNK_BYTES // (16 * min(frames, _MANY_FRAMES)))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def measure(points: np.ndarray) -> Measurements:
    """First pass over the points: row means, unit and Gram matrix of the centred W.

    A provisional offset, the mean of a sample, is taken off first, so that far-away tracks lose no digits.

    Raises ``InputError`` where the points do not spread, or spread so little or so far that squares of coordinates
    leave the range of floating-point numbers.
    """
    frames, count, _ = points.shape
    total = np.zeros(2 * frames)
    gram = np.zeros((2 * frames, 2 * frames))
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
        offset = points[:, :: max(1, count // 256)].astype(np.float64).mean(axis=1)
        for part in _chunks(frames, count):
            block = np.moveaxis(points[:, part], 2, 1).astype(np.float64, order="C")
            block -= offset[:, :, None]
            rows = block.reshape(2 * frames, -1)
            total += rows.sum(axis=1)
            gram += rows @ rows.T
        mean = total / count
        gram -= count * np.outer(mean, mean)
        unit = float(np.sqrt(max(np.trace(gram), 0.0) / (2 * frames * count)))
    if not in_range(unit):
        raise out_of_range(_spread(points))
    return Measurements(points, offset + mean.reshape(frames, 2), unit, gram / unit**2)


def in_range(spread: float) -> bool:
    """Whether squares of coordinates of that root mean square are floating-point numbers; false for NaN."""
    return 1 / _LARGEST <= spread <= _LARGEST


def out_of_range(spread: float) -> InputError:
    """What is said of tracks that are not."""
    return InputError(
        f"tracks: points must spread about their mean by {1 / _LARGEST:g} to {_LARGEST:g} (root mean square), "
        f"received {spread:.3g}"
    )


def spectrum(
    measurements: Measurements,
    members: np.ndarray | None = None,
    *,
    leading: int | None = None,
    energy: float = np.inf,
    edge: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Singular values (r,), descending, and left singular vectors (2F, r) of W, or of some of its columns.

    Through the smaller of the two Gram matrices; r = min(2F, number of columns). Of long sequences with many columns
    (:data:`nrsfm.numerics.leading.FULL`) only the leading ones, where ``leading`` says how many at least: more until
    what is left out has at most ``energy`` as its squared norm, or the last singular value is at most ``edge``.
    """
    rows, count = 2 * measurements.frames, measurements.count if members is None else len(members)
    few = min(rows, count) > FULL and leading is not None
    if count < rows and not few:
        block = measurements.columns(slice(None) if members is None else members)
        squares, right = np.linalg.eigh(block.T @ block)
        values = np.sqrt(np.maximum(squares[::-1], 0.0))
        return values, (block @ right[:, ::-1]) / np.where(values > 0, values, 1.0)
    gram = measurements.gram
    if members is not None:
        gram = np.zeros_like(measurements.gram)
        for part in _chunks(measurements.frames, count):
            block = measurements.columns(members[part])
            gram += block @ block.T
    if few:
        found = leading_eigenpairs(gram, int(leading or 0), energy=energy, least=edge**2)
        return np.sqrt(found.values), found.vectors
    squares, vectors = np.linalg.eigh(gram)
    return np.sqrt(np.maximum(squares[::-1], 0.0)), vectors[:, ::-1]


def _factor(
    values: np.ndarray, vectors: np.ndarray, columns: int, noise: float, tolerance: float, floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Virtual tracks (2F, r) and the map (r, 2F) that makes orthonormal Qᵀ out of W, from its spectrum."""
    shrunk = shrink_singular_values(values, (len(vectors), columns), noise)
    tail = np.cumsum(values[::-1] ** 2)[::-1]  # what would be lost by cutting from here on
    kept = (values > floor) & (shrunk > 0) & (tail > tolerance**2 * len(vectors) * columns)
    if not kept.any():
        kept[0] = True  # an all-zero or all-noise cell keeps one direction: its points stay in the answer
        shrunk[0] = values[0]
    inverse = np.where(values[kept] > floor, 1.0 / np.maximum(values[kept], np.finfo(float).tiny), 0.0)
    return vectors[:, kept] * shrunk[kept], (vectors[:, kept] * inverse).T


@dataclass(frozen=True)
class CompressedTracks:
    """Virtual tracks of all cells side by side, and the way back.

    ``factors`` (F, 2, N); cell k owns columns ``offsets[k]:offsets[k+1]`` and, of the real points, those with
    ``labels == k``; ``sizes`` (K,) counts them. ``discarded`` is the share of ‖W‖² that was cut or shrunk away.
    ``residual`` estimates the noise that shrinking has left, root mean square per coordinate (0 where nothing was).
    Without ``maps`` the virtual points are the real ones (:func:`uncompressed`).
    """

    factors: np.ndarray
    offsets: np.ndarray
    sizes: np.ndarray
    labels: np.ndarray
    maps: tuple[np.ndarray, ...]
    measurements: Measurements
    discarded: float
    residual: float = 0.0

    def expand(self, shapes: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """Shapes (F, 3, N) of the virtual points to shapes (F, P, 3) of the real ones, in the tracks' unit.

        Cells side by side, as many at a time as the linear-algebra library may use threads.
        """
        frames, unit = self.measurements.frames, self.measurements.unit
        if not self.maps:
            return np.ascontiguousarray(shapes.transpose(0, 2, 1) * unit, dtype=dtype)
        out = np.empty((frames, self.measurements.count, 3), dtype=dtype)
        flat = shapes.reshape(3 * frames, -1) * unit
        every = members_of_cells(self.labels, self.sizes)

        def fill(k: int) -> None:
            left, members = flat[:, self.offsets[k] : self.offsets[k + 1]], every[k]
            for part in _chunks(frames, len(members)):
                block = left @ (self.maps[k] @ self.measurements.columns(members[part]))
                out[:, members[part]] = block.reshape(frames, 3, -1).transpose(0, 2, 1)

        for _ in side_by_side(fill, range(len(every))):
            pass
        return out

    def some(self, shapes: np.ndarray, most: int) -> np.ndarray:
        """:meth:`expand` for every so many-th of the points at hand, about ``most`` of them: (F, n, 3) float32."""
        measured, kind = self.measurements, np.dtype(np.float32)
        step = max(1, measured.points.shape[1] // most)
        if not self.maps:
            return self.expand(shapes[:, :, ::step], kind)
        labels = (self.labels if measured.indices is None else self.labels[measured.indices])[::step]
        picked = replace(measured, points=measured.points[:, ::step], total=None, indices=None)
        sizes = np.bincount(labels, minlength=len(self.sizes))
        return replace(self, labels=labels, sizes=sizes, measurements=picked).expand(shapes, kind)


def members_of_cells(labels: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Indices of the points of each cell."""
    return np.split(np.argsort(labels, kind="stable"), np.cumsum(sizes)[:-1])


def compress(
    measurements: Measurements,
    labels: np.ndarray,
    *,
    noise: float = 0.0,
    tolerance: float = 0.0,
    apply: Callable[..., Iterable[Any]] = map,
) -> CompressedTracks:
    """Second pass: the factor of every cell.

    Parameters
    ----------
    measurements
        From :func:`measure`.
    labels
        (P,) cell of each point, 0..K−1, every label in use.
    noise
        Standard deviation of the tracks' noise in units of ``measurements.unit``; 0 compresses exactly.
    tolerance
        Largest root mean square per coordinate that the cut directions of a cell may hold together, same unit.
    apply
        Maps a function over the cells: ``map``, or one that has several at a time.
    """
    sizes = np.bincount(labels)
    size = float(np.trace(measurements.gram))
    floor = _ROUNDING * float(np.sqrt(max(size, 0.0)))

    def factor(indices: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        energy, edge = _negligible(measurements.frames, len(indices), noise, tolerance, floor)
        values, vectors = spectrum(measurements, indices, leading=_FIRST_DIRECTIONS, energy=energy, edge=edge)
        risk = risk_of_shrinking(values, (len(vectors), len(indices)), noise)
        return *_factor(values, vectors, len(indices), noise, tolerance, floor), risk

    return _joined(measurements, labels, sizes, list(apply(factor, members_of_cells(labels, sizes))))


def _negligible(frames: int, count: int, noise: float, tolerance: float, floor: float) -> tuple[float, float]:
    """What may be left out of a cell unseen, a quarter of what the tolerance allows; noise's largest singular value."""
    edge = noise * (np.sqrt(2 * frames) + np.sqrt(count))
    return max(tolerance**2 * frames * count / 2, floor**2), edge


def _joined(
    measurements: Measurements,
    labels: np.ndarray,
    sizes: np.ndarray,
    cells: list[tuple[np.ndarray, np.ndarray, float]],
) -> CompressedTracks:
    """All cells side by side: of each its virtual tracks, the way back, and the risk of its shrinking."""
    size = float(np.trace(measurements.gram))
    stacked = np.concatenate([left for left, _, _ in cells], axis=1)
    offsets = np.concatenate([[0], np.cumsum([left.shape[1] for left, _, _ in cells])])
    risk = sum(risk for _, _, risk in cells)
    lost = 1.0 - float(np.sum(stacked**2)) / size if size > 0 else 0.0
    return CompressedTracks(
        stacked.reshape(measurements.frames, 2, -1),
        offsets,
        sizes,
        labels,
        tuple(back for _, back, _ in cells),
        measurements,
        max(lost, 0.0),
        float(np.sqrt(risk / (2 * measurements.frames * measurements.count))),
    )


def compress_grams(
    measurements: Measurements,
    labels: np.ndarray,
    grams: np.ndarray,
    *,
    noise: float = 0.0,
    tolerance: float = 0.0,
    apply: Callable[..., Iterable[Any]] = map,
) -> CompressedTracks:
    """:func:`compress` from the Gram matrices (K, 2F, 2F) of the cells; ``apply`` maps a function over them."""
    sizes = np.bincount(labels)
    size = float(np.trace(measurements.gram))
    floor = _ROUNDING * float(np.sqrt(max(size, 0.0)))

    def factor(k: int) -> tuple[np.ndarray, np.ndarray, float]:
        energy, edge = _negligible(measurements.frames, int(sizes[k]), noise, tolerance, floor)
        found = leading_eigenpairs(grams[k], _FIRST_DIRECTIONS, energy=energy, least=edge**2)
        values = np.sqrt(found.values)
        risk = risk_of_shrinking(values, (len(found.vectors), int(sizes[k])), noise)
        return *_factor(values, found.vectors, int(sizes[k]), noise, tolerance, floor), risk

    return _joined(measurements, labels, sizes, list(apply(factor, range(len(grams)))))


def uncompressed(measurements: Measurements) -> CompressedTracks:
    """The real tracks, one cell, no maps: for methods whose terms the compression does not preserve."""
    factors = measurements.columns(slice(None)).reshape(measurements.frames, 2, -1)
    count = measurements.count
    labels = np.zeros(count, dtype=np.int64)
    return CompressedTracks(factors, np.array([0, count]), np.array([count]), labels, (), measurements, 0.0)


def track_coordinates(measurements: Measurements, vectors: np.ndarray) -> np.ndarray:
    """Coordinates (P, q) of the tracks in given left singular vectors (2F, q), float32."""
    count = measurements.points.shape[1]
    out = np.empty((count, vectors.shape[1]), dtype=np.float32)
    for part in _chunks(measurements.frames, count):
        out[part] = (vectors.T @ measurements.columns(part)).T
    return out


def estimate_noise(
    measurements: Measurements, values: np.ndarray, coordinates: np.ndarray, rng: np.random.Generator
) -> float:
    """Standard deviation of the tracks' noise in units of ``measurements.unit``.

    The lesser of two upper bounds: from the tail of the singular values, and from neighbouring tracks (sampled).
    """
    rows, count = 2 * measurements.frames, measurements.count
    if len(values) < min(rows, count):  # a long sequence: white noise is alike in all frames, so that some tell
        chosen = np.linspace(0, rows - 1, _TAIL_ROWS).round().astype(np.int64)
        squares = np.linalg.eigvalsh(measurements.gram[np.ix_(chosen, chosen)])[::-1]
        tail = noise_from_spectrum(squares, len(chosen), count)
    else:
        tail = noise_from_spectrum(values**2, rows, count)
    neighbours = 24
    here = len(coordinates)  # fewer than all where the points are a sample
    if here < 4 * neighbours:
        return tail
    samples = rng.choice(here, size=min(64, here // 4), replace=False)
    leading = np.ascontiguousarray(coordinates[:, :3].T)
    near = np.empty((len(samples), neighbours), dtype=np.int64)
    for i, s in enumerate(samples):
        gaps = sum((row - row[s]) ** 2 for row in leading)
        near[i] = np.argpartition(gaps, neighbours - 1)[:neighbours]
    tracks = measurements.columns(near.reshape(-1)).T.reshape(len(samples), neighbours, rows)
    return min(tail, noise_from_neighbours(leading.T[near].astype(np.float64), tracks))
