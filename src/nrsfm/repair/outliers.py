"""Which entries are wrong: unlike what the sequence's main motion says, and unlike what the neighbours do.

Low-rank models of high rank explain drifting tracks (a slide is low-rank too), and models of low rank leave real local
motion unexplained (a blinking eye). So the two questions are separated. A model of rank 6 under Student's t noise says
where each point belongs and leaves residuals e; subtracting the median residual of the nearest tracks in the same frame
leaves q, which real local motion shares with its neighbours and an error does not. An entry's score is |q| over the
largest of

- the point's own median of |q| over the frames (but at most 3 times its neighbours': a drifting track must not excuse
  itself),
- twice the neighbours' median of |q| in that frame,
- the reach of local motion: the median over points of the 85th percentile over frames,
- a floor of 0.0025 of the tracks' rms.

Above 10 an entry is suspected, and so are its neighbours in time above 3.5, so that a slide is caught from its start.
Tracks with many suspected entries may have been placed by their wrong part: they are placed again by parts of the
sequence, and the part that leaves most entries at peace is taken; in doubt an early one, because trackers go astray
with time. Suspicion is not yet a verdict: see
:func:`nrsfm.repair.stage.repair`. Ours. Cost O(F P), and two searches for neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.repair.model import Model, empty_model, fit, grown, infer, robust_weights, spread_of_fit
from nrsfm.repair.view import View, masked_median

SUSPECT = 10.0  # clean tracks reach 9, but for glitches that are real; Gaussian noise reaches 3
_WEAK = 3.5
_FLOOR = 0.0025
_LOOSE = 0.015  # floor while tracks are placed by a part of the sequence
_RANK = 6
_SAMPLE = 800
_NEIGHBOURS = 10
_MOST_SUSPECTED = 0.2  # a track with a larger share of suspects may be in the wrong place
_ROUNDS = 4
_LEAST_POINTS = 12
_OWN = 10.0  # neighbours in error excuse nothing: no more restless than so many times the reach
_LATE = 1.3  # a placement that gives up the beginning of a track must be better by this much


@dataclass(frozen=True)
class Suspicion:
    """``wrong`` (F, P) bool, ``score`` (F, P) float32; ``places`` (P, r) of the points, in units of the rms."""

    wrong: np.ndarray
    score: np.ndarray
    places: np.ndarray

    def unreliable(self, seen: np.ndarray) -> np.ndarray:
        """(P,) bool: points with many suspected entries."""
        return self.wrong.sum(axis=0) > _MOST_SUSPECTED * seen.sum(axis=0)


def base_model(view: View, sample: np.ndarray) -> Model:
    """Rank 6 (less for small data) under Student's t noise, from sampled points."""
    tracks, seen = view.columns(sample), view.seen(sample).astype(np.float64)
    model, weights = empty_model(tracks, seen), seen
    most = max(1, min(_RANK, len(sample) // 3, view.frames))
    for rank in sorted({min(3, most), most}):
        model = grown(model, tracks, weights, rank)
        model, _, weights, _ = fit(model, tracks, seen, robust=True, iterations=15, change=5e-3, weights=weights)
    return model


def place(model: Model, tracks: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Coefficients (n, r) of tracks (F, 2, n) under Student's t noise; ``seen`` (F, n) 0.0 or 1.0."""
    weights = seen
    mean = np.zeros((tracks.shape[2], model.rank))
    for _ in range(_ROUNDS):
        mean, covariance = infer(model, tracks, weights)
        rest = tracks - model.predict(mean)
        squared = np.einsum("fin,fin->fn", rest, rest) + spread_of_fit(model, covariance)
        weights = seen * robust_weights(squared, model.variance)
    return mean


def _size(model: Model) -> np.ndarray:
    return np.linalg.norm(model.loadings.reshape(-1, model.rank), axis=0)


def _apart(rest: np.ndarray, around: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """|q| (F, n): distance of residuals (F, 2, n) from the median (F, 2, n, k) of usable (F, n, k) neighbours."""
    middle = masked_median(around, np.broadcast_to(usable[:, None], around.shape))
    return np.linalg.norm(rest - middle, axis=1)


class _Residuals:
    """Residuals (F, 2, P) float32 of the base model with what is seen and, later, usable; and q."""

    def __init__(self, view: View, model: Model) -> None:
        self.view, self.model = view, model
        everyone = np.arange(view.count)
        self.coefficients = np.empty((view.count, model.rank))
        self.rest = np.empty((view.frames, 2, view.count), dtype=np.float32)
        self.seen = view.seen(slice(None))
        for part in view.chunks(everyone):
            tracks = view.columns(part)
            self.coefficients[part] = place(model, tracks, self.seen[:, part].astype(np.float64))
            self.rest[:, :, part] = tracks - model.predict(self.coefficients[part])
        self.usable = self.seen.copy()
        self.size = _size(model)

    def tree(self, members: np.ndarray) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.coefficients[members] * self.size)

    def neighbours(
        self, tree: Any, members: np.ndarray, points: np.ndarray, coefficients: np.ndarray | None = None
    ) -> np.ndarray:
        """(n, k) nearest members of each point, itself left out."""
        k = min(_NEIGHBOURS, len(members) - 1)
        place_ = (self.coefficients[points] if coefficients is None else coefficients) * self.size
        near = members[tree.query(place_, k=k + 1)[1].reshape(len(points), k + 1)]
        itself = near == points[:, None]
        itself[~itself.any(axis=1), -1] = True  # the farthest goes where the point is no member
        first = np.argmax(itself, axis=1)
        keep = np.ones_like(itself)
        keep[np.arange(len(points)), first] = False
        return near[keep].reshape(len(points), k)

    def distances(self, near: np.ndarray) -> np.ndarray:
        """|q| (F, P) float32 of all points, zero where not seen."""
        out = np.empty(self.seen.shape, dtype=np.float32)
        for part in self.view.chunks(np.arange(self.view.count)):
            out[:, part] = _apart(self.rest[:, :, part], self.rest[:, :, near[part]], self.usable[:, near[part]])
        return np.where(self.seen, out, np.float32(0))

    def scores(self, near: np.ndarray, floor: float) -> tuple[np.ndarray, float]:
        """Scores (F, P) and the reach of local motion."""
        distances = self.distances(near)
        count = self.view.count
        own = np.empty(count)
        high = np.empty(count)
        for part in self.view.chunks(np.arange(count)):
            ordered = np.sort(np.where(self.seen[:, part], distances[:, part], np.inf), axis=0)
            number = self.seen[:, part].sum(axis=0)
            pick = np.maximum((number - 1) // 2, 0), np.maximum(np.ceil(0.85 * number).astype(int) - 1, 0)
            values = [np.take_along_axis(ordered, i[None], axis=0)[0] for i in pick]
            own[part], high[part] = (np.where(number > 0, v, 0.0) for v in values)
        reach = float(np.median(high))
        least = max(reach, floor)
        own = np.minimum(own, np.minimum(3.0 * np.median(own[near], axis=1), _OWN * least))
        scale = np.maximum(own, least)
        out = np.empty(distances.shape, dtype=np.float32)
        for part in self.view.chunks(np.arange(count)):
            around = masked_median(distances[:, near[part]], self.usable[:, near[part]])
            out[:, part] = distances[:, part] / np.maximum(scale[part], np.minimum(2.0 * around, 2 * _OWN * least))
        return out, reach

    def place_without(self, wrong: np.ndarray) -> None:
        """Coefficients and residuals of tracks that hold wrong entries (F, P) by their other ones."""
        for part in self.view.chunks(np.flatnonzero(wrong.any(axis=0))):
            tracks, seen = self.view.columns(part), self.seen[:, part] & ~wrong[:, part]
            self.coefficients[part] = place(self.model, tracks, seen.astype(np.float64))
            self.rest[:, :, part] = tracks - self.model.predict(self.coefficients[part])

    def place_again(self, doubtful: np.ndarray, trusted: np.ndarray, reach: float) -> None:
        """Coefficients and residuals of doubtful tracks by the part of the sequence that fits most entries."""
        frames = self.view.frames
        tree = self.tree(trusted)
        bounds = [(0.0, 1.0), (0.0, 0.5), (0.0, 0.7), (0.3, 0.7), (0.3, 1.0), (0.5, 1.0)]
        for part in self.view.chunks(doubtful):
            tracks, seen = self.view.columns(part), self.seen[:, part]
            best = np.full(len(part), np.inf)
            for low, high in bounds:
                stretch = np.zeros((frames, 1), dtype=bool)
                stretch[int(low * frames) : max(int(high * frames), int(low * frames) + 2)] = True
                enough = (seen & stretch).sum(axis=0) * 2 > self.model.rank
                use, least = seen & stretch, max(reach, _LOOSE)
                for _ in range(2):  # what agrees with that part, wherever it is, then places the track
                    mean = place(self.model, tracks, use.astype(np.float64))
                    rest = tracks - self.model.predict(mean)
                    near = self.neighbours(tree, trusted, part, mean)
                    apart = _apart(rest, self.rest[:, :, near], self.usable[:, near])
                    use = seen & (apart < SUSPECT * least)
                cost = np.sum(seen * np.minimum(apart / least, SUSPECT) ** 2, axis=0)
                if low > 0:
                    cost = cost * _LATE
                better = enough & (cost < best)
                best[better] = cost[better]
                self.coefficients[part[better]] = mean[better]
                self.rest[:, :, part[better]] = rest[:, :, better]


def spread_in_time(wrong: np.ndarray, weak: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(F, n): wrong entries and the weak ones that hang on to them in time, over gaps too."""
    passing = weak | ~seen
    reached = wrong.copy()
    for f in range(1, len(wrong)):
        reached[f] |= passing[f] & reached[f - 1]
    for f in range(len(wrong) - 2, -1, -1):
        reached[f] |= passing[f] & reached[f + 1]
    return reached & seen


def suspect(view: View, rng: np.random.Generator) -> Suspicion | None:
    """Suspected entries of all points; ``None`` where there are too few points to compare."""
    if view.count < _LEAST_POINTS:
        return None
    everyone = np.arange(view.count)
    sample = everyone if view.count <= _SAMPLE else np.sort(rng.choice(view.count, size=_SAMPLE, replace=False))
    residuals = _Residuals(view, base_model(view, sample))
    near = residuals.neighbours(residuals.tree(everyone), everyone, everyone)
    score, reach = residuals.scores(near, _FLOOR)
    wrong = spread_in_time(score > SUSPECT, score > _WEAK, residuals.seen)
    if not wrong.any():
        return Suspicion(wrong, score, residuals.coefficients * residuals.size / np.sqrt(view.frames))
    share = wrong.sum(axis=0) / np.maximum(residuals.seen.sum(axis=0), 1)
    trusted, doubtful = np.flatnonzero(share <= _MOST_SUSPECTED), np.flatnonzero(share > _MOST_SUSPECTED)
    residuals.usable &= ~wrong
    if len(trusted) > _NEIGHBOURS:
        residuals.place_again(doubtful, trusted, reach)
        # What part of a track says about its place is not exact elsewhere: a coarse look first, then a fine one.
        for floor in (_LOOSE, _FLOOR):
            near = residuals.neighbours(residuals.tree(trusted), trusted, everyone)
            score, reach = residuals.scores(near, floor)
            wrong = spread_in_time(score > SUSPECT, score > _WEAK, residuals.seen)
            if floor > _FLOOR:
                residuals.place_without(wrong)
        wrong = spread_in_time(score > SUSPECT, score > _WEAK, residuals.seen)
    return Suspicion(wrong, score, residuals.coefficients * residuals.size / np.sqrt(view.frames))
