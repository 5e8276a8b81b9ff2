"""Refinement by the likelihood of a Gaussian over trajectories: cameras, motion and shapes, rank and basis left open.

The shape of a point over time is its mean position a plus a deformation d, and every point is a sample of it:

    w = H(R)(1 ⊗ a + d) + n,   a ~ N(0, A₀),   d ~ N(0, v_k A ⊗ T),   n ~ N(0, s² I)

T (F×F) says how far each frame deforms and which frames deform alike, A (3×3, trace 3) in which directions of the
object, v_k how much cell k does. Shapes are integrated out, so that only the covariance C of a track is left, and with
M (2F×3) the stacked camera rows, Ĝ the tracks' second moment (2F×2F) and ∘ the entrywise product,

    minimise over R, T, A, A₀   log det C + tr(C⁻¹Ĝ) + ν h(T) + ν_A h(A) + λ Σ_f ‖R_f − R_f⁰‖²,
    C = (M A Mᵀ) ∘ (T ⊗ 1₂ₓ₂) + M A₀ Mᵀ + s² I,   Ĝ = Σ_k ω_k G_k,   ω_k ∝ P_k v_k^(−1/2)

h(X) = n log(tr X⁻¹/n) + log det X ≥ 0 vanishes for multiples of I, whatever their size, and charges for what stands out
only: frames are thought unrelated until the tracks say otherwise. R⁰ are the cameras given. v_k is the restricted
likelihood's estimate (mean integrated out with a flat prior), and ω_k lets calm cells say more of the cameras.
Minimised by L-BFGS with analytic gradients; one step costs O(F³), whatever P.

Then each cell gets its own T_k, by expectation-maximisation of its likelihood with a prior that weighs as much as
``LOCAL_PRIOR`` times the cell's own points at v_k T, and its shapes are the posterior mean. With Φ the sums over 2×2
blocks of C⁻¹(G_k − C)C⁻¹ ∘ (M A Mᵀ) the step is T_k ← (T_k + T_k Φ T_k/3 + ν_k v_k T)/(1 + ν_k).

Why it beats the nuclear norm: that is the minimum over T of the same model's *joint* likelihood of shapes and T, which
shrinks depth and has no say in the cameras. Integrated out, shapes do not shrink, cameras come from the same objective,
and C is fitted to F(2F + 1) moments, each a mean over all points.

Ours. Related: probabilistic principal component analysis for non-rigid structure from motion (Torresani, Hertzmann and
Bregler, TPAMI 30, 2008), which is Gaussian over frames with a chosen rank, where this is Gaussian over points; shape
trajectory duality (Akhter, Sheikh, Khan and Kanade, TPAMI 33, 2011). Restricted likelihood: Patterson and Thompson,
Biometrika 58, 1971.

On the compression it is exact: tracks enter by G_k = L_k L_kᵀ/P_k alone, and shapes are linear in the tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.manifolds.quaternions import turn_gradient, turned_rows
from nrsfm.manifolds.rotations import whole_rotations
from nrsfm.methods.base import Problem

LARGEST_FRAMES = 200
"""More frames are left as they are: F³ per evaluation, and other methods do well there."""

LEAST_TURN = 5.0
"""Degrees between viewing directions below which there is no depth to refine."""

UNRELATED, EVEN, NEAR_CAMERAS, LOCAL_PRIOR = 0.3, 1.0, 3.0, 0.3
"""ν, ν_A, λ and ν_k: weights relative to one track. Tuned as docs/decisions.md says."""

NOISE_LEFT, LEAST_NOISE = 0.1, 2e-3
"""s: the share of the noise that ten frames keep after cells were shrunk, growing with √F, and its least value in units
of the tracks' rms. With few frames the prior needs every digit of the tracks, with many it tells noise from motion."""

REWEIGHTINGS = 2

CONVERGED_FRAMES = 30
"""With more frames the bound on steps is met before the objective settles, and its first coordinates do better."""

_MEAN_SPREAD = 4.0  # within a cell the mean position is left almost free
_LEAST_SPREAD = 1e-3  # of v_k, relative to their mean
_FRAMES = 10  # what the constants above were tuned for
_FLOOR = 1e-8  # least eigenvalue of T: deformation of 1e-4 of the tracks' rms, far below any noise


@dataclass(frozen=True)
class Model:
    """The Gaussian: ``rows`` (F, 2, 3) cameras, T (F, F), A and A₀ (3, 3), s², and v_k (K,) after a fit."""

    rows: np.ndarray
    frames: np.ndarray
    directions: np.ndarray
    mean: np.ndarray
    noise: float
    spreads: np.ndarray
    cost: float = float("inf")
    steps: int = 0

    @property
    def stacked(self) -> np.ndarray:
        """M (2F, 3)."""
        return self.rows.reshape(-1, 3)


def applies(problem: Problem) -> str | None:
    """Why :func:`refine` would leave the problem as it is, or None."""
    frames = len(problem.tracks)
    if frames > LARGEST_FRAMES:
        return f"{frames} frames are more than {LARGEST_FRAMES}"
    if problem.points < 3 * frames:
        return f"{problem.points} points are fewer than 3 for each of {frames} frames"
    rows = problem.rotations
    views = np.cross(rows[:, 0], rows[:, 1])
    if float((views @ views.T).min()) > np.cos(np.radians(LEAST_TURN)):
        return f"the camera turns by less than {LEAST_TURN:g} degrees"
    return None


def refine(problem: Problem, start_shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Shapes and cameras of greatest likelihood, from any first shapes.

    Parameters
    ----------
    problem
        Cells of tracks, shrunk for the noise by the compression; one cell is enough where all move alike. Its
        rotations are the start, and stay as they are where ``cameras_known``.
    start_shapes
        (F, 3, N) in the object frame of ``problem.rotations``; returned as they are where :func:`applies` says why.

    Returns
    -------
    Shapes (F, 3, N), cameras (F, 2, 3), and a dict: ``applied``, ``reason`` (where not), ``steps``, ``cost`` (the
    objective), ``turned`` (largest angle in degrees by which a camera moved), ``noise`` (s), ``spreads`` (v_k).
    """
    reason = applies(problem)
    if reason is not None:
        return start_shapes, problem.rotations, {"applied": False, "reason": reason}
    moments, sizes = cell_moments(problem)
    model = first_model(problem, start_shapes)
    steps = 0
    weights = sizes / sizes.sum()
    frames, moves = len(start_shapes), not problem.cameras_known
    for turn in range(REWEIGHTINGS + 1):
        moment, last = np.einsum("k,kij->ij", weights, moments), turn == REWEIGHTINGS
        limit, near = most_steps(frames, last=last), last and frames <= CONVERGED_FRAMES
        model = fit(model, moment, problem.rotations, move_cameras=moves, limit=limit, near=near)
        steps += model.steps
        model = with_spreads(model, moments)
        weights = sizes / np.sqrt(model.spreads)
        weights = weights / weights.sum()
    shapes = np.empty_like(start_shapes)
    covariances = local_covariances(model, moments)
    for k, (a, b) in enumerate(zip(problem.offsets[:-1], problem.offsets[1:], strict=True)):
        shapes[:, :, a:b] = posterior_mean(model, covariances[k], problem.tracks[:, :, a:b])
    # Numbers alone tell a failed fit: what the objective prefers is not harmful because it differs from the start.
    if not (np.isfinite(shapes).all() and np.isfinite(model.cost)):
        return start_shapes, problem.rotations, {"applied": False, "reason": "not finite"}
    info = {
        "applied": True,
        "steps": steps,
        "cost": model.cost,
        "turned": _largest_turn(model.rows, problem.rotations),
        "noise": float(np.sqrt(model.noise)),
        "spreads": model.spreads.tolist(),
    }
    return shapes, model.rows, info


def most_steps(frames: int, *, last: bool) -> int:
    """Bound on L-BFGS steps: long sequences are settled earlier, and a step costs F³."""
    return int(np.clip(12_000 // frames, 120, 300) if last else np.clip(6_000 // frames, 60, 100))


def cell_moments(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """G_k (K, 2F, 2F), mean over the real points of each cell of w wᵀ, and their numbers P_k (K,)."""
    flat = problem.tracks.reshape(2 * len(problem.tracks), -1)
    pairs = zip(problem.offsets[:-1], problem.offsets[1:], problem.sizes, strict=True)
    moments = np.stack([flat[:, a:b] @ flat[:, a:b].T / n for a, b, n in pairs])
    return moments, problem.sizes.astype(np.float64)


def first_model(problem: Problem, shapes: np.ndarray) -> Model:
    """T and A₀ as the first shapes (F, 3, N) have them, A = I."""
    frames, points = len(shapes), problem.points
    mean = shapes.mean(axis=0)
    change = (shapes - mean).reshape(frames, -1)
    covariance = change @ change.T / (3 * points)
    level = max(float(np.trace(covariance)) / frames, LEAST_NOISE**2)
    # The first shapes are smoother than the truth, and their mean is in all of them: some of it is put back.
    covariance = 0.7 * covariance + 0.3 * level * np.eye(frames)
    spread = mean @ mean.T / points
    spread = spread + 1e-3 * max(float(np.trace(spread)), LEAST_NOISE**2) * np.eye(3)
    noise = max(NOISE_LEFT * np.sqrt(frames / _FRAMES) * problem.noise, LEAST_NOISE) ** 2
    return Model(problem.rotations, covariance, np.eye(3), spread, noise, np.ones(len(problem.sizes)))


def track_covariance(model: Model, frames: np.ndarray | None = None, spread: float = 1.0) -> np.ndarray:
    """C (2F, 2F), or one for each T given as (..., F, F); A₀ is multiplied by ``spread``."""
    stacked = model.stacked
    turned = stacked @ model.directions @ stacked.T
    doubled = _unfold(model.frames if frames is None else frames)
    return turned * doubled + spread * (stacked @ model.mean @ stacked.T) + model.noise * np.eye(len(stacked))


def fit(
    model: Model, moment: np.ndarray, anchor: np.ndarray, *, move_cameras: bool, limit: int, near: bool = False
) -> Model:
    """L-BFGS on the objective of this module's head, from ``model``, for Ĝ = ``moment`` (2F, 2F)."""
    from scipy.optimize import minimize

    objective = Objective(model, moment, anchor, move_cameras=move_cameras, near=near)
    found = minimize(
        objective,
        objective.start,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": limit, "maxfun": 2 * limit, "maxcor": 20, "ftol": 1e-9, "gtol": 1e-7},
    )
    return objective.model(found.x, float(found.fun), int(found.nit))


class Objective:
    """Value and gradient over one vector: turns of the cameras as quaternions, factors of T, A₀ and A.

    ``near``: in coordinates in which the objective curves about alike in every direction near the model given: T =
    (L Y)(L Y)ᵀ with L the factor of the T given (A₀ and A likewise), quaternions the longer the less a frame deforms.
    These converge faster, but far from the optimum they let small eigenvalues of T hardly grow.
    """

    def __init__(
        self, model: Model, moment: np.ndarray, anchor: np.ndarray, *, move_cameras: bool, near: bool = False
    ) -> None:
        self.given, self.moment, self.anchor, self.moves = model, moment, anchor, move_cameras
        frames = len(model.rows)
        self.frames = frames
        first = [np.linalg.cholesky(matrix) for matrix in (model.frames, model.mean, model.directions)]
        even = [np.eye(len(factor)) for factor in first]
        self._factors: list[np.ndarray] = first if near else even
        changes = even if near else first
        still = np.zeros((frames if move_cameras else 0, 4))
        still[:, 0] = 2.0 / np.sqrt(np.diagonal(model.frames))[: len(still)] if near else 1.0
        parts = [still, *changes]
        self.start = np.concatenate([part.ravel() for part in parts])
        self._cuts = np.cumsum([part.size for part in parts])[:-1]

    def _parts(self, vector: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """Turns (F, 4), and the factors of T, A₀ and A."""
        turns, *changes = np.split(vector, self._cuts)
        return turns.reshape(-1, 4), [
            factor @ change.reshape(factor.shape) for factor, change in zip(self._factors, changes, strict=True)
        ]

    def model(self, vector: np.ndarray, cost: float = float("inf"), steps: int = 0) -> Model:
        """The model that a vector stands for."""
        turns, (frames, mean, directions) = self._parts(vector)
        rows = turned_rows(self.given.rows, turns) if self.moves else self.given.rows
        covariance = frames @ frames.T + _FLOOR * np.eye(self.frames)
        given = self.given
        return Model(
            rows, covariance, directions @ directions.T, mean @ mean.T, given.noise, given.spreads, cost, steps
        )

    def __call__(self, vector: np.ndarray) -> tuple[float, np.ndarray]:
        """The objective and its gradient."""
        turns, factors = self._parts(vector)
        model = self.model(vector)
        stacked = model.stacked
        doubled = _unfold(model.frames)
        turned = stacked @ model.directions @ stacked.T
        covariance = track_covariance(model)
        try:
            lower = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:  # a step beyond floating point: the line search shortens it
            return 1e12, np.zeros_like(vector)
        inverse = np.linalg.inv(covariance)
        fitted = inverse @ self.moment
        value = 2.0 * float(np.log(np.diagonal(lower)).sum()) + float(np.trace(fitted))
        slope = inverse - fitted @ inverse  # of C
        slope = (slope + slope.T) / 2.0
        masked = slope * doubled
        by_frames, by_directions = _fold(slope * turned), stacked.T @ masked @ stacked
        for weight, matrix, gradient in (
            (UNRELATED, model.frames, by_frames),
            (EVEN, model.directions, by_directions),
        ):
            penalty, change = unevenness(matrix)
            value += weight * penalty
            gradient += weight * change
        # T and A share one scale; this fixes it, at no cost to the rest.
        excess = float(np.trace(model.directions)) - 3.0
        value += 0.1 * excess**2
        by_directions += 0.2 * excess * np.eye(3)
        by_mean = stacked.T @ slope @ stacked
        gradients = [
            2.0 * given.T @ by @ factor
            for given, by, factor in zip(self._factors, (by_frames, by_mean, by_directions), factors, strict=True)
        ]
        if self.moves:
            gap = model.rows - self.anchor
            value += NEAR_CAMERAS * float(np.sum(gap * gap))
            by_rows = 2.0 * (masked @ stacked @ model.directions + slope @ stacked @ model.mean)
            by_rows = by_rows.reshape(gap.shape) + 2.0 * NEAR_CAMERAS * gap
            gradients.insert(0, turn_gradient(self.given.rows, turns, by_rows))
        return value, np.concatenate([gradient.ravel() for gradient in gradients])


def unevenness(matrix: np.ndarray) -> tuple[float, np.ndarray]:
    """h(X) = n log(tr X⁻¹/n) + log det X of a positive definite X (n, n), and its gradient."""
    inverse = np.linalg.inv(matrix)
    size, total = len(matrix), float(np.trace(inverse))
    value = size * float(np.log(total / size)) + float(np.linalg.slogdet(matrix)[1])
    return value, inverse - (size / total) * (inverse @ inverse)


def with_spreads(model: Model, moments: np.ndarray) -> Model:
    """v_k: mean square of cell k's tracks under the model of the deformation, its mean taken out as free."""
    stacked = model.stacked
    turned = stacked @ model.directions @ stacked.T
    inverse = np.linalg.inv(turned * _unfold(model.frames) + model.noise * np.eye(len(stacked)))
    seen = inverse @ stacked
    restricted = inverse - seen @ np.linalg.pinv(stacked.T @ seen, hermitian=True) @ seen.T
    spreads = np.einsum("ij,kij->k", restricted, moments) / max(len(stacked) - 3, 1)
    spreads = np.maximum(spreads, max(_LEAST_SPREAD * float(spreads.mean()), np.finfo(float).tiny))
    return replace(model, spreads=spreads)


def local_covariances(model: Model, moments: np.ndarray) -> np.ndarray:
    """T_k (K, F, F) of each cell."""
    prior = model.spreads[:, None, None] * model.frames
    stacked = model.stacked
    turned = stacked @ model.directions @ stacked.T
    out = prior
    for _ in range(int(np.clip(300 // len(model.frames), 5, 30))):
        covariance = track_covariance(model, out, _MEAN_SPREAD)
        inverse = np.linalg.inv(covariance)
        lacking = inverse @ (moments - covariance) @ inverse
        out = (out + out @ _fold(lacking * turned) @ out / 3.0 + LOCAL_PRIOR * prior) / (1.0 + LOCAL_PRIOR)
        out = (out + np.swapaxes(out, 1, 2)) / 2.0
    return out


def posterior_mean(model: Model, frames: np.ndarray, tracks: np.ndarray) -> np.ndarray:
    """Expected shapes (F, 3, n) of tracks (F, 2, n) of a cell whose T_k is ``frames``."""
    count = len(frames)
    covariance = track_covariance(model, frames, _MEAN_SPREAD)
    pull = np.linalg.solve(covariance, tracks.reshape(2 * count, -1)).reshape(count, 2, -1)
    seen = np.swapaxes(model.rows, 1, 2) @ pull  # (F, 3, n)
    change = model.directions @ np.einsum("fg,gcn->fcn", frames, seen, optimize=True)
    return np.asarray(change + _MEAN_SPREAD * (model.mean @ seen.sum(axis=0)))


def _unfold(frames: np.ndarray) -> np.ndarray:
    """T ⊗ 1₂ₓ₂, (..., 2F, 2F)."""
    return np.repeat(np.repeat(frames, 2, axis=-1), 2, axis=-2)


def _fold(matrix: np.ndarray) -> np.ndarray:
    """Sums over 2×2 blocks of (..., 2F, 2F): (..., F, F)."""
    half = matrix[..., 0::2, :] + matrix[..., 1::2, :]
    return np.asarray(half[..., 0::2] + half[..., 1::2])


def _largest_turn(rows: np.ndarray, before: np.ndarray) -> float:
    cosine = (np.einsum("fij,fij->f", whole_rotations(rows), whole_rotations(before)) - 1.0) / 2.0
    return float(np.degrees(np.arccos(np.clip(cosine.min(), -1.0, 1.0))))
