"""A low-rank model of tracks with entries that were not seen, fitted by variational Bayes.

Every point j has the track w_j = M b_j + μ + noise, of which only some frames are seen. M (2F × r) are the ways in
which the image moves, μ (2F) each frame's translation (unknown too: rows with gaps cannot be centred beforehand),
b_j ~ N(0, I) the point's coefficients, columns of M ~ N(0, 1/α_k), noise ~ N(0, σ²/u_fj) with u_fj = 1, or, where
outliers are feared, u_fj ~ Gamma, which makes the noise Student's t. The posterior is taken as a product of Gaussians
over the points' coefficients and over the frames' rows [M_f μ_f], and α, σ are those that maximise the evidence:

    points   Λ_j = I + Σ_f u_fj E[M_fᵀM_f]/σ²,     b_j = Λ_j⁻¹ Σ_f u_fj E[M_fᵀ(w_fj − μ_f)]/σ²
    frames   [M_f μ_f] = Σ_j u_fj w_fj E[(b_j 1)] · (Σ_j u_fj E[(b_j 1)ᵀ(b_j 1)] + σ² diag(α 0))⁻¹

both in closed form, in turn; between them the coefficients are put to zero mean and unit second moment, with M's
columns orthogonal, which takes the slow directions out of the iteration. A direction that the seen entries do not
determine falls back to the prior instead of blowing up, so a rank that is too large does little harm.

Source: A. Ilin and T. Raiko, "Practical approaches to principal component analysis in the presence of missing
values", JMLR 11, 2010; Student's t noise as a scale mixture: K. Lange, R. Little and J. Taylor, "Robust statistical
modeling using the t distribution", JASA 84, 1989; rows that two coordinates share, weights and units: ours.
It does not hold on the exact compression, which a mask destroys: it comes before. An iteration costs O(n r² (F + r)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

_FREEDOM = 4.0  # of Student's t: heavy enough for a tenth of outliers, light enough for clean tracks
LEAST = 1e-6  # smallest noise, in units of the tracks' rms: below it the prior is lost in rounding


@dataclass(frozen=True)
class Model:
    """The fitted model.

    ``loadings`` M (F, 2, r), ``means`` μ (F, 2), ``covariance`` (F, r+1, r+1) of a frame's row [M μ], ``relevance`` α
    (r,), ``variance`` σ², and the ``coefficients`` (n, r) of the points that it was fitted to.
    """

    loadings: np.ndarray
    means: np.ndarray
    covariance: np.ndarray
    relevance: np.ndarray
    variance: float
    coefficients: np.ndarray

    @property
    def rank(self) -> int:
        """R."""
        return self.loadings.shape[2]

    def predict(self, coefficients: np.ndarray) -> np.ndarray:
        """Tracks (F, 2, n) of coefficients (n, r)."""
        frames = len(self.loadings)
        flat = self.loadings.reshape(2 * frames, -1) @ coefficients.T
        return flat.reshape(frames, 2, -1) + self.means[:, :, None]

    def squares(self) -> np.ndarray:
        """E[M_fᵀM_f] (F, r, r)."""
        r = self.rank
        return self.loadings.transpose(0, 2, 1) @ self.loadings + 2 * self.covariance[:, :r, :r]


def empty_model(tracks: np.ndarray, weights: np.ndarray) -> Model:
    """Rank 0: the frames' means. ``tracks`` (F, 2, n), zero where ``weights`` (F, n) is."""
    frames, _, count = tracks.shape
    total = np.maximum(weights.sum(axis=1), 1e-12)[:, None]
    means = np.einsum("fin,fn->fi", tracks, weights) / total
    gap = tracks - means[:, :, None]
    variance = float(np.einsum("fin,fin,fn->", gap, gap, weights, optimize=True) / (2 * weights.sum()))
    none = np.zeros((frames, 2, 0))
    return Model(none, means, np.zeros((frames, 1, 1)), np.zeros(0), max(variance, LEAST**2), np.zeros((count, 0)))


def grown(model: Model, tracks: np.ndarray, weights: np.ndarray, rank: int) -> Model:
    """The model with the leading directions of what it leaves unexplained added, up to ``rank``."""
    frames, _, count = tracks.shape
    more = rank - model.rank
    rest = ((tracks - model.predict(model.coefficients)) * weights[:, None]).reshape(2 * frames, count)
    if 2 * frames <= count:
        vectors = np.linalg.eigh(rest @ rest.T)[1][:, ::-1][:, :more]
    else:
        vectors = rest @ np.linalg.eigh(rest.T @ rest)[1][:, ::-1][:, :more]
        vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=0), 1e-300)
    scores = rest.T @ vectors
    size = np.maximum(np.sqrt(np.mean(scores**2, axis=0)), LEAST)
    loadings = np.concatenate([model.loadings, (vectors * size).reshape(frames, 2, more)], axis=2)
    old = model.covariance
    covariance = np.zeros((frames, rank + 1, rank + 1))
    kept = [*range(model.rank), rank]
    covariance[np.ix_(range(frames), kept, kept)] = old
    return replace(
        model,
        loadings=loadings,
        covariance=covariance,
        relevance=np.concatenate([model.relevance, 1.0 / size**2]),
        coefficients=np.concatenate([model.coefficients, scores / size], axis=1),
    )


@dataclass(frozen=True)
class Prior:
    """Mean (r,) or (n, r) and precision (r, r) or (n, r, r) of the coefficients before anything is seen."""

    mean: np.ndarray
    precision: np.ndarray


def infer(
    model: Model, tracks: np.ndarray, weights: np.ndarray, prior: Prior | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n, r) and covariance (n, r, r) of the coefficients of tracks (F, 2, n) under weights (F, n)."""
    information, pull = _normal_equations(model, tracks, weights, prior)
    covariance = np.linalg.inv(information)
    return (covariance @ pull[:, :, None])[:, :, 0], covariance


def inferred_mean(model: Model, tracks: np.ndarray, weights: np.ndarray, prior: Prior | None = None) -> np.ndarray:
    """The mean of :func:`infer` alone, in a fraction of its time; complete tracks share one system."""
    if prior is None and (whole := np.all(weights == 1.0, axis=0)).any():
        out = np.empty((tracks.shape[2], model.rank))
        one = np.flatnonzero(whole)[:1]
        information, _ = _normal_equations(model, tracks[:, :, one], weights[:, one], None)
        gap = (tracks[:, :, whole] - model.means[:, :, None]).reshape(-1, int(whole.sum()))
        pull = gap.T @ model.loadings.reshape(len(gap), -1) - 2 * model.covariance[:, :-1, -1].sum(axis=0)
        out[whole] = np.linalg.solve(information[0], pull.T / model.variance).T
        if not whole.all():
            out[~whole] = inferred_mean(model, tracks[:, :, ~whole], weights[:, ~whole])
        return out
    information, pull = _normal_equations(model, tracks, weights, prior)
    return np.linalg.solve(information, pull[:, :, None])[:, :, 0]


def _normal_equations(
    model: Model, tracks: np.ndarray, weights: np.ndarray, prior: Prior | None
) -> tuple[np.ndarray, np.ndarray]:
    """Information Λ (n, r, r) of the coefficients, and Λ b (n, r)."""
    frames, _, count = tracks.shape
    r = model.rank
    information = (weights.T @ model.squares().reshape(frames, r * r)).reshape(count, r, r) / model.variance
    gap = (tracks - model.means[:, :, None]) * weights[:, None]
    pull = gap.reshape(2 * frames, count).T @ model.loadings.reshape(2 * frames, r)
    pull = (pull - weights.T @ (2 * model.covariance[:, :r, r])) / model.variance
    if prior is None:
        information[:, range(r), range(r)] += 1.0
    else:
        information += prior.precision
        pull += (prior.precision @ prior.mean[..., None])[..., 0]
    return information, pull


def spread_of_fit(model: Model, covariance: np.ndarray) -> np.ndarray:
    """(F, n): variance, x and y together, that uncertain coefficients (n, r, r) leave in each entry."""
    r = model.rank
    squares = model.loadings.transpose(0, 2, 1) @ model.loadings
    return squares.reshape(-1, r * r) @ covariance.reshape(-1, r * r).T


def robust_weights(squared: np.ndarray, variance: float) -> np.ndarray:
    """Expected weight of an entry whose expected squared deviation, x and y together, is given."""
    return (_FREEDOM + 2.0) / (_FREEDOM + squared / variance)


def _centred(model: Model, mean: np.ndarray, covariance: np.ndarray) -> tuple[Model, np.ndarray, np.ndarray]:
    """The same model with coefficients of zero mean and unit second moment, columns of M orthogonal."""
    r = model.rank
    shift = mean.mean(axis=0)
    means = model.means + model.loadings @ shift
    mean = mean - shift
    moment = mean.T @ mean / len(mean) + covariance.mean(axis=0)
    root = np.linalg.cholesky(moment + 1e-12 * np.trace(moment) / r * np.eye(r))
    loadings = model.loadings @ root
    turn = np.linalg.svd(loadings.reshape(-1, r), full_matrices=False)[2]
    change = turn @ np.linalg.inv(root)
    model = replace(model, loadings=loadings @ turn.T, means=means)
    return model, mean @ change.T, change @ covariance @ change.T


def _rows(
    model: Model, tracks: np.ndarray, weights: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> tuple[Model, float]:
    """The frames' rows and α given the points' coefficients (n, r) and their covariances (n, r, r).

    Also the expected weighted squared deviation of all entries from the new model, in all.
    """
    frames, _, count = tracks.shape
    r = model.rank
    moments = np.empty((count, r + 1, r + 1))
    moments[:, :r, :r] = mean[:, :, None] * mean[:, None, :] + covariance
    moments[:, :r, r] = moments[:, r, :r] = mean
    moments[:, r, r] = 1.0
    gram = (weights @ moments.reshape(count, -1)).reshape(frames, r + 1, r + 1)
    seen = (tracks * weights[:, None]).reshape(2 * frames, count)
    pull = (seen @ np.concatenate([mean, np.ones((count, 1))], axis=1)).reshape(frames, 2, r + 1)
    ridge = np.append(model.relevance * model.variance, 0.0) + 1e-14 * count
    inverse = np.linalg.inv(gram + ridge * np.eye(r + 1))
    rows = pull @ inverse
    uncertain = inverse * model.variance
    relevance = 2 * frames / (np.einsum("fik,fik->k", rows, rows)[:r] + 2 * np.einsum("fkk->k", uncertain)[:r] + 1e-300)
    squares = rows.transpose(0, 2, 1) @ rows + 2 * uncertain
    deviation = float(np.vdot(seen, tracks) - 2 * np.vdot(rows, pull) + np.vdot(squares, gram))
    model = replace(
        model,
        loadings=np.ascontiguousarray(rows[:, :, :r]),
        means=np.ascontiguousarray(rows[:, :, r]),
        covariance=uncertain,
        relevance=relevance,
        coefficients=mean,
    )
    return model, deviation


def _deviations(model: Model, tracks: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(F, n) expected squared deviation of every entry, x and y together, at the rows' means."""
    rest = tracks - model.predict(model.coefficients)
    return np.einsum("fin,fin->fn", rest, rest) + spread_of_fit(model, covariance)


def fit(
    model: Model,
    tracks: np.ndarray,
    seen: np.ndarray,
    *,
    robust: bool,
    iterations: int,
    change: float,
    weights: np.ndarray | None = None,
    settle: int = 0,
) -> tuple[Model, np.ndarray, np.ndarray, int]:
    """Iterate to a fixed point.

    Parameters
    ----------
    model
        Where to start.
    tracks
        (F, 2, n), of unit rms, zero where not seen.
    seen
        (F, n) 1.0 where seen, 0.0 elsewhere.
    robust
        Student's t noise in place of Gaussian.
    iterations
        At most so many.
    change
        Stop when log σ² changes by less than this.
    weights
        (F, n) weights to start from; default ``seen``.
    settle
        At least so many iterations where σ² is the smallest there is.

    Returns
    -------
    The model, the points' covariances (n, r, r), the weights (F, n) and the number of iterations.
    """
    weights = seen if weights is None else weights
    total = 2.0 * seen.sum()
    covariance = np.empty(0)
    done = 0
    for _ in range(max(iterations, settle)):
        done += 1
        mean, covariance = infer(model, tracks, weights)
        model, mean, covariance = _centred(model, mean, covariance)
        before = model.variance
        model, deviation = _rows(model, tracks, weights, mean, covariance)
        variance = max(deviation / total, LEAST**2)
        model = replace(model, variance=variance)
        if robust:
            weights = seen * robust_weights(_deviations(model, tracks, covariance), variance)
        # At the smallest noise the rows still move, though σ² does not show it.
        if variance <= LEAST**2 and done < settle:
            continue
        if abs(np.log(variance / before)) < change or done >= iterations:
            break
    return model, covariance, weights, done
