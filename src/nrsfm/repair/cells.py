"""Neighbours move alike: a prior for the coefficients of each cell of points, learned from the cell.

The global prior N(0, I) is replaced, cell by cell, by N(m_c, Σ_c): mean and second moment of the posterior
coefficients of the cell's points (what is uncertain in a point counts with its covariance), shrunk towards a multiple
of the identity by a few imaginary points. A point with a long gap is then completed by what it shows itself and, where
that does not tell, the way its neighbours move. Empirical Bayes, repeated a few times. Ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from nrsfm.clustering import kmeans
from nrsfm.repair.model import Model, Prior, infer, inferred_mean

SIZE = 60  # points of a cell
_IMAGINARY = 3.0
_COORDINATES = 10
_ROUNDS = 4

Batches = Callable[[], Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]]


@dataclass(frozen=True)
class Cells:
    """``centres`` (K, q) in the leading coordinates scaled by ``size`` (q,); prior means (K, r), precisions."""

    centres: np.ndarray
    size: np.ndarray
    means: np.ndarray
    precisions: np.ndarray

    def prior(self, coefficients: np.ndarray) -> Prior:
        """The priors of points that are put into cells by provisional coefficients (n, r)."""
        place = coefficients[:, : len(self.size)] * self.size
        gaps = np.sum(self.centres**2, axis=1) - 2 * place @ self.centres.T
        return self.of(np.argmin(gaps, axis=1))

    def of(self, labels: np.ndarray) -> Prior:
        """The priors of given cells."""
        return Prior(self.means[labels], self.precisions[labels])


def learn_cells(model: Model, count: int, batches: Batches, rng: np.random.Generator) -> Cells | None:
    """Cells and their priors; ``None`` where the points are too few for two cells.

    ``batches()`` walks through the points to learn from, ``count`` in all: indices (n,) from 0, tracks (F, 2, n) and
    weights (F, n).
    """
    wanted = count // SIZE
    if wanted < 2 or model.rank < 1:
        return None
    r = model.rank
    mean = np.empty((count, r))
    for which, tracks, weights in batches():
        mean[which] = inferred_mean(model, tracks, weights)
    size = np.linalg.norm(model.loadings.reshape(-1, r), axis=0)[:_COORDINATES]
    place = mean[:, : len(size)] * size
    labels = kmeans(place.astype(np.float32), wanted, rng)
    groups = int(labels.max()) + 1
    number = np.bincount(labels, minlength=groups).astype(np.float64)
    centres = np.stack([np.bincount(labels, column, groups) for column in place.T], axis=1) / number[:, None]
    cells: Cells | None = None
    for _ in range(_ROUNDS):
        total, moment = np.zeros((groups, r)), np.zeros((groups, r, r))
        for which, tracks, weights in batches():
            own = labels[which]
            part, covariance = infer(model, tracks, weights, None if cells is None else cells.of(own))
            np.add.at(total, own, part)
            second = covariance + part[:, :, None] * part[:, None, :]
            order = np.argsort(own, kind="stable")
            starts = np.flatnonzero(np.diff(own[order], prepend=-1))
            moment[own[order][starts]] += np.add.reduceat(second[order], starts, axis=0)
        centre = total / number[:, None]
        scatter = moment - number[:, None, None] * centre[:, :, None] * centre[:, None, :]
        level = np.einsum("kii->k", scatter) / (number * r)
        scatter += (_IMAGINARY * level)[:, None, None] * np.eye(r)
        precisions = np.linalg.inv(scatter / (number + _IMAGINARY)[:, None, None])
        cells = Cells(centres, size, centre, precisions)
    return cells
