"""How noisy the tracks are, and the singular-value shrinkage that is optimal at that noise.

Everything here knows the noise only as one standard deviation per coordinate, Gaussian and independent.
"""

from __future__ import annotations

import numpy as np


def shrink_singular_values(values: np.ndarray, shape: tuple[int, int], noise: float) -> np.ndarray:
    """Optimal shrinkage of singular values under white noise, in Frobenius norm.

    Parameters
    ----------
    values
        Singular values of the noisy matrix.
    shape
        Its (rows, columns).
    noise
        Standard deviation of each entry, same unit; 0 leaves the values as they are.

    Returns
    -------
    Values of the same shape: below the noise edge σ(√m + √n) they are 0; above it
    √((y² − β − 1)² − 4β)/y with y = s/(σ√n), β = m/n, m ≤ n.

    Source: Gavish and Donoho, "Optimal shrinkage of singular values", IEEE Trans. Inf. Theory 63(4), 2017, eq. 7.
    """
    values = np.asarray(values, dtype=np.float64)
    if noise <= 0:
        return values.copy()
    small, large = min(shape), max(shape)
    ratio, unit = small / large, noise * np.sqrt(large)
    scaled = values / unit
    above = scaled > 1.0 + np.sqrt(ratio)
    scaled = np.where(above, scaled, 1.0)
    inside = np.maximum((scaled**2 - ratio - 1.0) ** 2 - 4.0 * ratio, 0.0)
    return np.where(above, np.sqrt(inside) / scaled * unit, 0.0)


def risk_of_shrinking(values: np.ndarray, shape: tuple[int, int], noise: float) -> float:
    """Estimated squared Frobenius error that :func:`shrink_singular_values` leaves, of what stands above the noise.

    A true singular value x is seen as y with y² = (x² + 1)(x² + β)/x² (unit σ√n), and shrunk to η; the two singular
    vectors are turned so that the error is x² − η². What lies below the noise edge is not counted. Same source.
    """
    values = np.asarray(values, dtype=np.float64)
    if noise <= 0:
        return 0.0
    small, large = min(shape), max(shape)
    ratio, unit = small / large, noise * np.sqrt(large)
    scaled = values[values > unit * (1.0 + np.sqrt(ratio))] / unit
    middle = scaled**2 - ratio - 1.0
    true = (middle + np.sqrt(np.maximum(middle**2 - 4.0 * ratio, 0.0))) / 2.0
    kept = (shrink_singular_values(scaled * unit, shape, noise) / unit) ** 2
    return float(np.sum(true - kept)) * unit**2


_TAIL = 4  # the noise is read off the lowest quarter of the spectrum
_LEAST_SPECTRUM = 8  # with fewer singular values than this the signal may fill them all


def _tail_mean(ratio: float) -> float:
    """Mean of the lowest quarter of the Marchenko-Pastur law (unit variance, aspect ``ratio`` ≤ 1)."""
    low, high = (1 - np.sqrt(ratio)) ** 2, (1 + np.sqrt(ratio)) ** 2
    # Substituting x = mid + half·cos(t) removes the square-root ends, so that few nodes suffice.
    angle = (np.arange(2000) + 0.5) * np.pi / 2000
    x = (low + high) / 2 - (high - low) / 2 * np.cos(angle)
    weight = np.sin(angle) ** 2 / np.maximum(x, 1e-300)
    cumulative = np.cumsum(weight)
    lower = cumulative <= cumulative[-1] / _TAIL
    return float(np.sum((weight * x)[lower]) / np.sum(weight[lower]))


def noise_from_spectrum(eigenvalues: np.ndarray, rows: int, columns: int) -> float:
    """Noise level from the lowest quarter of the eigenvalues of W Wᵀ (descending), W rows×columns, row-centred.

    Under white noise and a signal of less than three quarters of the full rank, that quarter follows the
    Marchenko-Pastur law. A signal of higher rank makes this an over-estimate: it is an upper bound. With fewer than
    eight eigenvalues nothing can be told, and the answer is 0: noise is not invented.
    """
    small, large = min(rows, columns - 1), max(rows, columns - 1)
    if small < _LEAST_SPECTRUM:
        return 0.0
    values = np.maximum(np.asarray(eigenvalues, dtype=np.float64)[:small], 0.0)
    tail = values[small - small // _TAIL :]
    return float(np.sqrt(np.mean(tail) / (large * _tail_mean(small / large))))


def noise_from_neighbours(positions: np.ndarray, neighbour_tracks: np.ndarray) -> float:
    """Noise level from how far neighbouring tracks are from varying affinely over the surface.

    Parameters
    ----------
    positions
        (n, m, 3): for each of n sampled points, the positions of m neighbours in the three leading track
        coordinates.
    neighbour_tracks
        (n, m, 2F): the neighbours' tracks.

    Returns
    -------
    Standard deviation per coordinate, the median over samples. Curvature of the surface makes it an over-estimate
    on coarse point sets: like :func:`noise_from_spectrum` it is an upper bound.
    """
    count, neighbours, rows = neighbour_tracks.shape
    design = np.concatenate([np.ones((count, neighbours, 1)), positions - positions.mean(1, keepdims=True)], axis=2)
    basis, _ = np.linalg.qr(design)
    residual = neighbour_tracks - basis @ (basis.transpose(0, 2, 1) @ neighbour_tracks)
    # The three leading coordinates fit themselves exactly: 3 of the 2F dimensions carry no residual.
    freedom = (neighbours - design.shape[2]) * max(rows - 3, 1)
    variance = np.sum(residual**2, axis=(1, 2)) / freedom
    return float(np.sqrt(np.median(variance)))
