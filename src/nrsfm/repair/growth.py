"""The rank of tracks with gaps: grown step by step, judged on seen entries that are hidden the way others are missing.

Entries held out are those of stretches, not scattered ones: a sampled point is given the gaps of another point, so
that blocks are hidden where blocks are missing and single entries where those are. The score is the mean distance of
the held-out entries from their prediction, leaving out the worst tenth, which may be outliers. The rank grows until
two steps in a row gain nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nrsfm.repair.model import LEAST, Model, empty_model, fit, grown

_LADDER = (3, 6, 9, 12, 16, 20, 25, 30, 36, 43)
_HELD = 0.2  # share of the sampled points that are given the gaps of another point
_TRIM = 0.1
_GAIN = 0.98  # a step that lowers the error by less than 2% gains nothing
_STEPS = 12  # iterations for each rank on the way; the last one is iterated to convergence
_LAST = 40
_SETTLE = 120  # iterations of exact tracks, at the smallest noise
_EXACT = 0.01  # a step that lowers the noise tenfold has met the rank of noise-free tracks
_LONG = 150


@dataclass(frozen=True)
class Learned:
    """The model of the sampled points, their weights (F, n), the error held out (unit rms) and the ladder walked."""

    model: Model
    covariance: np.ndarray
    weights: np.ndarray
    held_out: float
    ladder: list[tuple[int, float, float]]


def hide_like_missing(seen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(F, n) bool: seen entries to hold out, at most half of what a point has, in the pattern of the missing ones.

    Complete tracks lend no pattern: stretches of a tenth to a third of the frames are taken then.
    """
    frames, count = seen.shape
    held = np.zeros((frames, count), dtype=bool)
    takers = rng.choice(count, size=max(1, round(_HELD * count)), replace=False)
    gaps = ~seen
    lenders = np.flatnonzero(gaps.any(axis=0))
    for taker in takers:
        if len(lenders):
            pattern = gaps[:, lenders[rng.integers(len(lenders))]]
        else:
            length = max(1, round(frames * rng.uniform(0.1, 0.33)))
            start = rng.integers(0, max(1, frames - length + 1))
            pattern = np.zeros(frames, dtype=bool)
            pattern[start : start + length] = True
        chosen = np.flatnonzero(pattern & seen[:, taker])
        most = int(np.count_nonzero(seen[:, taker])) // 2
        held[chosen[:most], taker] = True
    # A frame keeps most of its points, else its own row would be what is tested.
    for f in np.flatnonzero(held.sum(axis=1) > 0.3 * seen.sum(axis=1)):
        chosen = np.flatnonzero(held[f])
        held[f, chosen[int(0.3 * seen[f].sum()) :]] = False
    return held


def _score(model: Model, tracks: np.ndarray, held: np.ndarray) -> float:
    distance = np.linalg.norm(tracks - model.predict(model.coefficients), axis=1)[held]
    if not len(distance):
        return 0.0
    kept = np.sort(distance)[: max(1, int((1 - _TRIM) * len(distance)))]
    return float(np.mean(kept))


def learn(
    tracks: np.ndarray,
    seen: np.ndarray,
    rank: int | None,
    *,
    rng: np.random.Generator,
    monitor: Callable[[float], None],
) -> Learned:
    """Choose the rank and fit the model.

    Parameters
    ----------
    tracks
        (F, 2, n) of unit rms, zero where not seen.
    seen
        (F, n) bool.
    rank
        Use this rank; ``None`` chooses.
    """
    frames, count = seen.shape
    most = max(1, min(2 * frames - 1, count - 2, int(0.7 * np.median(2 * seen.sum(axis=0)))))
    held = hide_like_missing(seen, rng)
    open_ = (seen & ~held).astype(np.float64)
    weights = open_
    model = empty_model(tracks, open_)
    steps = [k for k in _LADDER if k < most] + ([most] if most <= _LADDER[-1] else [])
    if rank is not None:
        steps = [k for k in _LADDER if k < min(rank, most)] + [min(rank, most)]
    ladder: list[tuple[int, float, float]] = []
    best, best_score, waited = model, np.inf, 0
    for turn, k in enumerate(steps):
        monitor(0.7 * turn / len(steps))
        before = model.variance
        model = grown(model, tracks, weights, k)
        model, _, weights, _ = fit(model, tracks, open_, robust=False, iterations=_STEPS, change=2e-3, weights=weights)
        if model.variance < _EXACT * before:  # the true rank of exact tracks: there it pays to go to the end
            model, _, weights, _ = fit(
                model, tracks, open_, robust=False, iterations=_LONG, change=1e-3, weights=weights
            )
        score = _score(model, tracks, held)
        ladder.append((k, score, float(np.sqrt(model.variance))))
        if score < _GAIN * best_score or rank is not None:
            best, best_score, waited = model, score, 0
        else:
            waited += 1
            if waited == 2:
                break
        if model.variance <= LEAST**2 and rank is None:
            break  # exact: nothing is left to gain, and nothing to judge it by
    model, covariance, weights, _ = fit(
        best,
        tracks,
        seen.astype(np.float64),
        robust=False,
        iterations=_LAST,
        change=1e-3,
        settle=_SETTLE,
    )
    return Learned(model, covariance, weights, best_score, ladder)


def relearn(learned: Learned, tracks: np.ndarray, seen: np.ndarray) -> Learned:
    """The same rank, fitted again after ``seen`` (F, n) has changed."""
    model, covariance, weights, _ = fit(
        learned.model, tracks, seen.astype(np.float64), robust=False, iterations=_LAST, change=1e-3, settle=_SETTLE
    )
    return replace(learned, model=model, covariance=covariance, weights=weights)
