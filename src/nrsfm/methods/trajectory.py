"""Shapes whose coefficients move smoothly: bases of trajectories, the motion matrix, variable projection, choosing K.

The model shared by ``pta``, ``csf1``, ``csf2`` and ``ksta``: S_f = Σ_k c_fk B_k with coefficients C = ΩX (F×K), Ω (F×d)
a fixed basis of orthonormal columns and X (d×K) unknown. Then W = MB with the motion matrix M = R(C ⊗ I₃) (2F×3K), and
for given X the best shapes are B = M⁺W. What is left is variable projection over X:

    minimise over X   ½‖(I − MM⁺)W‖²_F.

W enters only through products from the left and W Wᵀ, so all of it runs on the compressed W exactly.

Gauss-Newton: with Kaufman's approximation the derivative by X_ik is −(I − MM⁺)(∂M/∂X_ik)B, and row block f of
(∂M/∂X_ik)B is Ω_fi R_f B_k. Its normal matrix needs neither W nor a Jacobian of 2F·N rows:

    H_(ik)(jl) = Σ_ab (N_ij − T_iᵀT_j)_ab (B_k B_lᵀ)_ab,   N_ij = Σ_f Ω_fi Ω_fj R_fᵀR_f,   T_i = Qᵀ R(Ω_i ⊗ I₃),

Q an orthonormal basis of the range of M; the gradient, g_ik = −Σ_f Ω_fi ⟨R_f B_k, E_f⟩ with E = (I − MM⁺)W, is exact.
Only the range of X matters, so X is made orthonormal after every step, and damping takes care of the K² free
directions.
Source: Golub and Pereyra 1973; Kaufman 1975; the model is that of Gotardo and Martinez, PAMI 33(10), 2011.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.methods.base import Solution

SINGULAR = 1e-9  # singular values of M below this share of the largest count as zero
EXACT = 1e-26  # a share of ‖W‖² that is zero to rounding
LARGEST_DAMPING = 1e8
NORM_TOLERANCE = 0.03
LOG_TOLERANCE = 1e-4  # exact data are explained by every larger K as well


def dct_basis(frames: int, size: int) -> np.ndarray:
    """The first ``size`` vectors of the orthonormal discrete cosine transform (DCT-II) of F frames, (F, size)."""
    time = (2 * np.arange(frames) + 1)[:, None]
    basis = np.cos(np.pi / (2 * frames) * time * np.arange(size)) * np.sqrt(2.0 / frames)
    basis[:, 0] /= np.sqrt(2.0)
    return basis


def motion_matrix(rotations: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """M = R(C ⊗ I₃), (2F, 3K), of rotations (F, 2, 3) and coefficients (F, K); columns shape by shape."""
    return (rotations[:, :, None] * coefficients[:, None, :, None]).reshape(2 * len(rotations), -1)


def shapes_from(coefficients: np.ndarray, bases: np.ndarray) -> np.ndarray:
    """S_f = Σ_k c_fk B_k, (F, 3, N), from coefficients (F, K) and bases (3K, N)."""
    frames, rank = coefficients.shape
    return (coefficients @ bases.reshape(rank, -1)).reshape(frames, 3, -1)


def factor_motion(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Q (2F, q), orthonormal in the range of M, and M⁺Q (3K, q); q < 3K where M is singular (a camera at rest)."""
    basis, upper = np.linalg.qr(matrix)
    left, values, right = np.linalg.svd(upper)
    live = values > SINGULAR * max(float(values[0]), np.finfo(float).tiny)
    return basis @ left[:, live], right[live].T / values[live]


def project(rotations: np.ndarray, coefficients: np.ndarray, flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bases B = M⁺W (3K, N) for given coefficients, and the residual (I − MM⁺)W; ``flat`` is W (2F, N)."""
    span, inverse = factor_motion(motion_matrix(rotations, coefficients))
    inside = span.T @ flat
    return inverse @ inside, flat - span @ inside


@dataclass(frozen=True)
class Fit:
    """Shapes (F, 3, N) of one K, the unknowns X (d, K), and the energy ½‖W − RS‖² after every iteration."""

    rank: int
    shapes: np.ndarray
    unknowns: np.ndarray
    energies: list[float]
    reason: str

    def solution(self, chosen: dict[str, Any], warnings: list[str]) -> Solution:
        """What a method returns that keeps this fit."""
        history = {"energy": self.energies}
        return Solution(self.shapes, None, len(self.energies), self.reason, history, chosen, warnings)


@dataclass(frozen=True)
class _Point:
    """The objective at one X: Q and M⁺Q of the motion matrix, QᵀW, the residual E and the energy ½‖E‖²."""

    unknowns: np.ndarray
    span: np.ndarray
    inverse: np.ndarray
    inside: np.ndarray
    residual: np.ndarray
    energy: float


class VariableProjection:
    """½‖(I − MM⁺)W‖² as a function of X, its gradient and its Gauss-Newton matrix."""

    def __init__(self, rotations: np.ndarray, flat: np.ndarray, basis: np.ndarray) -> None:
        """``rotations`` (F, 2, 3), ``flat`` W (2F, N), ``basis`` Ω (F, d)."""
        self.rotations, self.flat, self.basis = rotations, flat, basis
        views = rotations.transpose(0, 2, 1) @ rotations
        size = basis.shape[1]
        weighted = (views[:, :, None, :] * basis[:, None, :, None]).reshape(len(views), -1)
        gram = (basis.T @ weighted).reshape(size, 3, size, 3)  # [i, a, j, b]
        self._constant = np.ascontiguousarray(gram.transpose(0, 2, 1, 3)).reshape(size * size, 9)

    def at(self, unknowns: np.ndarray) -> _Point:
        """Evaluate at X (d, K)."""
        span, inverse = factor_motion(motion_matrix(self.rotations, self.basis @ unknowns))
        inside = span.T @ self.flat
        residual = self.flat - span @ inside
        return _Point(unknowns, span, inverse, inside, residual, 0.5 * float(np.sum(residual * residual)))

    def normal(self, point: _Point) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix (dK, dK) and gradient (dK,), in the order of X's entries, row by row."""
        frames, (size, rank) = len(self.rotations), point.unknowns.shape
        bases = point.inverse @ point.inside
        products = (bases @ bases.T).reshape(rank, 3, rank, 3)
        seen = point.span.reshape(frames, 2, -1).transpose(0, 2, 1) @ self.rotations  # QᵀR of every frame, (F, q, 3)
        turned = (self.basis.T @ seen.reshape(frames, -1)).reshape(size, -1, 3)
        stacked = np.ascontiguousarray(turned.transpose(0, 2, 1)).reshape(3 * size, -1)
        inner = (stacked @ stacked.T).reshape(size, 3, size, 3).transpose(0, 2, 1, 3).reshape(size * size, 9)
        blocks = (self._constant - inner) @ products.transpose(1, 3, 0, 2).reshape(9, -1)
        hessian = blocks.reshape(size, size, rank, rank).transpose(0, 2, 1, 3).reshape(size * rank, size * rank)
        along = (point.residual @ bases.T).reshape(frames, 2, rank, 3)
        gradient = -self.basis.T @ np.einsum("frka,fra->fk", along, self.rotations)
        return np.ascontiguousarray(hessian), gradient.ravel()

    def minimise(self, unknowns: np.ndarray, *, iterations: int, tolerance: float) -> Fit:
        """Damped Gauss-Newton from X (d, K); stops when an iteration gains less than ``tolerance`` of the energy."""
        point = self.at(np.linalg.qr(unknowns)[0])
        floor = 0.5 * EXACT * float(np.sum(self.flat * self.flat))
        energies, damping, reason = [point.energy], 1e-3, "iteration limit"
        hessian, gradient = self.normal(point)
        for _ in range(iterations):
            if point.energy <= floor:
                reason = "exact"
                break
            step = damped_step(hessian, gradient, damping)
            fresh = self.at(np.linalg.qr(point.unknowns - step.reshape(unknowns.shape))[0])
            if fresh.energy < point.energy:
                gain = 1.0 - fresh.energy / point.energy
                point, damping = fresh, max(damping / 5.0, 1e-12)
                energies.append(point.energy)
                if gain < tolerance:
                    reason = "energy"
                    break
                hessian, gradient = self.normal(point)
            else:
                damping *= 4.0
                if damping > LARGEST_DAMPING:
                    reason = "no step lowers the energy"
                    break
        shapes = shapes_from(self.basis @ point.unknowns, point.inverse @ point.inside)
        return Fit(unknowns.shape[1], shapes, point.unknowns, energies, reason)


def damped_step(hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    """(H + λ·(mean of H's diagonal)·I)⁻¹ g; zero where H is."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    mean = float(np.trace(hessian)) / len(hessian)
    if mean <= 0:
        return np.zeros_like(gradient)
    damped = hessian.copy()
    damped.flat[:: len(damped) + 1] += damping * mean
    try:
        step: np.ndarray = cho_solve(cho_factor(damped, overwrite_a=True, check_finite=False), gradient)
    except LinAlgError:  # rounding made the singular directions negative: a gradient step is taken along them
        values, vectors = np.linalg.eigh(hessian)
        step = vectors @ ((vectors.T @ gradient) / (np.maximum(values, 0.0) + max(damping, 1e-9) * mean))
    return step


def sharpness(rotations: np.ndarray, flat: np.ndarray, shapes: np.ndarray) -> tuple[float, float]:
    """How simple the shapes are that these become when they are made to reproject exactly: ``norm`` and ``log``.

    S̃ = S + Rᵀ(W − RS) explains W whatever K is, so that one number compares them: too few degrees of freedom leave
    a residual in the image plane that turns with the camera, too many invent depth; both raise the nuclear
    norm ‖S̃♯‖_*/‖W‖. ``log`` = mean log(σ_i + 10⁻³σ₁) rewards a sharp fall of its singular values, as
    in :mod:`nrsfm.cameras.selection`.
    """
    tracks = flat.reshape(len(rotations), 2, -1)
    complete = shapes + rotations.transpose(0, 2, 1) @ (tracks - rotations @ shapes)
    rows = complete.reshape(len(complete), -1)
    gram = rows @ rows.T if len(rows) <= rows.shape[1] else rows.T @ rows
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0))
    total = float(np.linalg.norm(flat))
    if total <= 0 or values[0] <= 0:
        return 0.0, 0.0
    return float(values.sum()) / total, float(np.mean(np.log((values + 1e-3 * values[0]) / total)))


@dataclass(frozen=True)
class Candidate:
    """One fit that is compared: its two criteria (see :func:`sharpness`) and what was varied besides K."""

    fit: Fit
    norm: float
    log: float
    setting: float = 0.0


def judge(rotations: np.ndarray, flat: np.ndarray, fit: Fit, setting: float = 0.0) -> Candidate:
    """The candidate of a fit."""
    return Candidate(fit, *sharpness(rotations, flat, fit.shapes), setting)


def choose(candidates: list[Candidate]) -> Candidate:
    """Of the candidates whose norm is within 3% of the least, the one of least ``log``; of equals the least K."""
    least = min(c.norm for c in candidates)
    close = [c for c in candidates if c.norm <= (1.0 + NORM_TOLERANCE) * least]
    sharpest = min(c.log for c in close)
    return min((c for c in close if c.log <= sharpest + LOG_TOLERANCE), key=lambda c: c.fit.rank)


def try_ranks(ranks: list[int], fit: Callable[[int], Candidate]) -> list[Candidate]:
    """Candidates for growing K, until two in a row have a norm 10% above the least: larger K only invent more depth."""
    found: list[Candidate] = []
    for rank in ranks:
        found.append(fit(rank))
        least = min(c.norm for c in found)
        if len(found) > 1 and all(c.norm > 1.1 * least for c in found[-2:]):
            break
    return found


def rank_limit(frames: int, points: int, size: int) -> tuple[int, int]:
    """Largest K that M can have full rank for, and the largest that can be of use to N virtual points.

    M is 2F×3K and C = ΩX has d columns to choose from. W has rank ≤ N, which K ≥ N/3 shapes explain entirely.
    """
    possible = max(1, min(2 * frames // 3, size))
    return possible, max(1, min(possible, -(-points // 3)))


def clamped(value: int, limit: int, name: str, why: str) -> tuple[int, list[str]]:
    """``value`` or the limit, and a warning where it is the limit."""
    if value <= limit:
        return value, []
    return limit, [f"{name} {value} is more than {why} allow: {limit} is used"]
