"""Total variation on a graph: its dual variable, one block of columns at a time.

    TV(u) = Σ_i √(Σ_{rows of i} (D u)²) = max over p of ⟨p, D u⟩,   √(Σ_{rows of i} p²) ≤ 1 for every point i,

each column of u (P, columns) by itself. Primal-dual methods (Chambolle and Pock, J. Math. Imaging Vis. 40, 2011) climb
in p and shrink back into these balls. Columns are worked on in blocks that stay in cache: what is passed over for
every edge, point and frame would otherwise be gigabytes per iteration.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

_COLUMNS = 24  # of a block


class GraphVariation:
    """The weighted total variation of many columns, and its dual variable.

    Parameters
    ----------
    operator
        D (rows × P), sparse.
    owners
        (rows,) the point that owns each row, ascending.
    weight
        Weight μ of the variation.
    """

    def __init__(self, operator: Any, owners: np.ndarray, weight: float) -> None:
        self.operator = operator
        self.adjoint = operator.T.tocsr()
        self.weight = weight
        self._starts = np.flatnonzero(np.diff(owners, prepend=-1))
        self._counts = np.diff(np.append(self._starts, len(owners)))
        # ‖D‖² ≤ the largest column sum of |DᵀD|.
        self.norm2 = float(abs(self.adjoint @ operator).sum(axis=0).max()) if len(owners) else 1.0
        self._dual: list[np.ndarray] = []

    def start(self, columns: np.ndarray) -> None:
        """Dual variable zero, for columns like these (P, n).

        The subgradient μ·Du/|Du| would be the better start for smooth u, but turns the noise of u into a push many
        times as large.
        """
        rows = self.operator.shape[0]
        self._dual = [np.zeros((rows, block.stop - block.start), columns.dtype) for block in _blocks(columns)]

    def ascend(self, columns: np.ndarray, step: float, force: np.ndarray) -> None:
        """One step of the dual variable, p ← projection of p + step·D u; adds Dᵀp to ``force`` (P, n)."""
        for dual, block in zip(self._dual, _blocks(columns), strict=True):
            slope = self.operator @ np.ascontiguousarray(columns[:, block])
            slope *= step
            dual += slope
            lengths = self._lengths(dual)
            dual *= self._spread(np.minimum(1.0, self.weight / np.maximum(lengths, self.weight)))
            force[:, block] += self.adjoint @ dual

    def value(self, columns: np.ndarray) -> float:
        """μ·TV summed over the columns."""
        total = 0.0
        for block in _blocks(columns):
            slope = self.operator @ np.ascontiguousarray(columns[:, block])
            total += float(self._lengths(slope).sum(dtype=np.float64))
        return self.weight * total

    def _lengths(self, rows: np.ndarray) -> np.ndarray:
        """√(Σ over each owner's rows of squares), (owners, n)."""
        if not len(rows):
            return np.zeros((0, rows.shape[1]), dtype=rows.dtype)
        return np.sqrt(np.add.reduceat(rows * rows, self._starts, axis=0))

    def _spread(self, values: np.ndarray) -> np.ndarray:
        """Each owner's value on all of its rows."""
        return np.repeat(values, self._counts, axis=0)


def _blocks(columns: np.ndarray) -> Iterator[slice]:
    for start in range(0, columns.shape[1], _COLUMNS):
        yield slice(start, min(start + _COLUMNS, columns.shape[1]))
