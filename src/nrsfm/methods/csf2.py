"""CSF2: complementary rank-3 spaces, shapes added one at a time, each explaining what the ones before left over.

minimise over X   ½‖E_K‖²_F,   E_k = (I − P_k)E_{k−1},  E_0 = W,   P_k = M_k M_k⁺,  M_k = R(c_k ⊗ I₃),  c_k = Ωx_k
B_k = M_k⁺E_{k−1},   S_f = Σ_k c_fk B_k,   Ω (F×d) the first d vectors of the DCT

The general rank-3K factor of ``csf1`` takes B = M⁺W for all K shapes at once, which invents large shapes that cancel
where M is nearly singular. Here B_k is what one rank-3 space holds of the residual, so no B_k is larger than what
it explains. Adding: x_k starts as the single cosines that lower ‖E_k‖ most and is fitted alone by variable projection;
then all x_1 .. x_k are refined together.

With A_k = (I − P_K) ⋯ (I − P_k), the derivative of E_K by X_ik is

    −A_k (Ω_i ∘ R) B_k − V_k (Ω_i ∘ R)ᵀE_k,   V_k = A_{k+1}(M_k⁺)ᵀ,

(Ω_i ∘ R) the three columns of D = R(Ω ⊗ I₃) that belong to Ω_i. Its normal matrix needs D, DᵀD, DᵀE_k and low-rank
terms only: A_k = I − Σ_{j≥k} z_j Q_jᵀ with z_j = A_{j+1}Q_j. Unlike in ``csf1`` both terms are kept: without the second
the gradient of all spaces but the last would be wrong, and the residuals reached were 12 to 18% larger.

Source: Gotardo and Martinez, "Non-rigid structure from motion with complementary rank-3 spaces", CVPR 2011: the
model, K complementary rank-3 spaces in place of a rank-3K factor, found one after another. Departures: what was at hand
of it is the idea, not the iteration; the nested projections, their joint refinement (the greedy fit alone: pickup
.049 against .018) and the choice of K and d are ours. Complete tracks only.
Runs on the exact compression: the objective sees W only through WWᵀ, and S is linear in W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.methods.csf1 import default_basis_size
from nrsfm.methods.trajectory import (
    EXACT,
    LARGEST_DAMPING,
    Fit,
    VariableProjection,
    choose,
    clamped,
    damped_step,
    dct_basis,
    factor_motion,
    judge,
    motion_matrix,
    rank_limit,
    shapes_from,
)
from nrsfm.options import option

LARGEST_RANK = 12
STARTS, TRIED_COSINES = 3, 40
BLOCK_ITERATIONS, BLOCK_TOLERANCE = 20, 1e-4


@dataclass(frozen=True)
class Csf2Options:
    """Options of :class:`Csf2`."""

    rank: int | None = option(
        None,
        "Number of rank-3 spaces. Default: of 1 to 12 the one whose shapes, made to reproject exactly, are simplest "
        "(nuclear norm within 3% of the least, then least mean logarithm of the singular values).",
        symbol="K",
        minimum=1,
    )
    basis_size: int | None = option(
        None,
        "Number of cosines that the coefficients of the shapes are made of. Default: a tenth of the frames, at least "
        "30 or all frames.",
        symbol="d",
        minimum=1,
    )
    least_gain: float = option(1e-4, "Stop when an iteration lowers the energy by less than this share.", above=0)
    max_iterations: int = option(30, "Upper bound on joint iterations after each added space.", minimum=1)


@dataclass(frozen=True)
class _Chain:
    """The nested projections at one X: Q_k (2F, 3), M_k⁺Q_k, B_k (3, N), all residuals E_k, the energy ½‖E_K‖²."""

    unknowns: np.ndarray
    spans: list[np.ndarray]
    inverses: list[np.ndarray]
    bases: list[np.ndarray]
    residuals: list[np.ndarray]
    energy: float


class NestedProjection:
    """½‖E_K‖² as a function of X (d, K), its gradient and its Gauss-Newton matrix."""

    def __init__(self, rotations: np.ndarray, flat: np.ndarray, basis: np.ndarray) -> None:
        """``rotations`` (F, 2, 3), ``flat`` W (2F, N), ``basis`` Ω (F, d)."""
        self.rotations, self.flat, self.basis = rotations, flat, basis
        self.design = motion_matrix(rotations, basis)  # D, columns (i, a)
        self.gram = self.design.T @ self.design

    def at(self, unknowns: np.ndarray) -> _Chain:
        """Evaluate at X (d, K)."""
        residual, spans, inverses, bases, residuals = self.flat, [], [], [], []
        for column in (self.basis @ unknowns).T:
            span, inverse = factor_motion(motion_matrix(self.rotations, column[:, None]))
            inside = span.T @ residual
            residual = residual - span @ inside
            spans.append(span)
            inverses.append(inverse)
            bases.append(inverse @ inside)
            residuals.append(residual)
        energy = 0.5 * float(np.sum(residual * residual))
        return _Chain(unknowns, spans, inverses, bases, residuals, energy)

    def normal(self, chain: _Chain) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix JᵀJ (Kd, Kd) and gradient (Kd,), shape by shape."""
        size, rank = chain.unknowns.shape
        left = right = np.zeros((len(self.flat), 0))
        ends, across = [0] * rank, [left] * rank
        # From the last factor to the first: A_k = A_{k+1} − (A_{k+1}Q_k)Q_kᵀ, so A_k = I − left rightᵀ.
        for k in reversed(range(rank)):
            span = chain.spans[k]
            moved = span - left @ (right.T @ span)
            across[k] = moved @ chain.inverses[k].T  # V_k
            left, right = np.hstack([left, moved]), np.hstack([right, span])
            ends[k] = left.shape[1]
        x, y, inner = left.T @ self.design, right.T @ self.design, left.T @ left
        seen = [self.design.T @ residual for residual in chain.residuals]  # DᵀE_k
        along = [self.design - left[:, :m] @ y[:m] for m in ends]  # A_k D
        last = chain.residuals[-1]
        hessian, gradient = np.empty((rank, size, rank, size)), np.empty((rank, size))
        for k in range(rank):
            m = ends[k]
            pulled = along[k].T @ (last @ chain.bases[k].T) + seen[k] @ (last.T @ across[k])
            gradient[k] = -np.einsum("iaa->i", pulled.reshape(size, 3, 3))
            for j in range(k, rank):
                n = ends[j]
                product = self.gram - x[:n].T @ y[:n] - y[:m].T @ (x[:m] - inner[:m, :n] @ y[:n])  # (A_kD)ᵀA_jD
                block = _contracted(product, chain.bases[k] @ chain.bases[j].T)
                block += _contracted(seen[k] @ seen[j].T, across[k].T @ across[j])
                block += _crossed(along[k].T @ across[j], seen[j] @ chain.bases[k].T)
                block += _crossed(along[j].T @ across[k], seen[k] @ chain.bases[j].T).T
                hessian[k, :, j], hessian[j, :, k] = block, block.T
        return hessian.reshape(rank * size, rank * size), gradient.ravel()

    def minimise(self, unknowns: np.ndarray, *, iterations: int, tolerance: float) -> tuple[_Chain, list[float], str]:
        """Damped Gauss-Newton from X (d, K), its columns of length 1; the chain, its energies, the reason to stop."""
        chain = self.at(unknowns / np.linalg.norm(unknowns, axis=0))
        floor = 0.5 * EXACT * float(np.sum(self.flat * self.flat))
        energies, damping, reason = [chain.energy], 1e-3, "iteration limit"
        hessian, gradient = self.normal(chain)
        for _ in range(iterations):
            if chain.energy <= floor:
                return chain, energies, "exact"
            step = damped_step(hessian, gradient, damping).reshape(unknowns.shape[::-1]).T
            moved = chain.unknowns - step
            fresh = self.at(moved / np.linalg.norm(moved, axis=0))
            if fresh.energy < chain.energy:
                gain = 1.0 - fresh.energy / chain.energy
                chain, damping = fresh, max(damping / 5.0, 1e-12)
                energies.append(chain.energy)
                if gain < tolerance:
                    return chain, energies, "energy"
                hessian, gradient = self.normal(chain)
            else:
                damping *= 4.0
                if damping > LARGEST_DAMPING:
                    return chain, energies, "no step lowers the energy"
        return chain, energies, reason


class Csf2:
    """Complementary rank-3 spaces."""

    name = "csf2"
    title = "Complementary rank-3 spaces"
    year = 2011
    summary = "smooth shape coefficients, one rank-3 space after another, each on the residual"
    assumes = "few deformation modes with smooth coefficients; cameras that turn"
    cost = "2F²P once; (dK)³ + K²d²K per iteration"
    needs = Needs(frame_order=True)
    camera_method = "grown"
    denoise = False
    Options = Csf2Options

    def cells(self, options: Csf2Options, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: Csf2Options, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Add spaces one at a time, refine all after each, keep the number asked for or chosen."""
        rotations, frames = problem.rotations, len(problem.tracks)
        flat = problem.tracks.reshape(2 * frames, -1)
        wanted = options.basis_size or default_basis_size(frames, options.rank)
        size, warnings = clamped(wanted, frames, "basis_size", f"{frames} frames")
        limit, useful = rank_limit(frames, flat.shape[1], size)
        last = min(useful, LARGEST_RANK)
        if options.rank is not None:
            last, more = clamped(options.rank, limit, "rank", f"{frames} frames and {size} cosines")
            warnings += more
        basis = dct_basis(frames, size)
        objective = NestedProjection(rotations, flat, basis)
        unknowns, residual, candidates, energies = np.zeros((size, 0)), flat, [], []
        for k in range(1, last + 1):
            unknowns = np.hstack([unknowns, _added(rotations, residual, basis, first=k == 1)])
            chain, lowered, reason = objective.minimise(
                unknowns, iterations=options.max_iterations, tolerance=options.least_gain
            )
            unknowns, residual = chain.unknowns, chain.residuals[-1]
            energies += lowered
            fit = Fit(k, shapes_from(basis @ unknowns, np.vstack(chain.bases)), unknowns, list(energies), reason)
            candidates.append(judge(rotations, flat, fit))
            monitor(k / last)
            if reason == "exact":
                break
        best = candidates[-1].fit if options.rank is not None else choose(candidates).fit
        return best.solution({"rank": best.rank, "basis_size": size}, warnings)


def _contracted(product: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Σ_ab P_(ia)(jb) G_ab, (d, d), of P (3d, 3d) and G (3, 3)."""
    size = len(product) // 3
    block: np.ndarray = np.einsum("iajb,ab->ij", product.reshape(size, 3, size, 3), weights)
    return block


def _crossed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Σ_ab P_(ia)b Q_(jb)a, (d, d), of P and Q (3d, 3)."""
    turned = second.reshape(-1, 3, 3).transpose(0, 2, 1).reshape(-1, 9)
    product: np.ndarray = first.reshape(-1, 9) @ turned.T
    return product


def _added(rotations: np.ndarray, residual: np.ndarray, basis: np.ndarray, *, first: bool) -> np.ndarray:
    """x_k (d, 1) fitted to the residual alone: the best of the most promising single cosines as starts."""
    objective = VariableProjection(rotations, residual, basis)
    single = np.eye(basis.shape[1])
    # The first space holds the mean shape: its coefficient starts constant.
    starts = [0]
    if not first:
        tried = range(min(basis.shape[1], TRIED_COSINES))
        starts = sorted(tried, key=lambda i: objective.at(single[:, i : i + 1]).energy)[:STARTS]
    fits = [
        objective.minimise(single[:, i : i + 1], iterations=BLOCK_ITERATIONS, tolerance=BLOCK_TOLERANCE) for i in starts
    ]
    return min(fits, key=lambda fit: fit.energies[-1]).unknowns
