"""Multi-frame subspace flow: a low-rank basis of trajectories, and the flow that stays near it.

After Garg, Roussos, Agapito: "A Variational Approach to Video Registration with Subspace Constraints", IJCV 104,
2013: the flow u(x; f) from the reference to every frame minimises

    Σ_f data(x, u(x; f))  +  β Σ_f ‖u(x; f) − Q_f c(x)‖²  +  smoothness of the coefficients c(x),

with the trajectories' basis Q (2F × R) soft, and the data term and the coefficients optimised in turn. Where we
differ: the data step is dense inverse search with variational refinement on evened-out images, from the frame warped
back by the prediction Q c; its outcome counts by its trust, 0 for what cannot be seen, which then follows Q c. The
coefficients solve weighted, robust least squares with a Gaussian prior (the basis scaled by its singular values) and
with their smoothed neighbourhood as a second prior. The basis is estimated again in every round, from predictions
where there was nothing to see, and its rank grows while smoothing and the assumed deviation fall.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from nrsfm.tracking.filling import spread
from nrsfm.tracking.matching import Template
from nrsfm.video.libraries import import_cv2

_SWEEPS = 8  # of basis and coefficients in each round
_INNER = 4  # of least squares and smoothing in each sweep
_SMOOTH = 6.0  # precision of a coefficient given its surroundings; its own variance is 1
_OUTLIER = 2.0  # pixels from the model from which on a point counts less
_FAR = 20.0  # pixels from the prediction at which a match loses its trust
_HELD = 0.5  # trust above which flow may start a match however far from the prediction it is
_FEWEST = 8

# Rank, deviation of the smoothing in samples, deviation of trusted flow from the model in pixels, round by round.
_ROUNDS = ((8, 3.0, 2.0), (12, 2.5, 1.5), (16, 2.0, 1.0), (20, 2.0, 1.0), (24, 1.5, 1.0), (28, 1.5, 0.7))


@dataclasses.dataclass(frozen=True, eq=False)
class Subspace:
    """Trajectories as a basis (2F, R) (its first column the mean) and coefficients (n, R) of the grid's samples."""

    basis: np.ndarray
    coefficients: np.ndarray
    inside: np.ndarray
    """(rows, columns) bool: the samples of the grid that lie in the mask, row by row those of the coefficients."""
    step: int
    residual: float
    """Root mean square distance of trusted flow from the model, pixels."""

    def prediction(self, frame: int, shape: tuple[int, int]) -> np.ndarray:
        """Return the flow (h, w, 2) of the model to one frame."""
        cv2 = import_cv2()

        field = np.zeros((*self.inside.shape, 2), dtype=np.float32)
        field[self.inside] = self.coefficients @ self.basis[2 * frame : 2 * frame + 2].T
        field = spread(field, self.inside.astype(np.float32))
        scale = np.array([[1 / self.step, 0, 0], [0, 1 / self.step, 0]], dtype=np.float32)
        found: np.ndarray = cv2.warpAffine(
            field,
            scale,
            (shape[1], shape[0]),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return found


def principal(tracks: np.ndarray, weights: np.ndarray, rank: int) -> np.ndarray:
    """Mean and principal trajectories scaled by their deviations, (2F, 1 + R), of weighted tracks (2F, n)."""
    good = weights >= np.quantile(weights, 0.3)
    chosen, share = tracks[:, good], weights[good] + 1e-6
    mean = (chosen * share).sum(axis=1, keepdims=True) / share.sum()
    centred = chosen - mean
    values, vectors = np.linalg.eigh((centred * share) @ centred.T / share.sum())
    order = np.argsort(-values)[:rank]
    scaled = vectors[:, order] * np.sqrt(np.maximum(values[order], 1e-6))
    return np.concatenate([mean, scaled], axis=1).astype(np.float32)


def smoothed(coefficients: np.ndarray, inside: np.ndarray, trust: np.ndarray, sigma: float) -> np.ndarray:
    """Return coefficients (n, R) as the trust-weighted average of their surroundings."""
    cv2 = import_cv2()

    plane = np.zeros(inside.shape, dtype=np.float32)
    plane[inside] = trust
    norm = cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)[inside] + 1e-9
    found = np.empty_like(coefficients)
    for i in range(coefficients.shape[1]):
        plane[inside] = coefficients[:, i] * trust
        found[:, i] = cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)[inside] / norm
    return found


def estimate(
    flows: np.ndarray, trusts: np.ndarray, inside: np.ndarray, step: int, rank: int, sigma: float, deviation: float
) -> Subspace:
    """Return the subspace of flows (F, h, w, 2) with weights (F, h, w), on every ``step``-th pixel of ``inside``."""
    frames = len(flows)
    grid = inside[::step, ::step]
    tracks = flows[:, ::step, ::step][:, grid].transpose(0, 2, 1).reshape(2 * frames, -1)
    weights = trusts[:, ::step, ::step][:, grid] ** 2
    count = tracks.shape[1]
    rank = max(1, min(rank, 2 * frames - 1, count - 1))
    mean_weight = weights.mean(axis=0)
    model, coefficients = tracks, np.zeros((0, 0), dtype=np.float32)
    for sweep in range(_SWEEPS):
        basis = principal(model, mean_weight, rank)
        size = basis.shape[1]
        pairs = basis.reshape(frames, 2, size)
        products = np.einsum("fir,fis->frs", pairs, pairs).reshape(frames, size * size)
        precision = weights / deviation**2
        if sweep:
            away = np.linalg.norm((tracks - model).reshape(frames, 2, count), axis=1)
            precision = precision / np.maximum(1, away / _OUTLIER)
        normal = (precision.T @ products).reshape(count, size, size)
        right = (np.repeat(precision, 2, axis=0) * tracks).T @ basis
        if not sweep:
            coefficients = np.zeros((count, size), dtype=np.float32)
            coefficients[:, 0] = 1
        unit = np.eye(size, dtype=np.float32)
        for inner in range(_INNER):
            first = not sweep and not inner
            near = coefficients if first else smoothed(coefficients, grid, mean_weight + 0.02, sigma)
            pull = np.float32(1.0 if first else _SMOOTH)
            solved = np.linalg.solve(normal + pull * unit, (right + pull * near)[..., None])
            coefficients = solved[..., 0].astype(np.float32)
        model = basis @ coefficients.T
    away = ((tracks - model) ** 2).reshape(frames, 2, count).sum(axis=1)
    residual = float(np.sqrt((weights * away).sum() / max(float(weights.sum()), 1e-9)))
    return Subspace(basis, coefficients, grid, step, residual)


def match(
    template: Template, frame: int, own: np.ndarray, trust: np.ndarray, model: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the data step of one frame: flow (h, w, 2) near the prediction ``model``, and its trust (h, w)."""
    cv2 = import_cv2()

    image = template.frames[frame]
    better = template.likeness(template.sample(image, own)) > template.likeness(template.sample(image, model)) + 0.1
    better &= (np.linalg.norm(own - model, axis=2) < 1.5 * _FAR) | (trust > _HELD)
    share = cv2.GaussianBlur(better.astype(np.float32), (0, 0), 2.0)[..., None]
    flow, _ = template.correct(frame, model + share * (own - model))
    away = np.linalg.norm(flow - model, axis=2)
    trust = template.seen(frame, flow) * np.exp(-((away / _FAR) ** 2))
    keep = np.clip(1.5 * trust, 0, 1)[..., None]
    return model + keep * (flow - model), trust.astype(np.float32)


def samples_apart(template: Template) -> int:
    """Return the pixels between samples: fewer than the option where the mask is small."""
    options = template.options
    step = options.grid
    while step > 1 and np.count_nonzero(template.inside[::step, ::step]) < _FEWEST * options.rank:
        step -= 1
    return step


def refine(
    template: Template, flows: np.ndarray, trusts: np.ndarray, advance: Callable[[], None]
) -> tuple[np.ndarray, np.ndarray, Subspace]:
    """Alternate between subspace and matching; ``flows`` and ``trusts`` are changed in place."""
    options = template.options
    step = samples_apart(template)
    for n in range(options.rounds):
        rank, sigma, deviation = _ROUNDS[min(n, len(_ROUNDS) - 1)]
        rank = min(rank, options.rank)
        found = estimate(flows, trusts, template.inside, step, rank, sigma, deviation)
        for f in range(len(flows)):
            if f != template.reference:
                model = found.prediction(f, template.shape)
                flows[f], trusts[f] = match(template, f, flows[f], trusts[f], model)
            advance()
    return flows, trusts, found
