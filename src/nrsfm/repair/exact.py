"""Which entries of tracks without noise are wrong: those that a model, met exactly by all others, does not meet.

Where the model's noise is that of rounding, nothing has to be guessed: a track either lies in the span of M or it does
not. A track of which every seen entry is met has no wrong entry, whatever was suspected. Otherwise its verdicts are
tried: entries that the rest meets are taken back; and while some are not met, the one whose fit is worst in units of
what it may still move is left out and the rest fitted again.

Points of the sample can have directions of their own, which hide what is wrong in them. So the model is learned again
from points outside the first sample that were found to be clean. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.repair.growth import Learned, learn
from nrsfm.repair.model import LEAST, Model, infer, inferred_mean, spread_of_fit
from nrsfm.repair.view import View

ROUNDING = 1e-5
"""Largest noise of a model, in units of the tracks' rms, that counts as none."""

NEARLY = 1e-4
"""Noise up to which a model may be one of exact tracks, learned from some points that hold wrong entries."""

_MET = 100.0  # times the noise: rows of the model that few points show are known less well
_TYPICAL = 10.0  # times what nine in ten points show: what is met worse than that is not as good as measured
_SLIDE = 0.25  # share of suspected entries from which they are the stretch of a slide, not scattered ones
_RARE = 0.05
_MOST = 0.1  # share of wrong entries from which a verdict is doubted; twice that may be left out one by one


_LEAST = 3  # times the sample: so many points there must be to check a model with others than its own
_ROUNDS = 4


@dataclass(frozen=True)
class Exact:
    """``wrong`` (F, P): entries that are not met; ``clean`` (P,): points whose others are, as well as most points'."""

    wrong: np.ndarray
    clean: np.ndarray


def is_exact(model: Model) -> bool:
    """Whether the model leaves no more than rounding."""
    return bool(model.variance <= ROUNDING**2)


def settle_exactly(
    view: View,
    seen: np.ndarray,
    suspected: np.ndarray,
    candidates: np.ndarray,
    sample: np.ndarray,
    learned: Learned,
    rank: int | None,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, Learned] | None:
    """Wrong entries (F, P) of exact tracks, points (P,) that no verdict makes fit, and a model of clean points.

    ``sample``: the points of ``learned``; ``candidates`` (P,): those seen often enough. ``rank``: the model's, or
    ``None`` to choose. ``None`` is returned where tracks are not exact, or too few of their points are clean.
    """
    if learned.model.variance > NEARLY**2 or view.count < _LEAST * len(sample):
        return None
    for turn in range(_ROUNDS):
        found = exact_verdicts(view, seen, suspected, learned.model)
        if is_exact(learned.model) and (turn > 0 or not found.wrong.any()):
            return found.wrong, ~found.clean, learned
        suspected = suspected | found.wrong
        others = found.clean & candidates
        others[sample] = False
        if np.count_nonzero(others) < len(sample):
            return None
        sample = np.sort(rng.choice(np.flatnonzero(others), size=len(sample), replace=False))
        good = (seen & ~found.wrong)[:, sample]
        part = view.columns(sample) * good[:, None]
        learned = learn(part, good, rank, rng=rng, monitor=lambda _: None)
    return None


def exact_verdicts(view: View, seen: np.ndarray, suspected: np.ndarray, model: Model) -> Exact:
    """Verdicts on all points, from those (F, P) that are suspected."""
    limit = _MET * max(float(np.sqrt(2 * model.variance)), LEAST)
    wrong = np.zeros_like(seen)
    clean = np.ones(view.count, dtype=bool)
    worst = np.zeros(view.count)
    for part in view.chunks(np.arange(view.count)):
        use = seen[:, part]
        tracks = view.columns(part)
        worst[part] = _worst(model, tracks, use)
        left = np.flatnonzero(worst[part] > limit)
        if not len(left):
            continue
        own, mine = tracks[:, :, left], use[:, left]
        good = mine & ~suspected[:, part[left]]
        distance = _distance(model, own, good)
        met = np.max(distance * good, axis=0) <= limit
        out = mine & (distance > limit)
        # Few entries can be met by more than one track: where many are wrong, all of them are given a chance.
        share = (mine & ~good).sum(axis=0) / mine.sum(axis=0)
        many = out.sum(axis=0) > _MOST * mine.sum(axis=0)
        if np.count_nonzero(many & (share >= _SLIDE)) > _RARE * len(part):
            many &= share < _SLIDE  # tracks that slide: many, and not to be mended one entry at a time
        for i in np.flatnonzero(~met | many):
            starts = [mine[:, i]] if met[i] else [mine[:, i], good[:, i]]
            found = [_one_by_one(model, own[:, :, i], mine[:, i], start, limit) for start in starts]
            tries = [one for one in found if one is not None] + ([out[:, i]] if met[i] else [])
            clean[part[left[i]]] = bool(tries)
            out[:, i] = min(tries, key=np.count_nonzero) if tries else mine[:, i] & ~good[:, i]
        wrong[:, part[left]] = out
        worst[part[left]] = _worst(model, own, mine & ~out)
        clean[part[left]] &= out.sum(axis=0) < _SLIDE * mine.sum(axis=0)
    return Exact(wrong, clean & (worst <= _TYPICAL * float(np.quantile(worst, 0.9))))


def _distance(model: Model, tracks: np.ndarray, use: np.ndarray) -> np.ndarray:
    """(F, n): how far each entry is from the fit to those in use."""
    weights = use.astype(np.float64)
    rest = tracks - model.predict(inferred_mean(model, tracks * weights[:, None], weights))
    return np.asarray(np.linalg.norm(rest, axis=1))


def _worst(model: Model, tracks: np.ndarray, use: np.ndarray) -> np.ndarray:
    return np.asarray(np.max(_distance(model, tracks, use) * use, axis=0))


def _one_by_one(model: Model, track: np.ndarray, seen: np.ndarray, good: np.ndarray, limit: float) -> np.ndarray | None:
    """(F,) wrong entries of one track (F, 2), or None where too many would have to go."""
    use = good.copy()
    for _ in range(max(1, int(2 * _MOST * np.count_nonzero(seen)))):
        weights = use[:, None].astype(np.float64)
        mean, covariance = infer(model, track[:, :, None] * weights[:, None], weights)
        distance = np.linalg.norm(track - model.predict(mean)[:, :, 0], axis=1)
        if float(np.max(distance * use)) <= limit:
            return seen & (distance > limit)
        held = spread_of_fit(model, covariance)[:, 0] / (2 * model.variance)  # leverage of an entry on its own fit
        use[np.argmax(use * distance / np.sqrt(np.maximum(1.0 - held, 1e-6)))] = False
    return None
