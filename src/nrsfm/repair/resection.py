"""Shapes of points that were not always seen, from the shapes of those that were, and the entries that do not fit.

The shapes that a method found for *trusted* points (what was filled in for them is as good as measured) give a basis of
coefficients over frames, S_f = Σ_k c_fk b_k, and the distribution of the b of a point. Any other point then is a small
regression of its own on the entries where it was seen,

    minimise over b   Σ_f seen ‖w_f − s_f R_f Σ_k c_fk b_k − t_f‖²/σ² + (b − b̄)ᵀ Σ_b⁻¹ (b − b̄)

with b̄ and Σ_b from the trusted points. Entries that even so are far off are taken out (a second look at what the
tracks alone did not show to be wrong), and the point is solved again. A completed track is never used: what was not
seen has no say.

Under noise the prior is worth as much as the track. :func:`resect_by_cells` then gives each cell of points that move
alike a b̄ and Σ_b of its own, from the shapes that all points have by now: empirical Bayes, one or two rounds of it.

Cost: linear in P, by chunks. Ours; the regression is resection with a prior.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from nrsfm.clustering import kmeans
from nrsfm.numerics.leading import leading_eigenpairs
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

_CHUNK, _BLOCK = 256, 4096  # points at a time: with systems of their own, and in sums over all
_RAYLEIGH = 1.177  # median length of a two-dimensional Gaussian vector, in standard deviations of a coordinate
_EXACT = 1e-5  # least noise of the regression, in units of the rms
_MOST_DIRECTIONS = 96  # of the points' distribution: a point costs their cube, and dense noisy shapes have hundreds
_WEAK = 1e-6  # basis shapes of less than this share of the largest are left out
_CELL, _MOST_CELLS = 80, 50  # points of a cell at least, and the number of cells at most
_COORDINATES = 10  # principal directions of the coefficients in which cells are found
_ROUNDS = 2
_SHARED_MEAN, _SHARED_SPREAD = 3.0, 8.0  # points that the mean and the spread of all count for in a cell
_LOCAL = 0.05  # squared spread of a cell that is expected, as a share of that of all points
_UNSEEN = 0.03  # of the noise: directions of less spread are none


@dataclass(frozen=True)
class Resection:
    """``shapes`` (F, P, 3) of all points, ``deviation`` (F, P) of their depths, ``wrong`` (F, P): seen but far off.

    ``noise``: standard deviation of a coordinate of what was seen, by the median, so that what is wrong has no say.
    """

    shapes: np.ndarray
    deviation: np.ndarray
    wrong: np.ndarray
    noise: float


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
    sight = _sight(result, result.shapes, noise)
    floor = 0.0 if result.depth_deviation is None else np.median(result.depth_deviation, axis=1)[:, None]
    mean, spread = _distribution(sight.coefficients(result.shapes))
    work = _Work(sight, points, seen, result.shapes.dtype)
    for part, _ in work.regressed((mean, spread), np.arange(seen.shape[1])):
        work.deviation[:, part] = np.sqrt(work.deviation[:, part] ** 2 + floor**2)
        progress((part[-1] + 1) / seen.shape[1])
    return work.found()


def resect_by_cells(
    result: Reconstruction,
    shapes: np.ndarray,
    points: np.ndarray,
    seen: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Resection:
    """Shapes of points (F, P, 2) where ``seen`` (F, P), each in the distribution of its cell.

    The cameras are those of ``result``, cells and distributions those of ``shapes`` (F, P, 3), which all P points have.
    ``deviation`` is what missing entries add to the deviation of a point of that cell that was always seen.
    """
    sight = _sight(result, shapes, noise)
    count = seen.shape[1]
    coefficients = sight.coefficients(shapes)
    order = np.argsort(labels := _cells(coefficients, rng), kind="stable")
    cells = np.split(order, np.cumsum(np.bincount(labels))[:-1])
    for turn in range(_ROUNDS):
        work = _Work(sight, points, seen, shapes.dtype)
        everyone = coefficients.mean(axis=0), np.cov(coefficients.T, ddof=0)
        for members in cells:
            prior = _of_cell(coefficients[members], everyone, sight.noise)
            complete = _variance_of_depth(sight, prior)[:, None]
            for part, latent in work.regressed(prior, members):
                work.deviation[:, part] = np.sqrt(np.maximum(work.deviation[:, part] ** 2 - complete, 0.0))
                coefficients[part] = prior[0] + latent @ prior[1].T
                progress((turn + work.done / count) / _ROUNDS)
        found = work.found()
        sight = replace(sight, noise=max(found.noise, _EXACT * sight.unit))
    return found


@dataclass(frozen=True)
class _Sight:
    """What becomes of b: ``basis`` (F, K) to shapes, ``whole`` (F, 2, 3K) to tracks, ``depths`` (F, 3K) to depths.

    ``unit``: rms of the tracks, centred in every frame.
    """

    basis: np.ndarray
    whole: np.ndarray
    depths: np.ndarray
    translations: np.ndarray
    noise: float
    unit: float

    def coefficients(self, shapes: np.ndarray) -> np.ndarray:
        """Return b (P, 3K), basis shape by basis shape, of shapes (F, P, 3)."""
        frames, count = shapes.shape[:2]
        out = np.empty((count, 3 * self.basis.shape[1]))
        for start in range(0, count, _BLOCK):
            part = shapes[:, start : start + _BLOCK].astype(np.float64).reshape(frames, -1)
            found = (self.basis.T @ part / frames).reshape(self.basis.shape[1], -1, 3)
            out[start : start + _BLOCK] = found.transpose(1, 0, 2).reshape(-1, out.shape[1])
        return out


def _sight(result: Reconstruction, shapes: np.ndarray, noise: float) -> _Sight:
    """The cameras of ``result``, the basis of ``shapes``."""
    frames, count = shapes.shape[:2]
    gram = np.zeros((frames, frames))
    for start in range(0, count, _BLOCK):
        part = shapes[:, start : start + _BLOCK].astype(np.float64).reshape(frames, -1)
        gram += part @ part.T
    # Of a long sequence no more pairs than are kept.
    least = max(_WEAK**2 * float(np.trace(gram)) / 2, (0.3 * noise) ** 2 * count)
    found = leading_eigenpairs(gram, 64, energy=0.0, least=least)
    values = np.sqrt(found.values)
    kept = values > max(_WEAK * values[0], 0.3 * noise * np.sqrt(count))
    kept[:1] = True
    basis = found.vectors[:, kept] * np.sqrt(frames)
    unit = float(np.sqrt(np.mean([np.mean((x - x.mean(axis=0)) ** 2) for x in result.project()])))
    image = result.scales[:, None, None] * result.rotations[:, :2]
    return _Sight(
        basis,
        np.einsum("fk,fia->fika", basis, image).reshape(frames, 2, -1),
        np.einsum("fk,fa->fka", basis, result.rotations[:, 2]).reshape(frames, -1),
        result.translations,
        max(noise, _EXACT * unit),
        unit,
    )


def _variance_of_depth(sight: _Sight, prior: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(F,) of a point that is always seen."""
    design, depths = sight.whole @ prior[1] / sight.noise, sight.depths @ prior[1]
    inverse = np.linalg.inv(np.sum(np.swapaxes(design, 1, 2) @ design, axis=0) + np.eye(design.shape[2]))
    return np.asarray(np.einsum("fk,kl,fl->f", depths, inverse, depths))


class _Work:
    """The points one by one, with what has been found of them."""

    def __init__(self, sight: _Sight, points: np.ndarray, seen: np.ndarray, dtype: np.dtype) -> None:
        self.sight, self.points, self.seen = sight, points, seen
        self.shapes = np.empty((*seen.shape, 3), dtype=dtype)
        self.deviation = np.empty(seen.shape, dtype=np.float32)
        self.wrong = np.zeros_like(seen)
        self.done = 0
        self._levels: list[tuple[float, int]] = []

    def found(self) -> Resection:
        """All of it."""
        squares = np.array([level**2 * size for level, size in self._levels])
        noise = float(np.sqrt(squares.sum() / max(sum(size for _, size in self._levels), 1)))
        return Resection(self.shapes, self.deviation, self.wrong, noise)

    def regressed(
        self, prior: tuple[np.ndarray, np.ndarray], members: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Chunks of the members with their latent coefficients (n, q), once all is found of them.

        The deviations are those of the prior and the entries alone.
        """
        mean, spread = prior
        sight, frames = self.sight, len(self.seen)
        noise = sight.noise
        design, offset = sight.whole @ spread / noise, sight.whole @ mean
        grams = (np.swapaxes(design, 1, 2) @ design).reshape(frames, -1)
        depths = sight.depths @ spread
        for start in range(0, len(members), _CHUNK):
            part = members[start : start + _CHUNK]
            use = self.seen[:, part]
            track = np.where(use[:, :, None], self.points[:, part], 0.0).transpose(1, 0, 2)  # (n, F, 2)
            target = (track - sight.translations - offset) / noise
            weights = use.T.astype(np.float64)
            latent, inverse, residual = _solved(target, weights, design, grams)
            level = float(np.median(residual[use])) / _RAYLEIGH if use.any() else 1.0
            limit = max(FAR_OFF * max(1.0, level), LEAST_FAR_OFF * sight.unit / noise)
            marred = np.flatnonzero((use & (residual > limit)).any(axis=0))
            if len(marred):  # one wrong entry bends the fit to all: its scale shrinks from the largest residual down
                own, base = target[marred], weights[marred]
                scale = float(residual[:, marred].max())
                robust = residual[:, marred]
                while scale > 0.5 * limit:
                    robust = _solved(own, base / (1.0 + (robust.T / scale) ** 2), design, grams)[2]
                    scale *= 0.4
                far = use[:, marred] & (robust > limit)
                self.wrong[:, part[marred]] = far
                inverse = np.array(np.broadcast_to(inverse, (len(part), *inverse.shape[1:])))
                latent[marred], inverse[marred], residual[:, marred] = _solved(own, base * ~far.T, design, grams)
            fitted = np.trace(np.eye(design.shape[2]) - inverse, axis1=1, axis2=2).mean() * len(part)
            self._note_level(residual[use], float(fitted))
            flat = (mean + latent @ spread.T).reshape(len(part), -1, 3)
            self.shapes[:, part] = np.tensordot(sight.basis, flat, axes=(1, 1))  # one product of matrices
            tilted = np.einsum("nfk,fk->fn", depths @ inverse, depths)
            self.deviation[:, part] = np.sqrt(np.maximum(tilted, 0.0))
            self.done += len(part)
            yield part, latent

    def _note_level(self, residual: np.ndarray, fitted: float) -> None:
        """Noise of a chunk: by the median of its residuals (n,), ``fitted`` degrees of freedom less."""
        if residual.size:
            level = float(np.median(residual)) / _RAYLEIGH * self.sight.noise
            left = max(1.0 - fitted / (2 * residual.size), 0.1)
            self._levels.append((level / np.sqrt(left), residual.size))


def _solved(
    target: np.ndarray, weights: np.ndarray, design: np.ndarray, grams: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (n, q), their covariance, and residuals (F, n) of n points with weights (n, F).

    The covariance is (n, q, q), or (1, q, q) where all n were always seen.
    """
    size, count = design.shape[2], len(target)
    flat = design.reshape(-1, size)
    right = (target * weights[:, :, None]).reshape(count, -1) @ flat
    patterns = weights[:1] if (weights == 1.0).all() else weights
    inverse = np.linalg.inv((patterns @ grams).reshape(-1, size, size) + np.eye(size))
    latent = (right @ inverse[0]) if len(inverse) == 1 else (inverse @ right[:, :, None])[:, :, 0]
    residual = np.linalg.norm(target - (latent @ flat.T).reshape(target.shape), axis=2).T
    return latent, inverse, residual


def _distribution(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (3K,) and a square root (3K, q) of the covariance of the points' coefficients (P, 3K), its leading part."""
    mean = coefficients.mean(axis=0)
    centred = coefficients - mean
    squares, directions = np.linalg.eigh(centred.T @ centred / len(centred))
    squares, directions = squares[-_MOST_DIRECTIONS:], directions[:, -_MOST_DIRECTIONS:]
    return mean, directions * np.sqrt(np.maximum(squares, 1e-12 * squares[-1]))


def _cells(coefficients: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cells of points whose coefficients (P, 3K) are alike: labels (P,)."""
    centred = coefficients - coefficients.mean(axis=0)
    leading = np.linalg.eigh(centred.T @ centred)[1][:, -_COORDINATES:]
    return kmeans(centred @ leading, min(max(len(centred) // _CELL, 1), _MOST_CELLS), rng)


def _of_cell(
    coefficients: np.ndarray, everyone: tuple[np.ndarray, np.ndarray], noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (3K,) and a root (3K, q) of the covariance in one cell, drawn towards those of all points."""
    count = len(coefficients)
    mean = (coefficients.sum(axis=0) + _SHARED_MEAN * everyone[0]) / (count + _SHARED_MEAN)
    centred = coefficients - mean
    expected = _LOCAL * everyone[1]
    squares, directions = np.linalg.eigh((centred.T @ centred + _SHARED_SPREAD * expected) / (count + _SHARED_SPREAD))
    kept = squares > max((_UNSEEN * noise) ** 2, 1e-8 * squares[-1])
    kept[:-_MOST_DIRECTIONS], kept[-1] = False, True
    return mean, directions[:, kept] * np.sqrt(np.maximum(squares[kept], 0.0))
