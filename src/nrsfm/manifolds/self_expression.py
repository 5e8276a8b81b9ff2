"""Self-expression of Grassmann points: min over C of λ‖L − CL‖²_F + μ‖C‖_*, with L Lᵀ = Γ.

L itself is never formed: every step needs only Γ.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


def coefficient_step(
    kernel: np.ndarray, auxiliary: np.ndarray, multiplier: np.ndarray, weight: float, penalty: float
) -> np.ndarray:
    """C ← (2λΓ + β(J − L₂/β)) (2λΓ + βI)⁻¹, the minimiser over C of the augmented Lagrangian.

    ``kernel`` Γ (K, K) positive semidefinite, ``auxiliary`` J, ``multiplier`` L₂, ``weight`` λ, ``penalty`` β > 0.
    """
    scaled = 2.0 * weight * kernel
    system = scaled + penalty * np.eye(len(kernel))
    return np.linalg.solve(system, (scaled + penalty * auxiliary - multiplier).T).T


def nuclear_step(matrix: np.ndarray, threshold: float) -> np.ndarray:
    """J ← U S_τ(Σ) Vᵀ, the minimiser of τ‖J‖_* + ½‖J − matrix‖²_F."""
    left, values, right = np.linalg.svd(matrix)
    return (left * np.maximum(values - threshold, 0.0)) @ right


def affinity(coefficients: np.ndarray) -> np.ndarray:
    """Symmetric, non-negative affinity (|C| + |Cᵀ|)/2 for spectral grouping."""
    return (np.abs(coefficients) + np.abs(coefficients.T)) / 2.0


@dataclass
class SelfExpression:
    """C, J and the multiplier L₂ of one self-expression problem inside a larger multiplier iteration.

    ``weight`` is λ₁ (β₁ in Algorithm 2), ``nuclear_weight`` λ₃ (β₃). ``kernel`` Γ may change between steps. C and J
    start at zero, as in the algorithm boxes.
    """

    kernel: np.ndarray
    weight: float
    nuclear_weight: float
    coefficients: np.ndarray = field(init=False)
    auxiliary: np.ndarray = field(init=False)
    multiplier: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.coefficients = np.zeros_like(self.kernel)
        self.auxiliary = np.zeros_like(self.kernel)
        self.multiplier = np.zeros_like(self.kernel)

    def update_coefficients(self, penalty: float) -> None:
        """C-step at penalty β."""
        self.coefficients = coefficient_step(self.kernel, self.auxiliary, self.multiplier, self.weight, penalty)

    def update_auxiliary(self, penalty: float) -> None:
        """J-step (Z-step in Algorithm 2) at penalty β."""
        self.auxiliary = nuclear_step(self.coefficients + self.multiplier / penalty, self.nuclear_weight / penalty)

    def update_multiplier(self, penalty: float) -> float:
        """L₂ ← L₂ + β(C − J); returns the largest entry of |C − J|."""
        gap = self.coefficients - self.auxiliary
        self.multiplier += penalty * gap
        return float(np.abs(gap).max())

    def affinity(self) -> np.ndarray:
        """Affinity of the low-rank copy J, or of C while J is still zero."""
        return affinity(self.auxiliary if self.auxiliary.any() else self.coefficients)
