"""Whether complete tracks may hold outliers at all: a cheap look before anything costly, one pass over the points.

A plain PCA of rank 6 of a sample leaves residuals; the points whose largest residual stands out most from their own
median, at most a few hundred, are compared with their neighbours as in :mod:`nrsfm.repair.outliers`. Those that still
stand out are excused where they are few and a PCA of as many directions as stand above the noise, of a sample without
them, explains them: a small part that truly moves by itself. Errs on the side of looking closer. Ours.
"""

from __future__ import annotations

import numpy as np

from nrsfm.numerics.noise import noise_from_spectrum
from nrsfm.repair.view import View

_SAMPLE = 500
_RANK = 6
_NEIGHBOURS = 8
_LOOK = 300  # points that are compared with their neighbours
_SUSPECT = 8.0
_FLOOR = 0.0025
_OWN = 3.0  # a track excuses itself by its own restlessness up to this many times that of the others
_FEW = 0.01  # share of the points that may be excused
_EXPLAINED = 0.01  # a residual of this size, in units of the rms, is no outlier
_FRAMES = 25  # a point's median residual is taken over about so many frames
_CHUNK = 40_000


def _directions(tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row means (2F, 1), left singular vectors, descending, and squared singular values of (2F, n)."""
    mean = tracks.mean(axis=1, keepdims=True)
    gap = tracks - mean
    if gap.shape[0] <= gap.shape[1]:
        squares, vectors = np.linalg.eigh(gap @ gap.T)
        return mean, vectors[:, ::-1], np.maximum(squares[::-1], 0.0)
    squares, right = np.linalg.eigh(gap.T @ gap)
    squares = np.maximum(squares[::-1], 0.0)
    good = squares > 1e-14 * max(squares[0], 1e-300)
    vectors = gap @ right[:, ::-1][:, good] / np.sqrt(squares[good])
    return mean, vectors, squares[good]


def _distances(rest: np.ndarray) -> np.ndarray:
    """(2F, n) residuals to (F, n) lengths."""
    squares = rest * rest
    return np.sqrt(squares[0::2] + squares[1::2])


def worth_a_look(view: View, rng: np.random.Generator) -> bool:
    """Whether complete tracks should be searched for outliers."""
    frames, count = view.frames, view.count
    if count <= 3 * _NEIGHBOURS:
        return True
    sample = np.arange(count) if count <= _SAMPLE else np.sort(rng.choice(count, size=_SAMPLE, replace=False))
    known = view.columns(sample).reshape(2 * frames, -1)
    mean, vectors, _ = _directions(known)
    basis = vectors[:, : min(_RANK, frames, len(sample) // 3)]
    left = known - mean
    left -= basis @ (basis.T @ left)
    reach = max(float(np.median(np.quantile(_distances(left), 0.85, axis=0))), _FLOOR)
    basis32 = basis.astype(np.float32)
    offset = (view.offset + view.unit * mean.reshape(frames, 2))[:, :, None]
    coordinates = np.empty((count, basis.shape[1]), dtype=np.float32)
    standing = np.empty(count, dtype=np.float32)
    step = max(1, _CHUNK // frames)
    thin = slice(None, None, max(1, frames // _FRAMES))
    for start in range(0, count, step):
        part = slice(start, min(start + step, count))
        block = np.empty((frames, 2, part.stop - start), dtype=np.float32)
        np.subtract(view.points[:, part].transpose(0, 2, 1), offset, out=block, casting="same_kind")
        flat = block.reshape(2 * frames, -1)
        flat *= np.float32(1.0 / view.unit)
        coordinates[part] = (basis32.T @ flat).T
        flat -= basis32 @ coordinates[part].T
        apart = _distances(flat)
        own = np.median(apart[thin], axis=0)
        standing[part] = apart.max(axis=0) / np.clip(own, np.float32(reach), np.float32(_OWN * reach))
    suspects = np.flatnonzero(standing > _SUSPECT)
    if not len(suspects):
        return False
    if len(suspects) > _LOOK:
        suspects = suspects[np.argsort(-standing[suspects], kind="stable")[:_LOOK]]
    strange = suspects[_unlike_neighbours(view, suspects, coordinates, basis, mean, reach) > _SUSPECT]
    if not len(strange):
        return False
    if len(strange) > max(_FEW * count, 1):
        return True
    return not _explained(view, strange, known[:, ~np.isin(sample, strange)])


def _unlike_neighbours(
    view: View, points: np.ndarray, coordinates: np.ndarray, basis: np.ndarray, mean: np.ndarray, reach: float
) -> np.ndarray:
    """(n,) largest score of each point against its nearest tracks."""
    from scipy.spatial import cKDTree

    k = _NEIGHBOURS + 1
    near = cKDTree(coordinates).query(coordinates[points], k=k)[1]
    out = np.empty(len(points))
    step = max(1, _CHUNK // (k * view.frames))
    for start in range(0, len(points), step):
        chosen = near[start : start + step]
        block = view.columns(np.concatenate([points[start : start + step], chosen[:, 1:].reshape(-1)]))
        block = block.reshape(2 * view.frames, -1) - mean
        block -= basis @ (basis.T @ block)
        number = len(chosen)
        own, around = block[:, :number], block[:, number:].reshape(2 * view.frames, number, k - 1)
        middle = np.median(around, axis=2)
        apart = _distances(own - middle)
        others = np.median(
            _distances((around - middle[:, :, None]).reshape(2 * view.frames, -1)).reshape(view.frames, number, k - 1),
            axis=2,
        )
        typical = np.minimum(np.median(apart, axis=0), _OWN * np.median(others, axis=0))
        scale = np.maximum(np.maximum(typical, reach), 2.0 * others)
        out[start : start + step] = (apart / scale).max(axis=0)
    return out


def _explained(view: View, points: np.ndarray, others: np.ndarray) -> bool:
    """Whether the directions of other tracks (2F, n) that stand above the noise explain these points."""
    rows, count = others.shape
    mean, vectors, squares = _directions(others)
    noise = noise_from_spectrum(squares, rows, count)
    edge = max(1.1 * noise * (np.sqrt(rows) + np.sqrt(count)), 1e-6 * float(np.sqrt(squares[0])))
    rank = min(int(np.count_nonzero(squares > edge**2)), view.frames, count // 3)
    basis = vectors[:, :rank]
    block = view.columns(points).reshape(rows, -1) - mean
    block -= basis @ (basis.T @ block)
    return float(_distances(block).max()) <= max(_EXPLAINED, 8.0 * noise)
