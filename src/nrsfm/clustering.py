"""Grouping: k-means++ cells of points (or frames), and spectral grouping of subspaces.

Distances between columns of S = pinv(R)·W are distances between columns of W, since R Rᵀ = I; so the cells need no
cameras and can be found in the leading coordinates of the tracks.
"""

from __future__ import annotations

import numpy as np

_SAMPLE = 20_000  # centres are learnt on at most so many points; all points are then assigned
_ROUNDING = 1e-8  # eigenvalues (of at most 1) and gaps between them that are rounding


def _nearest(data: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Label of the nearest centre and squared distance to it, by chunks that stay in cache."""
    labels = np.empty(len(data), dtype=np.int64)
    gaps = np.empty(len(data))
    sizes = np.einsum("ij,ij->i", centres, centres)
    for start in range(0, len(data), 4096):
        part = data[start : start + 4096]
        scores = sizes - 2.0 * (part @ centres.T)
        best = np.argmin(scores, axis=1)
        labels[start : start + 4096] = best
        least = scores[np.arange(len(part)), best] + np.einsum("ij,ij->i", part, part)
        gaps[start : start + 4096] = np.maximum(least, 0.0)
    return labels, gaps


def _plus_plus(data: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """k-means++ seeding: each next centre drawn with probability proportional to the squared distance."""
    chosen = [int(rng.integers(len(data)))]
    gaps = np.sum((data - data[chosen[0]]) ** 2, axis=1)
    for _ in range(count - 1):
        total = float(gaps.sum())
        # Fewer distinct points than centres: the remaining seeds repeat and their cells stay empty.
        pick = int(rng.choice(len(data), p=gaps / total)) if total > 0 else int(rng.integers(len(data)))
        chosen.append(pick)
        np.minimum(gaps, np.sum((data - data[pick]) ** 2, axis=1), out=gaps)
    return data[chosen].copy()


def kmeans(data: np.ndarray, count: int, rng: np.random.Generator, rounds: int = 30) -> np.ndarray:
    """k-means++ cells.

    Parameters
    ----------
    data
        (n, q) points, any unit.
    count
        Number of cells asked for; duplicates in the data can leave fewer.
    rng
        Source of randomness.
    rounds
        Upper bound on Lloyd's rounds.

    Returns
    -------
    (n,) labels 0..m−1 with m ≤ count, every label in use.

    Source: Arthur and Vassilvitskii 2007.
    """
    data = np.asarray(data)
    if min(count, len(data)) <= 1:
        return np.zeros(len(data), dtype=np.int64)
    labels = _nearest(data, kmeans_centres(data, count, rng, rounds))[0]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def kmeans_centres(data: np.ndarray, count: int, rng: np.random.Generator, rounds: int = 30) -> np.ndarray:
    """Centres (m, q) of :func:`kmeans`, m = min(count, n), learnt on at most 20,000 of the points."""
    count = max(1, min(count, len(data)))
    if count == 1:
        return np.asarray(data.mean(axis=0, keepdims=True))
    sample = data if len(data) <= _SAMPLE else data[np.sort(rng.choice(len(data), _SAMPLE, replace=False))]
    centres = _plus_plus(sample, count, rng)
    before = np.inf
    for _ in range(rounds):
        labels, gaps = _nearest(sample, centres)
        sizes = np.bincount(labels, minlength=count)
        sums = np.stack([np.bincount(labels, weights=column, minlength=count) for column in sample.T], axis=1)
        centres = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], centres)
        total = float(gaps.sum())
        if total >= (1 - 1e-4) * before:  # false while `before` is infinite
            break
        before = total
    return centres


def spectral_groups(
    affinity: np.ndarray,
    rng: np.random.Generator,
    count: int | None = None,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Group n items by the leading eigenvectors of their normalised affinity.

    Parameters
    ----------
    affinity
        (n, n) symmetric, non-negative.
    count
        Number of groups; ``None`` takes the largest gap between consecutive eigenvalues of the normalised
        affinity, among the counts in ``span``; one group where there is no gap.
    span
        Least and largest count tried with ``count=None``; (2, n − 1) unless given.

    Returns
    -------
    (n,) labels 0..m−1 in order of first appearance, so that equal groupings get equal labels. An affinity of lower
    rank than the count gives fewer groups: what lies beyond its rank is rounding, not structure.

    Source: Ng, Jordan and Weiss 2002; the eigengap rule as in von Luxburg 2007.
    """
    items = len(affinity)
    if items == 1 or count == 1:
        return np.zeros(items, dtype=np.int64)
    degree = affinity.sum(axis=1)
    scale = 1.0 / np.sqrt(np.maximum(degree, np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(affinity * scale[:, None] * scale[None, :])
    values, vectors = values[::-1], vectors[:, ::-1]
    if count is None:
        low, high = span if span is not None else (2, items - 1)
        low, high = min(low, items - 1), min(high, items - 1)
        gaps = values[low - 1 : high] - values[low : high + 1]
        count = low + int(np.argmax(gaps)) if gaps.max() > _ROUNDING else 1
    count = min(count, int(np.count_nonzero(values > _ROUNDING)))
    if count < 2:
        return np.zeros(items, dtype=np.int64)
    rows = vectors[:, :count]
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    labels = kmeans(rows / np.maximum(norms, 1e-12), count, rng)
    order = {old: new for new, old in enumerate(dict.fromkeys(labels.tolist()))}
    return np.array([order[label] for label in labels.tolist()], dtype=np.int64)
