"""The Sylvester equation A X + c X B = C for a small symmetric A, a large sparse symmetric B and many columns.

With A = U diag(a) Uᵀ the rows of Y = Uᵀ X decouple into sparse systems (a_i I + c B) y_i = (UᵀC)_i. Their matrices
differ only in the shift, so one factorisation serves all shifts within a factor of two of it: as the preconditioner
of conjugate gradients it leaves a condition number of at most 2, and every two iterations gain more than a digit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_RATIO = 2.0  # shifts that share a factorisation differ at most by this
_LEAST_SHIFT = 1e-9  # of the largest: below this A is singular, and the shift only keeps the answer finite
_MAX_STEPS = 60


class Sylvester:
    """Factorisations for one A and B; :meth:`solve` for any number of right-hand sides.

    Parameters
    ----------
    left
        A (n, n), symmetric positive semidefinite; dense.
    right
        c·B (P, P), symmetric positive semidefinite; sparse.
    """

    def __init__(self, left: np.ndarray, right: Any) -> None:
        shifts, self.vectors = np.linalg.eigh(left)
        self.shifts = np.maximum(shifts, _LEAST_SHIFT * shifts[-1])
        self.right = right.tocsr()
        self.groups = _groups(self.shifts)
        self._solvers = [self._factor(group) for group in self.groups]

    def _factor(self, group: np.ndarray) -> Any:
        from scipy.sparse import eye_array
        from scipy.sparse.linalg import splu

        shift = float(np.sqrt(self.shifts[group[0]] * self.shifts[group[-1]]))
        matrix = (self.right + shift * eye_array(self.right.shape[0])).tocsc()
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(self, constant: np.ndarray, start: np.ndarray | None = None, tolerance: float = 1e-8) -> np.ndarray:
        """X (n, P) for C (n, P), to a residual of ``tolerance`` relative to C; ``start`` is a first guess of X."""
        wanted = self.vectors.T @ constant
        guess = None if start is None else self.vectors.T @ start
        floor = tolerance * float(np.linalg.norm(constant)) / np.sqrt(len(constant))
        found = np.empty_like(wanted)
        for group, solver in zip(self.groups, self._solvers, strict=True):
            first = None if guess is None else guess[group]
            found[group] = self._solve_group(solver, self.shifts[group], wanted[group], first, floor)
        return self.vectors @ found

    def _solve_group(
        self, solver: Any, shifts: np.ndarray, wanted: np.ndarray, guess: np.ndarray | None, floor: float
    ) -> np.ndarray:
        """Preconditioned conjugate gradients on all systems of a group side by side, to residuals of ``floor``."""
        target = np.ascontiguousarray(wanted.T)
        if guess is None:
            x = solver.solve(target)
        else:
            x = np.ascontiguousarray(guess.T)
        residual = target - (self.right @ x + x * shifts)
        step = solver.solve(residual)
        along = np.einsum("ij,ij->j", residual, step)
        direction = step
        for _ in range(_MAX_STEPS):
            live = np.linalg.norm(residual, axis=0) > floor
            if not live.any():
                break
            image = self.right @ direction + direction * shifts
            curvature = np.einsum("ij,ij->j", direction, image)
            length = np.where(live & (curvature > 0), along / np.where(curvature > 0, curvature, 1.0), 0.0)
            x += length * direction
            residual -= length * image
            step = solver.solve(residual)
            after = np.einsum("ij,ij->j", residual, step)
            direction = step + np.where(along > 0, after / np.where(along > 0, along, 1.0), 0.0) * direction
            along = after
        return x.T


def _groups(shifts: np.ndarray) -> list[np.ndarray]:
    """Runs of ascending shifts, each within ``_RATIO`` of its first."""
    groups, start = [], 0
    for i in range(1, len(shifts) + 1):
        if i == len(shifts) or shifts[i] > _RATIO * shifts[start]:
            groups.append(np.arange(start, i))
            start = i
    return groups
