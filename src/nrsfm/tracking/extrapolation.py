"""Lost regions are found again: a low-rank model of what is trusted says where the rest must be, and is matched.

A region that a chain has lost stays lost: its surroundings are far away by then, and a basis rich enough for the
deformation fits wrong matches as well as right ones. But a shape that is mostly rigid moves in very few trajectories,
four of a rigid one (Tomasi, Kanade: "Shape and Motion from Image Streams under Orthography", IJCV 9, 1992), and those
are known from the points that are trusted. So the trusted entries alone are factorised at a rank that is small at
first, what the model predicts for the others is matched to the images, what is confirmed is trusted, and the rank
grows. Ours. Which rank to begin with depends on how far from rigid the object is: two beginnings are tried, and the one
after which more of the video is trusted goes on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.tracking.matching import Template
from nrsfm.tracking.subspace import Subspace, match, samples_apart, smoothed
from nrsfm.tracking.visibility import judge, threshold

BEGINNINGS = ((3, 6, 9, 12), (6, 9, 12))
"""Ranks, one after the other, beside the mean trajectory; of short videos at most a third of the frames."""

_SWEEPS = 40  # of bases and coefficients
_OUTLIER = 3.0  # pixels from the model from which on an entry counts less
_FULL = 0.8  # likeness of full trust
_LEAST = 0.05  # trust of what is just visible
_HOLD = 1e-3  # ridge of a frame's basis, relative
_NEAR = 0.05  # pull of the surroundings on a coefficient, relative
_SIGMA = 2.0  # samples: how wide the surroundings are


def trust(template: Template, flows: np.ndarray) -> np.ndarray:
    """Return how much each entry of ``flows`` (F, h, w, 2) is trusted by its look, (F, h, w), 0 where not visible."""
    found = np.zeros(flows.shape[:3], dtype=np.float32)
    least = threshold(template, flows)
    for f, flow in enumerate(flows):
        if f == template.reference:
            found[f] = template.weight
            continue
        likeness = template.likeness(template.sample(template.frames[f], flow))
        seen, _ = judge(template, likeness, flow, None, least)
        found[f] = seen * np.clip((likeness - least) / (_FULL - least), _LEAST, 1)
    return found


def factorise(flows: np.ndarray, trusts: np.ndarray, inside: np.ndarray, step: int, rank: int) -> Subspace:
    """Return the subspace of ``rank`` and a mean nearest to trusted entries, on every ``step``-th pixel of ``inside``.

    Weighted least squares in turn for the frames' bases and the points' coefficients, entries beyond ``_OUTLIER``
    counting less; a coefficient is pulled towards its surroundings. ``flows`` (F, h, w, 2), ``trusts`` (F, h, w).
    """
    frames, grid = len(flows), inside[::step, ::step]
    tracks = flows[:, ::step, ::step][:, grid].transpose(0, 2, 1).astype(np.float64)
    own = trusts[:, ::step, ::step][:, grid].astype(np.float64)
    count = tracks.shape[2]
    mean = (tracks * own[:, None]).sum(axis=2) / np.maximum(own.sum(axis=1), 1e-9)[:, None]
    share = np.sqrt(own.mean(axis=0) + 1e-3)
    centred = (tracks - mean[:, :, None]) * own[:, None]
    _, _, right = np.linalg.svd(centred.reshape(2 * frames, count) * share, full_matrices=False)
    values = np.vstack([right[:rank] / share, np.ones(count)])
    around = own.mean(axis=0).astype(np.float32)
    around += 0.02 * around.mean()
    weights, basis = own, np.empty((frames, 2, rank + 1))
    for _ in range(_SWEEPS):
        spread = np.maximum(values[:rank].std(axis=1, keepdims=True), 1e-12)
        values[:rank] /= spread
        _bases(basis, tracks, weights, values)
        pairs = basis[:, :, :rank]
        products = np.einsum("fir,fis->frs", pairs, pairs).reshape(frames, -1)
        normal = (weights.T @ products).reshape(count, rank, rank)
        pull = _NEAR * float(np.mean(np.trace(normal, axis1=1, axis2=2))) / rank + 1e-9
        normal[:, np.arange(rank), np.arange(rank)] += pull
        near = smoothed(np.ascontiguousarray(values[:rank].T, dtype=np.float32), grid, around, _SIGMA)
        towards = np.einsum("fn,fir,fin->nr", weights, pairs, tracks - basis[:, :, rank:]) + pull * near
        values[:rank] = np.linalg.solve(normal, towards[..., None])[..., 0].T
        away = np.linalg.norm(tracks - (basis.reshape(2 * frames, -1) @ values).reshape(tracks.shape), axis=1)
        weights = own / np.maximum(1, away / _OUTLIER)
    _bases(basis, tracks, weights, values)
    residual = float(np.sqrt((own * away**2).sum() / max(float(own.sum()), 1e-9)))
    flat = basis.reshape(2 * frames, -1).astype(np.float32)
    return Subspace(flat, np.ascontiguousarray(values.T, dtype=np.float32), grid, step, residual)


def _bases(basis: np.ndarray, tracks: np.ndarray, weights: np.ndarray, values: np.ndarray) -> None:
    """Fill ``basis`` (F, 2, R + 1) with the least squares of every frame, given the points' ``values`` (R + 1, n)."""
    size = len(values)
    ridge = np.ones(size)
    ridge[-1] = 1e-6  # the mean is free
    for f in range(len(basis)):
        weighted = values * weights[f]
        normal = weighted @ values.T
        hold = _HOLD * np.trace(normal) / size + 1e-3
        basis[f] = np.linalg.solve(normal + hold * np.diag(ridge), weighted @ tracks[f].T).T


def beginnings(frames: int) -> list[list[int]]:
    """Return the ranks that are tried for so many frames."""
    largest = max(1, frames // 3)
    plans = [sorted({min(rank, largest) for rank in ranks}) for ranks in BEGINNINGS]
    return plans if plans[0] != plans[1] else plans[:1]


def matches(frames: int) -> int:
    """Return how often :func:`extrapolate` says that a frame is done."""
    return sum(map(len, beginnings(frames))) * frames


def extrapolate(template: Template, flows: np.ndarray, advance: Callable[[], None]) -> np.ndarray:
    """Return flows (F, h, w, 2) in which lost regions are predicted from trusted ones, and matched."""
    step, frames = samples_apart(template), len(flows)
    begin = trust(template, flows)
    samples = int(np.count_nonzero(template.inside[::step, ::step]))
    best, most = flows, -1.0
    for ranks in beginnings(frames):
        found, trusts = flows.copy(), begin
        for rank in ranks:
            model = factorise(found, trusts, template.inside, step, max(1, min(rank, samples - 2)))
            for f in range(frames):
                if f != template.reference:
                    found[f], _ = match(template, f, found[f], trusts[f], model.prediction(f, template.shape))
                advance()
            trusts = trust(template, found)
        if float(trusts.sum()) > most:
            best, most = found, float(trusts.sum())
    return best
