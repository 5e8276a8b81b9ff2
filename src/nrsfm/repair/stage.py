"""The stage that makes real tracks complete and clean before any method runs.

    tracks → suspected entries → low-rank model with held-out rank → neighbours' prior → verdicts → filled entries

Objective of the completion: the posterior mean of the missing entries under :mod:`nrsfm.repair.model` with the priors
of :mod:`nrsfm.repair.cells`. The model's rows are learned from at most a thousand points, because what they need does
not grow with P; given them, every point's coefficients are a small regression of their own, so the cost is linear in P.

An entry is called wrong only where two independent questions agree: its track parts from its neighbours'
(:mod:`nrsfm.repair.outliers`), and the model, fitted without it, predicts it far from where it was measured. A small
part that moves by itself fails the first and passes the second.

Nothing is invented: a point that is seen in too few frames is not completed but marked, and visibility that does not
determine a completion is refused. Input without gaps and without outliers is returned as it came.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.numerics.threads import single_thread
from nrsfm.repair.cells import Batches, Cells, learn_cells
from nrsfm.repair.exact import is_exact, settle_exactly
from nrsfm.repair.growth import Learned, hide_like_missing, learn, relearn
from nrsfm.repair.model import Model, spread_of_fit
from nrsfm.repair.options import Repaired, RepairOptions
from nrsfm.repair.outliers import SUSPECT, Suspicion, suspect
from nrsfm.repair.resection import GOOD, NOISY
from nrsfm.repair.screen import worth_a_look
from nrsfm.repair.verdicts import acquitted, posterior, posterior_mean, refined, settled, verdicts
from nrsfm.repair.view import LEAST_IN_FRAME, View, require_tied, view_of
from nrsfm.tracks import Tracks

_SAMPLE = 1_000  # points that teach the model's rows
_CELL_SAMPLE = 30_000  # points that teach the neighbours' priors
_LEAST_FRAMES = 3
_MUCH = 0.5
_FEW = 0.02  # share of the points: so few suspects are first asked whether the model explains them
_TURNS = 4
_STABLE = 0.002
_WIDE = 0.03


def repair(
    tracks: Tracks, options: RepairOptions, rng: np.random.Generator, monitor: Callable[[float], None]
) -> Repaired:
    """Complete the tracks and take out what is wrong.

    Parameters
    ----------
    tracks
        Any tracks; at least 3 frames and 4 points.
    options
        See :class:`RepairOptions`.
    rng
        Source of every random choice.
    monitor
        Called with the fraction that is done.

    Raises
    ------
    InputError
        A frame shows fewer than four points, or the frames fall into parts that share too few points.
    """
    with single_thread():  # many small systems: threads would cost more than they give
        return _repair(tracks, options, rng, monitor)


def _repair(
    tracks: Tracks, options: RepairOptions, rng: np.random.Generator, monitor: Callable[[float], None]
) -> Repaired:
    everyone = np.ones(tracks.n_points, dtype=bool)
    whole = Repaired(tracks.points, everyone, None, {"missing": 0, "outliers": 0})
    if tracks.complete and not options.outliers:
        return whole
    view = view_of(tracks, rng)
    if tracks.complete and not worth_a_look(view, rng):
        return whole
    seen = view.seen(slice(None))
    few_frames = options.least_frames or _LEAST_FRAMES
    candidates = seen.sum(axis=0) >= few_frames
    require_tied(seen[:, candidates])
    monitor(0.05)
    suspicion = suspect(view, rng) if options.outliers else None
    if tracks.complete and (suspicion is None or not suspicion.wrong.any()):
        return whole
    monitor(0.2)
    good = seen
    few = suspicion is not None and 0 < np.count_nonzero(suspicion.wrong.any(axis=0)) <= _FEW * view.count
    if suspicion is not None and not few:
        good = seen & ~suspicion.wrong
    candidates &= good.sum(axis=0) >= few_frames
    require_tied(good[:, candidates])
    members = np.flatnonzero(candidates)
    teachers = members
    if suspicion is not None and not few:  # drift that was not found would teach the model to drift
        teachers = members[~suspicion.unreliable(seen)[members]]
        teachers = teachers if 2 * len(teachers) > len(members) else members
    sample = teachers if len(teachers) <= _SAMPLE else np.sort(rng.choice(teachers, size=_SAMPLE, replace=False))
    if good[:, sample].sum(axis=1).min() < LEAST_IN_FRAME:
        sample = members  # some frame shows few points: all of them are needed

    def again(old: Learned | None, done: float) -> tuple[Learned, Cells | None]:
        part = view.columns(sample) * good[:, None, sample]
        if old is not None:
            new = relearn(old, part, good[:, sample])
        else:
            new = learn(
                part, good[:, sample], options.completion_rank, rng=rng, monitor=lambda f: monitor(done + 0.3 * f)
            )
        return new, _neighbours(view, good, new, teachers, rng)

    learned, cells = again(None, 0.2)
    wrong, spoilt = np.zeros_like(seen), np.zeros(view.count, dtype=bool)
    exactly = None
    if suspicion is not None:
        exactly = settle_exactly(view, seen, suspicion.wrong, candidates, sample, learned, options.completion_rank, rng)
    if exactly is not None:
        wrong, spoilt, learned = exactly
        good = seen & ~wrong
    elif suspicion is not None:
        if few:
            free = acquitted(view, sample, suspicion, learned)
            suspicion.wrong[:, free] = False
            if suspicion.wrong.any():
                good = seen & ~suspicion.wrong
                learned, cells = again(learned, 0.5)
        if suspicion.wrong.any():
            wrong = suspicion.wrong
            for turn in range(_TURNS):  # the model needs the verdicts on its own points alone
                before, done = wrong, 0.6 + 0.05 * turn
                wrong = verdicts(view, seen, suspicion, learned, cells, _part(monitor, done, 0.05), before, sample)
                good = seen & ~wrong
                own = wrong[:, sample]
                if np.count_nonzero(own ^ before[:, sample]) <= _STABLE * max(int(np.count_nonzero(own)), 1):
                    break
                learned, cells = again(None if turn == 0 else learned, done)
            wrong = verdicts(view, seen, suspicion, learned, cells, _part(monitor, 0.8, 0.05), wrong)
            good = seen & ~wrong
    if tracks.complete and not wrong.any():
        return whole
    monitor(0.85)
    least = options.least_frames or max(_LEAST_FRAMES, min(-(-learned.model.rank // 2), -(-view.frames // 4)))
    kept = candidates & (good.sum(axis=0) >= least)
    if kept.sum() < 4:
        raise InputError(
            f"tracks: at least 4 points must be seen in {least} frames or more, received {int(kept.sum())}"
        )
    points, doubt = _filled(view, good, wrong, kept, learned.model, cells, monitor)
    doubt[spoilt] = view.unit
    filled = np.count_nonzero(~good, axis=0)[kept]
    uncertain = float(np.sqrt(np.sum(doubt[kept] ** 2 * filled) / max(int(filled.sum()), 1)))
    confidence = _confidence(seen, wrong, suspicion)
    report = _report(seen, wrong, kept, least, learned, cells, uncertain, view.unit)
    level = max(float(np.sqrt(learned.model.variance)), GOOD) * view.unit
    noisy = bool(learned.model.variance > NOISY**2)
    return Repaired(
        points, kept, confidence, report, _warnings(report, seen), doubt, doubt_level=level, noisy=noisy, good=good
    )


def _part(monitor: Callable[[float], None], start: float, share: float) -> Callable[[float], None]:
    return lambda done: monitor(start + share * done)


def _neighbours(
    view: View, good: np.ndarray, learned: Learned, members: np.ndarray, rng: np.random.Generator
) -> Cells | None:
    """Priors of cells, where they predict held-out entries better than the global prior.

    Dense exact tracks need none: what their own entries do not determine is not used (:func:`trusted_points`).
    """
    model = learned.model
    if model.variance <= NOISY**2 and view.count >= 3 * view.frames:
        return None
    if len(members) > _CELL_SAMPLE:
        members = np.sort(rng.choice(members, size=_CELL_SAMPLE, replace=False))

    def batches(use: np.ndarray, which: np.ndarray) -> Batches:
        def walk() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
            for part in view.chunks(np.arange(len(which))):
                weights = use[:, part].astype(np.float64)
                yield part, view.columns(which[part]) * weights[:, None], weights

        return walk

    trial = members[:: max(1, len(members) // 2000)]
    use = good[:, trial]
    held = hide_like_missing(use, rng)
    cells = learn_cells(model, len(trial), batches(use & ~held, trial), rng)
    if cells is None:
        return None
    score = np.zeros(2)
    for part, tracks, weights in batches(use & ~held, trial)():
        truth = view.columns(trial[part])
        for i, prior in enumerate((None, cells)):
            distance = np.linalg.norm(truth - model.predict(posterior_mean(model, tracks, weights, prior)), axis=1)
            score[i] += float(np.sum(distance[held[:, part]]))
    if score[1] >= score[0]:
        return None
    return learn_cells(model, len(members), batches(good[:, members], members), rng)


def _filled(
    view: View,
    good: np.ndarray,
    wrong: np.ndarray,
    kept: np.ndarray,
    model: Model,
    cells: Cells | None,
    monitor: Callable[[float], None],
) -> tuple[np.ndarray, np.ndarray]:
    """The completed points, and for each the root mean square standard deviation of its filled entries, their unit."""
    out = np.array(view.points, order="C")
    out[:, ~kept] = np.nan
    needed = np.flatnonzero(kept & ~good.all(axis=0))
    doubt = np.zeros(len(kept))
    for i, part in enumerate(view.chunks(needed)):
        monitor(0.85 + 0.15 * min(1.0, i * len(part) / max(len(needed), 1)))
        use = good[:, part]
        weights = use.astype(np.float64)
        tracks = view.columns(part) * weights[:, None]
        mean, covariance = posterior(model, tracks, weights, cells)
        marred = wrong[:, part].any(axis=0) & (not is_exact(model))
        if marred.any():  # what is left of an error, the start of a slide, must not steer the rest of its track
            prior = None if cells is None else cells.prior(mean[marred])
            own, use_own = tracks[:, :, marred], weights[:, marred]
            robust, _ = settled(model, own, use_own, prior, (_WIDE, 0.0))
            mean[marred], covariance[marred] = refined(model, own, use_own, prior, robust)
        filled = (model.predict(mean) * view.unit + view.offset[:, :, None]).transpose(0, 2, 1)
        out[:, part] = np.where(use[:, :, None], view.points[:, part], filled.astype(out.dtype))
        total = np.sum(spread_of_fit(model, covariance) * ~use, axis=0)
        doubt[part] = np.sqrt(np.maximum(total, 0.0) / np.maximum(2 * np.count_nonzero(~use, axis=0), 1))
    return out, view.unit * doubt


def _confidence(seen: np.ndarray, wrong: np.ndarray, suspicion: Suspicion | None) -> np.ndarray | None:
    """1 up to half the score that makes an entry suspect, falling to ½ there; 0 where wrong or not seen."""
    if seen.all() and not wrong.any():
        return None
    out = np.ones(seen.shape, dtype=np.float32)
    if suspicion is not None and wrong.any():
        np.clip(1.5 - suspicion.score / SUSPECT, 0.5, 1.0, out=out)
    out[wrong | ~seen] = 0.0
    return out


def _report(
    seen: np.ndarray,
    wrong: np.ndarray,
    kept: np.ndarray,
    least: int,
    learned: Learned,
    cells: Cells | None,
    uncertain: float,
    unit: float,
) -> dict[str, Any]:
    return {
        "missing": int(seen.size - np.count_nonzero(seen)),
        "outliers": int(np.count_nonzero(wrong)),
        "outlier_points": int(np.count_nonzero(wrong.any(axis=0))),
        "rank": learned.model.rank,
        "ladder": [[k, error * unit, noise * unit] for k, error, noise in learned.ladder],
        "held_out_error": learned.held_out * unit,
        "noise": float(np.sqrt(learned.model.variance)) * unit,
        "filled_deviation": uncertain,
        "cells": 0 if cells is None else len(cells.means),
        "least_frames": int(least),
        "not_reconstructed": int(np.count_nonzero(~kept)),
    }


def _warnings(report: dict[str, Any], seen: np.ndarray) -> list[str]:
    texts = []
    if report["not_reconstructed"]:
        texts.append(
            f"{report['not_reconstructed']} of {seen.shape[1]} points are seen in fewer than "
            f"{report['least_frames']} frames and are not reconstructed"
        )
    missing, outliers = report["missing"] / seen.size, report["outliers"] / max(seen.size - report["missing"], 1)
    if missing > _MUCH:
        texts.append(f"{100 * missing:.0f}% of the entries are missing: the completion is a guess in part")
    if report["outliers"] > 0:
        texts.append(
            f"{100 * outliers:.2f}% of the entries, in {report['outlier_points']} points, were taken for "
            "outliers and replaced"
        )
    few = int(seen.sum(axis=1).min())
    if few < 2 * report["rank"] and report["missing"] > 0 and few < 0.2 * seen.shape[1]:
        texts.append(
            f"frame {int(np.argmin(seen.sum(axis=1)))} shows only {few} points, few for a completion of rank "
            f"{report['rank']}"
        )
    return texts
