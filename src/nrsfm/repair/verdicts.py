"""From suspicion to verdict: what the low-rank model, learned without the suspects, says about each entry.

A suspect is acquitted where the entries of its track that are not suspected predict it; and a whole point is where one
fit meets nearly all of its entries, suspects included, and more suspects than the freedom that the others leave could
meet by chance: a small part that moves by itself, but as the model can. An entry that was not suspected is wrong only
where it is far beyond the noise and its track parts at least somewhat from its neighbours', or where it hangs on to a
wrong one in time.

Where only a few points are suspected they may be acquitted at once: see :func:`acquitted`. Ours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.repair.cells import Cells
from nrsfm.repair.growth import Learned
from nrsfm.repair.model import Model, Prior, infer, inferred_mean, robust_weights
from nrsfm.repair.outliers import Suspicion, spread_in_time
from nrsfm.repair.view import View

_FAR = 5.0  # times the typical error of a prediction
_BEYOND = 10.0  # times the noise, for entries that were not suspected
_HANGING = 4.0  # times the noise, next in time to a wrong entry
_LEAST = 0.01  # of the tracks' rms: closer than this no entry is called wrong
_SOMEWHAT = 3.0  # score of the comparison with neighbours
_WIDE, _NARROWER = 0.3, 0.2
_MOST, _MANY = 0.85, 0.6  # shares of all entries, and of suspects, that a fit must meet to explain a point
_PRIVATE = 0.94  # a lone drifting track has 0.95 or more, a point of a small moving part less
_CLOSE, _SAME = 0.3, 0.4  # distance in units of the rms; share of the suspected frames in common
_MET = 0.8  # share of the entries that are not known to be wrong
_CLEAR = 5.0  # times the scale of a robust fit: nearer entries are met by it
_FINE = 5e-4  # smallest scale of a robust fit


def posterior(
    model: Model, tracks: np.ndarray, weights: np.ndarray, cells: Cells | None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, r) and covariance (n, r, r) of points under the prior of their cell."""
    prior = None if cells is None else cells.prior(inferred_mean(model, tracks, weights))
    return infer(model, tracks, weights, prior)


def posterior_mean(model: Model, tracks: np.ndarray, weights: np.ndarray, cells: Cells | None) -> np.ndarray:
    """The mean of :func:`posterior` alone."""
    mean = inferred_mean(model, tracks, weights)
    return mean if cells is None else inferred_mean(model, tracks, weights, cells.prior(mean))


def settled(
    model: Model, tracks: np.ndarray, seen: np.ndarray, prior: Prior | None, scales: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (n, r) and their covariance under Student's t noise whose scale shrinks from one to another."""
    scale, least = scales
    least = max(least, float(np.sqrt(model.variance)), _FINE)
    weights = seen
    while True:
        mean, covariance = infer(model, tracks, weights, prior)
        if scale < least:
            return mean, covariance
        rest = tracks - model.predict(mean)
        squared = np.einsum("fin,fin->fn", rest, rest)
        # infer() divides by the model's own variance.
        weights = seen * robust_weights(squared, scale**2) * (model.variance / scale**2)
        scale *= _NARROWER


def refined(
    model: Model, tracks: np.ndarray, seen: np.ndarray, prior: Prior | None, mean: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and covariance once more, from the entries that a robust fit ``mean`` meets, at their full weight.

    The robust fit stops at a scale of ``_FINE``, far above the noise of exact tracks.
    """
    near = _CLEAR * max(_FINE, float(np.sqrt(model.variance)))
    meets = seen * (np.linalg.norm(tracks - model.predict(mean), axis=1) < near)
    lost = meets.sum(axis=0) < _MET * seen.sum(axis=0)  # a robust fit that meets few entries has met the wrong ones
    return infer(model, tracks, np.where(lost, seen, meets), prior)


def _explained(
    model: Model, tracks: np.ndarray, seen: np.ndarray, clean: np.ndarray, prior: Prior | None, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (F, n) of all entries from what the clean ones predict, and which points are explained as a whole."""
    mean, _ = settled(model, tracks, clean, prior, (_WIDE, 0.1 * near))
    distance = np.linalg.norm(tracks - model.predict(mean), axis=1)
    # What a moving part of its own does need not be likely: the second fit has hardly a prior.
    free = np.einsum("nii->n", infer(model, tracks, clean)[1])
    weights, scale = seen, _WIDE
    while True:
        squared = np.sum((tracks - model.predict(inferred_mean(model, tracks, weights))) ** 2, axis=1)
        if scale < 0.1 * near:
            break
        weights = seen * robust_weights(squared, scale**2)
        scale *= _NARROWER
    agrees = (squared <= near**2) & (seen > 0)
    suspects = seen > clean
    number, fits = suspects.sum(axis=0), (agrees & suspects).sum(axis=0)
    whole = (agrees.sum(axis=0) >= _MOST * seen.sum(axis=0)) & (fits >= _MANY * number) & (2 * fits >= 1.5 * free + 4)
    return np.where(whole, np.sqrt(squared), distance), whole


def verdicts(
    view: View,
    seen: np.ndarray,
    suspicion: Suspicion,
    learned: Learned,
    cells: Cells | None,
    monitor: Callable[[float], None],
    previous: np.ndarray | None = None,
    among: np.ndarray | None = None,
) -> np.ndarray:
    """(F, P) bool: entries that are wrong.

    ``previous``: the verdicts with which the model was learned. ``among``: the points that are judged, all if not
    given; the verdicts on the others are the previous ones.
    """
    if previous is None:
        previous = suspicion.wrong
    model = learned.model
    noise = float(np.sqrt(2 * model.variance))
    threshold = max(_BEYOND * noise, _LEAST)
    acquit = max(_FAR * noise, 2.0 * learned.held_out, _LEAST)
    suspects = suspicion.wrong | previous
    good = seen & ~suspects
    judged = np.ones(view.count, dtype=bool)
    wrong = np.zeros_like(seen)
    if among is not None:
        judged[:] = False
        judged[among] = True
        wrong[:, ~judged] = previous[:, ~judged]
    doubtful = suspects.any(axis=0) & judged
    quiet = np.flatnonzero(judged & ~doubtful & (suspicion.score > _SOMEWHAT).any(axis=0))
    for part in view.chunks(quiet):
        weights = good[:, part].astype(np.float64)
        tracks = view.columns(part)
        rest = tracks - model.predict(posterior_mean(model, tracks, weights, cells))
        doubtful[part] = ((np.linalg.norm(rest, axis=1) > 0.5 * threshold) & good[:, part]).any(axis=0)
    members = np.flatnonzero(doubtful)
    for i, part in enumerate(view.chunks(members)):
        monitor(min(1.0, i * len(part) / len(members)))
        tracks = view.columns(part)
        use, clean = seen[:, part].astype(np.float64), good[:, part].astype(np.float64)
        prior = None
        if cells is not None:
            prior = cells.prior(inferred_mean(model, tracks * clean[:, None], clean))
        distance, whole = _explained(model, tracks, use, clean, prior, acquit)
        far = (distance > acquit) & suspects[:, part]
        beyond = (distance > threshold) & (suspicion.score[:, part] > _SOMEWHAT)
        hanging = (distance > max(_HANGING * noise, _LEAST)) & ~whole
        wrong[:, part] = spread_in_time((far | beyond) & seen[:, part], hanging, seen[:, part])
    return wrong


def acquitted(view: View, sample: np.ndarray, suspicion: Suspicion, learned: Learned) -> np.ndarray:
    """(P,) bool: suspected points, few of all, that are a small part which truly moves by itself.

    Either the model, learned from all that is seen, explains the point, and not by directions of its own; or another
    suspect nearby is suspected in mostly the same frames, which errors of trackers are not. ``sample``: the points that
    the model was learned from. The leverage of one of them is |b|²/n, its share in its own directions.
    """
    model = learned.model
    out = np.zeros(view.count, dtype=bool)
    near = max(_LEAST, _BEYOND * float(np.sqrt(2 * model.variance)))
    members = np.flatnonzero(suspicion.wrong.any(axis=0))
    for part in view.chunks(members):
        weights = view.seen(part).astype(np.float64)
        tracks = view.columns(part)
        mean = inferred_mean(model, tracks, weights)
        rest = np.linalg.norm(tracks - model.predict(mean), axis=1) * suspicion.wrong[:, part]
        leverage = np.sum(mean**2, axis=1) / len(sample) * np.isin(part, sample)
        out[part] = (rest.max(axis=0) <= near) & (leverage < _PRIVATE)
    for point in members:
        close = np.linalg.norm(suspicion.places[members] - suspicion.places[point], axis=1) < _CLOSE
        others = members[close & (members != point)]
        if not len(others):
            continue
        both = view.seen(others) & view.seen(np.array([point]))
        mine = suspicion.wrong[:, [point]] & both
        theirs = suspicion.wrong[:, others] & both
        common, either = (mine & theirs).sum(axis=0), (mine | theirs).sum(axis=0)
        out[point] |= bool((common > _SAME * np.maximum(either, 1)).any())
    return out
