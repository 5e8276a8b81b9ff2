"""The leading eigenpairs of a large Gram matrix, for the few directions that a long sequence lives in.

A full decomposition of a matrix of n rows costs O(n³) and gives n pairs, of which a long sequence needs some tens.
Block subspace iteration from a random start, with the Rayleigh-Ritz step, needs n² operations per pair and round:

    Y ← orth(G Y),   Yᵀ G Y = V Λ Vᵀ,   Y ← Y V.

What is left out is measured: tr G − Σ λ_i is exactly the squared norm of the part of the data outside the span that was
found, and ‖G v_i − λ_i v_i‖ says how far from settled a pair is.

Source: Halko, Martinsson and Tropp, "Finding structure with randomness", SIAM Review 53(2), 2011, algorithms 4.4, 5.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FULL = 1_600
"""Rows up to which all pairs are computed: faster there, and the results of common sizes stay as they are."""

_SPARE = 32  # columns more than wanted: the last ones settle slowly
_SETTLED = 1e-10  # relative change of an eigenvalue in a round
_STANDS_OUT = 2.0  # times the least value of the iteration: such pairs must settle
_ROUNDING = 1e-14  # of the largest eigenvalue: smaller changes are none
_LEAST_ROUNDS, _ROUNDS = 4, 40
_SEED = 20110512  # of the start; any would do


@dataclass(frozen=True)
class Leading:
    """Eigenvalues (k,), descending, and orthonormal eigenvectors (n, k).

    ``left_out``: trace of the matrix less the eigenvalues, the squared norm of what is not in the span. ``residual``:
    the largest ‖G v − λ v‖ of a wanted pair, relative to the largest eigenvalue; 0 for a full decomposition.
    """

    values: np.ndarray
    vectors: np.ndarray
    left_out: float
    residual: float
    rounds: int


def leading_eigenpairs(
    gram: np.ndarray, count: int, *, energy: float = np.inf, least: float = 0.0, full: int | None = None
) -> Leading:
    """The ``count`` leading eigenpairs of a positive semidefinite matrix (n, n), or more of them.

    Parameters
    ----------
    gram
        G (n, n), symmetric.
    count
        How many pairs are wanted at least.
    energy, least
        The number is doubled until what is left out is at most ``energy``, or the last eigenvalue at most ``least``.
    full
        Up to so many rows (``FULL``), and where half of all pairs or more are wanted, all pairs are computed.
    """
    full = FULL if full is None else full
    size = len(gram)
    trace = float(np.trace(gram))
    start = np.zeros((size, 0))
    while True:
        if size <= full or 2 * (count + _SPARE) >= size:
            return _all(gram, trace)
        found = _subspace_iteration(gram, count, start, trace)
        if found.left_out <= energy or found.values[-1] <= least:
            return found
        start, count = found.vectors, 2 * count


def _all(gram: np.ndarray, trace: float) -> Leading:
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values[::-1], 0.0)
    return Leading(values, vectors[:, ::-1], max(trace - float(values.sum()), 0.0), 0.0, 0)


def _subspace_iteration(gram: np.ndarray, count: int, start: np.ndarray, trace: float) -> Leading:
    """``start`` (n, m): directions that are known already; the others begin at random."""
    size = len(gram)
    rng = np.random.default_rng(_SEED)
    fresh = rng.standard_normal((size, count + _SPARE - start.shape[1]))
    basis = np.linalg.qr(np.concatenate([start, gram @ fresh], axis=1))[0]
    last = np.zeros(count)
    for used in range(1, _ROUNDS + 1):
        image = gram @ basis
        values, turn = np.linalg.eigh(basis.T @ image)
        values, turn = values[::-1], turn[:, ::-1]
        # Pairs about as large as what is left out hardly settle, and need not: they are noise or next to nothing.
        moving = np.abs(values[:count] - last) > _SETTLED * values[:count] + _ROUNDING * float(values[0])
        last = values[:count]
        if used >= _LEAST_ROUNDS and not moving[last > _STANDS_OUT * max(float(values[-1]), 0.0)].any():
            break
        if used < _ROUNDS:
            basis = np.linalg.qr(image @ turn)[0]
    vectors = basis @ turn[:, :count]
    gap = image @ turn[:, :count] - vectors * last
    residual = float(np.linalg.norm(gap, axis=0).max()) / max(float(last[0]), np.finfo(float).tiny)
    kept = np.maximum(last, 0.0)
    return Leading(kept, vectors, max(trace - float(kept.sum()), 0.0), residual, used)
