"""The Procrustean normal distribution seen through cameras: its posterior and its covariance update.

Aligned shapes are y = M + v, v ~ N(0, C) on the tangent space at M (see :mod:`nrsfm.manifolds.procrustes`); frame i
shows w = c R (M + v + G a) + n with R the upper rows of Aᵀ, n ~ N(0, σ² I) and a flat prior on a: G holds the four
Procrustes directions, so that G a is a small rigid motion or change of size which the alignment did not catch.

Everything here uses C = B Bᵀ + κ I (on the tangent space), B (3N, q). Given the shapes' second moment S, the best
such C takes the q leading eigenpairs of S, and for κ the mean of the other eigenvalues (Tipping and Bishop, JRSS B 61,
1999): so the update is an exact M-step, and with q = 3N − 4 the covariance is unrestricted. With e ~ N(0, κ I)
integrated out, frame i has the noise σ² + c²κ, and only z ~ N(0, I_q) and a remain: one (q + 4)-matrix per frame,
whose data part is a sum of nine fixed matrices, Dᵀ(Π ⊗ I)D with Π = RᵀR and D = [B G].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.manifolds.procrustes import onto_tangent_space, procrustes_directions

_FLAT = 1e-10  # precision of the prior on a, of a mean of size 1: flat, yet never singular
_PARTIAL = 400  # above this size only the wanted eigenpairs are computed


@dataclass(frozen=True)
class ProcrusteanNormal:
    """M (3, N) of norm 1, B (3N, q) orthogonal to the Procrustes directions, κ, and the noise variance σ²."""

    mean: np.ndarray
    basis: np.ndarray
    spread: float
    noise: float


@dataclass(frozen=True)
class Posterior:
    """What the tracks say of the aligned shapes.

    ``deviations`` (F, 3, N): mean of y − M, including its part along the Procrustes directions. ``second_moment``
    (3N, 3N): mean over frames of E[v vᵀ] on the tangent space. ``noise``: E-step's estimate of σ².
    ``likelihood``: log p(tracks) up to a constant.
    """

    deviations: np.ndarray
    second_moment: np.ndarray
    noise: float
    likelihood: float


def leading_covariance(second_moment: np.ndarray, factors: int, negligible: float = 0.0) -> tuple[np.ndarray, float]:
    """B (3N, q) and κ of the C = BBᵀ + κI that is closest in likelihood to the second moment; q ≤ ``factors``.

    Directions of variance below ``negligible`` get no column of their own: fewer columns, faster, the same to κ.
    """
    from scipy.linalg import eigh

    size = len(second_moment)
    free = size - 4
    count = max(1, min(factors, free))
    wanted = (size - count, size - 1) if size > _PARTIAL else None
    try:
        values, vectors = eigh(second_moment, subset_by_index=wanted, check_finite=False)
    except np.linalg.LinAlgError:  # the solver for a few pairs can fail where eigenvalues span many orders
        values, vectors = np.linalg.eigh(second_moment)
        values, vectors = values[size - count :], vectors[:, size - count :]
    values, vectors = np.maximum(values[::-1][:count], 0.0), vectors[:, ::-1][:, :count]
    if negligible > 0:
        count = max(1, int(np.count_nonzero(values > negligible)))
        values, vectors = values[:count], vectors[:, :count]
    rest = float(np.trace(second_moment)) - float(values.sum())
    spread = max(rest, 0.0) / (free - count) if free > count else 0.0
    spread = min(spread, float(values[-1]))
    return vectors * np.sqrt(values - spread), spread


def posterior(model: ProcrusteanNormal, tracks: np.ndarray, rotations: np.ndarray, sizes: np.ndarray) -> Posterior:
    """E-step: tracks (F, 2, N), camera rows R (F, 2, 3) of the aligned frame, sizes c (F,)."""
    frames, _, count = tracks.shape
    factors = model.basis.shape[1]
    design = np.concatenate([model.basis, procrustes_directions(model.mean)], axis=1)
    blocks = design.reshape(3, count, -1)
    width = design.shape[1]
    planes = np.einsum("fia,fib->fab", rotations, rotations)
    variances = model.noise + sizes**2 * model.spread

    products = np.einsum("anp,bnq->abpq", blocks, blocks, optimize=True).reshape(9, width * width)
    gram = (((sizes**2 / variances)[:, None] * planes.reshape(frames, 9)) @ products).reshape(frames, width, width)
    seen = sizes[:, None, None] * rotations
    residual = tracks - seen @ model.mean
    back = (np.swapaxes(seen, 1, 2) @ residual).reshape(frames, 3 * count)
    right = (back / variances[:, None]) @ design
    precision = gram.copy()
    diagonal = np.arange(width)
    precision[:, diagonal, diagonal] += np.where(diagonal < factors, 1.0, _FLAT)
    covariance = np.linalg.inv(precision)
    latent = (covariance @ right[:, :, None])[:, :, 0]

    squares = np.sum(residual**2, axis=(1, 2)) / variances - np.sum(right * latent, axis=1)
    pivots = np.diagonal(np.linalg.cholesky(precision), axis1=1, axis2=2)
    determinants = 2.0 * np.log(pivots).sum(axis=1) + 2 * count * np.log(variances)
    likelihood = -0.5 * float(np.sum(squares + determinants))

    deviations = (latent @ design.T).reshape(frames, 3, count)
    residual -= seen @ deviations
    share = model.noise / variances
    explained = share**2 * variances * np.sum(gram * covariance, axis=(1, 2))
    hidden = 2 * count * share * (variances - model.noise)
    noise = float(np.sum(share**2 * np.sum(residual**2, axis=(1, 2)) + explained + hidden)) / (2 * count * frames)
    gain = model.spread * sizes / variances
    deviations += gain[:, None, None] * (np.swapaxes(rotations, 1, 2) @ residual)

    remaining = np.eye(3) - (gain * sizes)[:, None, None] * planes
    moment = _mean_covariance(blocks, covariance, remaining)
    if model.spread > 0:
        moment += np.kron(model.spread * remaining.mean(axis=0), np.eye(count))
    flat = deviations.reshape(frames, -1)
    moment += flat.T @ flat / frames
    return Posterior(deviations, _onto_tangent(model.mean, moment), noise, likelihood)


def _mean_covariance(blocks: np.ndarray, covariance: np.ndarray, remaining: np.ndarray) -> np.ndarray:
    """Mean over frames of (J ⊗ I) D V Dᵀ (J ⊗ I), (3N, 3N): the shapes' covariance through z and a.

    J = I − (κc²/(σ² + c²κ)) Π tells how much of it e, which answers to the same residuals, leaves.
    """
    frames, width = covariance.shape[:2]
    count = blocks.shape[1]
    flat = covariance.reshape(frames, -1)
    out = np.empty((3, count, 3, count))
    for a in range(3):
        for c in range(a, 3):
            weights = (remaining[:, a, :, None] * remaining[:, c, None, :]).reshape(frames, 9)
            mixed = (weights.T @ flat / frames).reshape(3, 3, width, width)
            out[a, :, c] = sum(blocks[b] @ sum(mixed[b, d] @ blocks[d].T for d in range(3)) for b in range(3))
            out[c, :, a] = out[a, :, c].T
    return out.reshape(3 * count, 3 * count)


def _onto_tangent(mean: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Symmetric matrix (3N, 3N) restricted to the tangent space from both sides."""
    half = onto_tangent_space(mean, matrix)
    full = onto_tangent_space(mean, half.T)
    return np.asarray((full + full.T) / 2.0)
