"""A sequence of shapes as a base and a few targets with weights: what animation programs call blendshapes.

    x_f ≈ b + Σ_k w_fk T_k,     0 ≤ w_fk ≤ 1

Rows x_f (3P) are the points of frame f. With x̄ their mean and U Σ Vᵀ the singular value decomposition of x_f − x̄, the
first K triplets are the best approximation of rank K (Eckart and Young, Psychometrika 1, 1936), of mean square error
Σ_{k>K} σ_k² / FP per point. U and σ² come from the F×F Gram matrix over the points, which is summed in float64 from
chunks of points: no float64 copy of the sequence, O(F² P).

Weights are shifted and scaled onto 0…1, each target as far: b = x̄ + Σ_k min_f(c_fk) V_k and
T_k = (max_f c_fk − min_f c_fk) V_k with c = U Σ. The sum is the same; but some programs clamp weights to 0…1
(Blender, which looks at the first keyframe only to widen that range).

K is given, or the smallest with an error below a tolerance. The largest error of a point is not monotonous in K, so
that the K found for it (by bisection) is one that fits where K − 1 does not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

Frames = Callable[[slice], np.ndarray]
"""Gives the numbers (F, n) of a slice of the 3P coordinates, float64."""

_CHUNK = 1 << 21  # float64 numbers held at a time
_NEGLIGIBLE = 1e-13  # squared singular values, relative to the largest: rounding of the Gram matrix


@dataclasses.dataclass(frozen=True, eq=False)
class Blend:
    """Blendshapes of a sequence.

    Attributes
    ----------
    base
        (3P,) float32 b.
    targets
        (K, 3P) float32 T.
    weights
        (F, K) float32 w, from 0 to 1.
    rms, largest
        Root mean square and largest distance of a point from where it was, over all frames; float32 included.
    """

    base: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    rms: float
    largest: float


def blendshapes(
    coordinates: Frames, frames: int, size: int, *, tolerance: float, criterion: str = "rms", targets: int | None = None
) -> Blend:
    """Return the blendshapes of ``size`` = 3P coordinates over ``frames`` frames.

    ``tolerance`` is in the unit of the coordinates; ``criterion`` says of what: ``"rms"`` or ``"max"``. ``targets``
    asks for a number of them, of which no more are made than the sequence has.
    """
    step = max(3, _CHUNK // max(frames, 1) // 3 * 3)
    parts = [slice(start, min(start + step, size)) for start in range(0, size, step)]
    gram = np.zeros((frames, frames))
    for part in parts:
        block = coordinates(part)
        block -= block.mean(axis=0)
        gram += block @ block.T
    squares, vectors = np.linalg.eigh(gram)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    rank = int(np.count_nonzero(squares > _NEGLIGIBLE * max(squares[0], np.finfo(float).tiny))) if frames > 1 else 0
    rank = min(rank, frames - 1) if squares[0] > 0 else 0
    if targets is not None:
        count = min(targets, rank)
    else:
        left = np.append(np.cumsum(squares[::-1])[::-1], 0.0)  # left[k]: what k targets leave
        count = int(np.argmax(left <= tolerance**2 * frames * size / 3))
        count = min(count, rank)
        if criterion == "max":
            count = _bisect(coordinates, parts, vectors, count, rank, tolerance)
    return _build(coordinates, parts, vectors[:, :count], size)


def _bisect(coordinates: Frames, parts: list[slice], vectors: np.ndarray, low: int, high: int, tolerance: float) -> int:
    """A number of targets from low (whose root mean square fits) to high whose largest error fits."""
    while low < high:
        middle = (low + high) // 2
        if _largest(coordinates, parts, vectors[:, :middle]) <= tolerance:
            high = middle
        else:
            low = middle + 1
    return low


def _largest(coordinates: Frames, parts: list[slice], vectors: np.ndarray) -> float:
    largest = 0.0
    for part in parts:
        block = coordinates(part)
        block -= block.mean(axis=0)
        block -= vectors @ (vectors.T @ block)
        largest = max(largest, float(_squares(block).max()))
    return float(np.sqrt(largest))


def _build(coordinates: Frames, parts: list[slice], vectors: np.ndarray, size: int) -> Blend:
    frames, count = vectors.shape
    # The larger excursion of every target is made the positive one: the base stays nearer to the mean.
    flip = np.where(-vectors.min(axis=0, initial=0.0) > vectors.max(axis=0, initial=0.0), -1.0, 1.0)
    vectors = vectors * flip
    low, reach = vectors.min(axis=0, initial=np.inf), np.ptp(vectors, axis=0) if frames else np.zeros(count)
    weights = ((vectors - low) / np.where(reach > 0, reach, 1.0)).astype(np.float32)
    base, targets = np.empty(size, dtype=np.float32), np.empty((count, size), dtype=np.float32)
    total = largest = 0.0
    for part in parts:
        block = coordinates(part)
        mean = block.mean(axis=0)
        modes = vectors.T @ (block - mean)
        base[part] = mean + low @ modes
        targets[:, part] = reach[:, None] * modes
        # As a reader of the file will compute it, from what is stored.
        block -= base[part] + weights.astype(np.float64) @ targets[:, part].astype(np.float64)
        squares = _squares(block)
        total += float(squares.sum())
        largest = max(largest, float(squares.max(initial=0.0)))
    return Blend(base, targets, weights, float(np.sqrt(total / max(frames * size / 3, 1))), float(np.sqrt(largest)))


def _squares(block: np.ndarray) -> np.ndarray:
    """(F, n / 3) squared distances."""
    return np.asarray(np.sum(block.reshape(len(block), -1, 3) ** 2, axis=2))
