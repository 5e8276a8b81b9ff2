"""Shapes of points that were not always seen, from the shapes of those that were, and the entries that do not fit.

The shapes that a method found for *trusted* points (what was filled in for them is as good as measured) give a basis of
coefficients over frames, S_f = Σ_k c_fk b_k, and the distribution of the b of a point. Any other point then is a small
regression of its own on the entries where it was seen,

    minimise over b   Σ_f seen ‖w_f − s_f R_f Σ_k c_fk b_k − t_f‖²/σ² + (b − b̄)ᵀ Σ_b⁻¹ (b − b̄)

with Σ_b from the trusted points. Entries that even so are far off are taken out (a second look at what the tracks alone
did not show to be wrong), and the point is solved again. A completed track is never used: what was not seen has no say.

Cost: linear in P, by chunks. Ours; the regression is resection with a prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nrsfm.reconstruction import Reconstruction
from nrsfm.repair.options import Repaired

LEAST_TRUSTED = 0.25
"""Share of the points that is trusted at least."""

GOOD = 1e-6
"""Deviation of filled entries, in units of the tracks' rms, that is as good as measured on noiseless tracks."""

NOISY = 3e-3
"""Standard deviation, in units of the rms, from which on tracks count as noisy."""

FAR_OFF, LEAST_FAR_OFF = 6.0, 0.02
"""An entry is wrong whose residual exceeds so many robust standard deviations, and that much in units of the rms."""

_CHUNK = 256
_RAYLEIGH = 1.177  # median length of a two-dimensional Gaussian vector, in standard deviations of a coordinate
_EXACT = 1e-5  # least noise of the regression, in units of the rms
_WEAK = 1e-6  # basis shapes of less than this share of the largest are left out


@dataclass(frozen=True)
class Resection:
    """``shapes`` (F, P, 3) of all points, ``deviation`` (F, P) of their depths, ``wrong`` (F, P): seen but far off."""

    shapes: np.ndarray
    deviation: np.ndarray
    wrong: np.ndarray


def trusted_points(repaired: Repaired, frames: int) -> np.ndarray:
    """(P,) bool: points whose filled entries are as good as measured; at least a quarter of all kept, and 3F points."""
    doubt = np.where(repaired.kept, 0.0 if repaired.doubt is None else repaired.doubt, np.inf)
    count = int(repaired.kept.sum())
    least = min(count, max(round(LEAST_TRUSTED * count), 3 * frames))
    level = max(float(np.partition(doubt, least - 1)[least - 1]), repaired.doubt_level)
    return repaired.kept & (doubt <= level)


def resect(
    result: Reconstruction,
    points: np.ndarray,
    seen: np.ndarray,
    noise: float,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Resection:
    """Shapes of points (F, P, 2) where ``seen`` (F, P), in the distribution of the shapes of ``result``.

    ``noise``: standard deviation of a coordinate, in the tracks' unit. ``progress`` is told the part that is done.
    """
    frames, count = seen.shape
    basis, mean, spread = _distribution(result, noise)
    unit = float(np.sqrt(np.mean([np.mean((x - x.mean(axis=0)) ** 2) for x in result.project()])))
    noise = max(noise, _EXACT * unit)
    terms = basis.shape[1]
    image = result.scales[:, None, None] * result.rotations[:, :2]
    whole = np.einsum("fk,fia->fika", basis, image).reshape(frames, 2, 3 * terms)
    design, offset = whole @ spread / noise, whole @ mean
    grams = (np.swapaxes(design, 1, 2) @ design).reshape(frames, -1)
    depths = (np.einsum("fk,fa->fka", basis, result.rotations[:, 2]).reshape(frames, -1)) @ spread
    shapes = np.empty((frames, count, 3), dtype=result.shapes.dtype)
    deviation = np.empty((frames, count), dtype=np.float32)
    wrong = np.zeros_like(seen)
    floor = 0.0 if result.depth_deviation is None else np.median(result.depth_deviation, axis=1)[:, None]
    for start in range(0, count, _CHUNK):
        part = slice(start, min(start + _CHUNK, count))
        use = seen[:, part].copy()
        track = np.where(use[:, :, None], points[:, part], 0.0).transpose(1, 0, 2)  # (n, F, 2)
        target = (track - result.translations - offset) / noise
        weights = use.T.astype(np.float64)
        latent, inverse, residual = _solved(target, weights, design, grams)
        typical = max(1.0, float(np.median(residual[use])) / _RAYLEIGH if use.any() else 1.0)
        limit = max(FAR_OFF * typical, LEAST_FAR_OFF * unit / noise)
        marred = np.flatnonzero((use & (residual > limit)).any(axis=0))
        if len(marred):  # one wrong entry bends the fit to all: its scale shrinks from the largest residual down
            own, base = target[marred], weights[marred]
            scale = float(residual[:, marred].max())
            robust = residual[:, marred]
            while scale > 0.5 * limit:
                robust = _solved(own, base / (1.0 + (robust.T / scale) ** 2), design, grams)[2]
                scale *= 0.4
            far = use[:, marred] & (robust > limit)
            wrong[:, start + marred] = far
            found = _solved(own, base * ~far.T, design, grams)
            latent[marred], inverse[marred] = found[:2]
        flat = mean + latent @ spread.T
        shapes[:, part] = np.einsum("fk,nka->fna", basis, flat.reshape(-1, terms, 3))
        tilted = np.einsum("fk,nkl,fl->fn", depths, inverse, depths, optimize=True)
        deviation[:, part] = np.sqrt(np.maximum(tilted, 0.0) + floor**2)
        progress(part.stop / count)
    return Resection(shapes, deviation, wrong)


def _solved(
    target: np.ndarray, weights: np.ndarray, design: np.ndarray, grams: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (n, 3K), their covariance, and residuals (F, n) of n points with weights (n, F)."""
    size = design.shape[2]
    right = np.einsum("nfi,nf,fik->nk", target, weights, design, optimize=True)
    inverse = np.linalg.inv((weights @ grams).reshape(-1, size, size) + np.eye(size))
    latent = (inverse @ right[:, :, None])[:, :, 0]
    residual = np.linalg.norm(target - np.einsum("fik,nk->nfi", design, latent, optimize=True), axis=2).T
    return latent, inverse, residual


def _distribution(result: Reconstruction, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Basis (F, K), and the mean (3K,) and a square root of the covariance (3K, 3K) of the points' coefficients."""
    frames, count = result.shapes.shape[:2]
    flat = result.shapes.transpose(0, 2, 1).reshape(frames, -1).astype(np.float64)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    values = np.sqrt(np.maximum(values[::-1], 0.0))
    kept = values > max(_WEAK * values[0], 0.3 * noise * np.sqrt(count))
    kept[:1] = True
    basis = vectors[:, ::-1][:, kept] * np.sqrt(frames)
    coefficients = (basis.T @ flat / frames).reshape(-1, 3, count).reshape(-1, count)
    mean = coefficients.mean(axis=1)
    centred = coefficients - mean[:, None]
    covariance = centred @ centred.T / count
    squares, directions = np.linalg.eigh(covariance)
    return basis, mean, directions * np.sqrt(np.maximum(squares, 1e-12 * squares[-1]))
