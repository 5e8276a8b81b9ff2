"""The map Δ from the Grassmann manifold G(p, d) to the lower-dimensional G(p, d̃) (Algorithm 2, f_h).

minimise over Δ   Σ_ij w_ij ½‖Δᵀ(Ω_iΩ_iᵀ − Ω_jΩ_jᵀ)Δ‖²_F   subject to   tr(Δᵀ X Δ) = 1,   X = Σ_i λ_i Ω_iΩ_iᵀ,

with Ω_i = Φ_i U_i⁻¹, Θ_i U_i = qr(ΔᵀΦ_i), λ_i = Σ_j w_ij. As the paper does, one factor ΔΔᵀ and the U_i are held at
their last values, which leaves the generalised eigenproblem Y Δ = X Δ diag(·), Y = Σ_ij (w_ij/2) Λ_ij ΔΔᵀ Λ_ij, and its
d̃ least eigenvectors. The trace constraint alone would be met best by d̃ copies of one vector; the eigenvectors are the
minimiser under ΔᵀXΔ = I/d̃, which implies it.

With H_i = Ω_i(Ω_iᵀΔ) and the graph Laplacian 𝓛 = diag(λ) − w, Y = Σ_ij 𝓛_ij H_i H_jᵀ: no loop over pairs of d×d
matrices. All of it happens inside the span of the Φ_i, where X is invertible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh


@dataclass(frozen=True)
class Projection:
    """Δ (d, d̃), the projected points Θ (K, d̃, p), the energy E(Δ) before each eigenproblem, and d̃."""

    delta: np.ndarray
    points: np.ndarray
    energies: tuple[float, ...]
    dimension: int


def reduced_dimension(points: np.ndarray, share: float) -> int:
    """d̃: how many principal directions of all Φ together hold ``share`` (τ) of their energy, at least p.

    Source: the paper's cumulative energy rule with τ; METHODS of the field keep d̃ ≥ p so that Θ_i exists.
    """
    count, ambient, dimension = points.shape
    stacked = points.transpose(1, 0, 2).reshape(ambient, count * dimension)
    gram = stacked.T @ stacked if stacked.shape[1] < ambient else stacked @ stacked.T
    energy = np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0)
    cumulative = np.cumsum(energy) / energy.sum()
    # The least count whose share reaches τ, guarded against the last digit of the sum at τ = 1.
    needed = int(np.searchsorted(cumulative, share - 1e-12)) + 1
    rank = int(np.sum(energy > 1e-10 * energy[0]))
    return int(np.clip(needed, dimension, max(rank, dimension)))


def lower(points: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Θ_i (K, d̃, p) = the orthonormal factor of ΔᵀΦ_i, and Ω_i = Φ_i U_i⁻¹ (K, d, p)."""
    small = delta.T @ points
    theta, upper = np.linalg.qr(small)
    # A subspace that Δ flattens has no image on G(p, d̃); a floor, relative to all subspaces, keeps Ω finite there.
    diagonal = np.einsum("kii->ki", upper)
    floor = 1e-6 * max(float(np.abs(diagonal).max()), np.finfo(float).tiny)
    diagonal[...] = np.where(np.abs(diagonal) < floor, np.copysign(floor, diagonal), diagonal)
    omega = np.linalg.solve(upper.transpose(0, 2, 1), points.transpose(0, 2, 1)).transpose(0, 2, 1)
    return theta, omega


def projection_energy(omega: np.ndarray, graph: np.ndarray, delta: np.ndarray) -> float:
    """E(Δ) = Σ_ij w_ij ½‖Δᵀ(Ω_iΩ_iᵀ − Ω_jΩ_jᵀ)Δ‖²_F."""
    small = delta.T @ omega
    squares = (small @ small.transpose(0, 2, 1)).reshape(len(omega), -1)
    sizes = np.einsum("ij,ij->i", squares, squares)
    gaps = sizes[:, None] + sizes[None, :] - 2.0 * squares @ squares.T
    return float(np.sum(graph * np.maximum(gaps, 0.0)) / 2.0)


def _span(points: np.ndarray) -> np.ndarray:
    count, ambient, dimension = points.shape
    stacked = points.transpose(1, 0, 2).reshape(ambient, count * dimension)
    if stacked.shape[1] >= ambient:
        values, vectors = eigh(stacked @ stacked.T, driver="evd", check_finite=False)
    else:
        values, right = eigh(stacked.T @ stacked, driver="evd", check_finite=False)
        vectors = stacked @ (right / np.sqrt(np.maximum(values, np.finfo(float).tiny)))
    return vectors[:, values > 1e-9 * values[-1]][:, ::-1]


def project(points: np.ndarray, graph: np.ndarray, dimension: int, rounds: int = 2) -> Projection:
    """Solve for Δ and project the Grassmann points.

    Parameters
    ----------
    points
        Φ (K, d, p).
    graph
        w (K, K), symmetric, non-negative.
    dimension
        d̃, at least p.
    rounds
        Eigenproblems solved, each with ΔΔᵀ and U_i from the one before.

    Every call starts from the leading principal directions of all Φ. Started from the Δ of the call before, the held
    U_i let the scales of Δ's directions drift apart from round to round, until whole subspaces are flattened.
    """
    span = _span(points)
    dimension = min(dimension, span.shape[1])
    inner = span.T @ points
    small = np.eye(span.shape[1], dimension)
    degree = graph.sum(axis=1)
    laplacian = np.diag(degree) - graph
    energies = []
    for _ in range(rounds):
        _, omega = lower(inner, small)
        wide = (omega * np.sqrt(degree)[:, None, None]).transpose(1, 0, 2).reshape(span.shape[1], -1)
        metric = wide @ wide.T
        small = small / np.sqrt(max(float(np.sum(small * (metric @ small))), 1e-300))
        energies.append(projection_energy(omega, graph, small))
        heights = omega @ (omega.transpose(0, 2, 1) @ small)  # H_i (K, s, d̃)
        mixed = np.tensordot(laplacian, heights, axes=1)
        bending = np.tensordot(heights, mixed, axes=((0, 2), (0, 2)))
        ridge = 1e-10 * float(np.trace(metric)) / len(metric)
        _, vectors = eigh(
            (bending + bending.T) / 2,
            (metric + metric.T) / 2 + ridge * np.eye(len(metric)),
            driver="gvd",  # the drivers for a subset of eigenvectors can fail to converge
            check_finite=False,
        )
        small = vectors[:, :dimension] / np.sqrt(dimension)  # eigenvectors are X-orthonormal: tr(ΔᵀXΔ) = 1 after this
    theta, _ = lower(inner, small)
    return Projection(span @ small, theta, tuple(energies), dimension)
