"""Local linear subspaces of an array of columns: f_g and f_s of the paper on the compressed shapes.

Matrices may be on a device. Which columns are whose, and how many directions are kept, is told on the host.

Cells own runs of columns; groups own cells. A cell never splits, so the compression stays exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.manifolds.grassmann import grassmann_points
from nrsfm.numerics.arrays import beside, namespace_of, on_host, taken, with_columns


class ColumnCells:
    """Cells of consecutive columns of a (d, N) array, cell k owning ``offsets[k]:offsets[k+1]``."""

    def __init__(self, offsets: np.ndarray) -> None:
        self.offsets = np.asarray(offsets)
        widths = np.diff(self.offsets)
        # One index table turns ragged cells into a zero-padded stack, so that K small problems run as one.
        steps = np.arange(int(widths.max()))
        inside = steps[None, :] < widths[:, None]
        self._table = np.where(inside, self.offsets[:-1, None] + steps[None, :], 0)
        self._mask = inside.astype(np.float64)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def points(self, matrix: Any, dimension: int, complete: bool = True) -> Any:
        """Grassmann points (K, d, p) of the cells of a (d, N) matrix: f_g; see :func:`grassmann_points`."""
        xp = namespace_of(matrix)
        columns = xp.take(matrix.T, beside(self._table.reshape(-1), matrix), axis=0)
        blocks = xp.matrix_transpose(xp.reshape(columns, (*self._table.shape, -1)))
        return grassmann_points(blocks * beside(self._mask, matrix)[:, None, :], dimension, complete)

    def columns_of_groups(self, groups: np.ndarray) -> list[np.ndarray]:
        """Column indices of each group, for ``groups`` (K,) labels 0..G−1 of the cells."""
        owner = np.repeat(groups, np.diff(self.offsets))
        return [np.flatnonzero(owner == g) for g in range(int(groups.max()) + 1)]


# A group's directions are kept down to this share of the noise edge: its cells were shrunk already, so that what is
# left below the edge is mostly signal. Measured: cutting at the edge itself costs up to 10%, see docs/decisions.md.
_EDGE_SHARE = 0.3


def signal_rank(tracks: np.ndarray, points: int, noise: float) -> int | None:
    """How many singular directions of a group's (2F, n) virtual tracks hold signal; None where all of them do."""
    values = np.linalg.svd(tracks, compute_uv=False)
    edge = _EDGE_SHARE * noise * np.sqrt(max(len(tracks), points))
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    kept = max(1, int(np.count_nonzero(values > edge)))
    return kept if kept < rank else None


def refine_groups(matrix: Any, columns: list[np.ndarray], dimensions: list[int | None], edge: float = 0.0) -> Any:
    """Best rank-p approximation of each group's columns of a (d, N) matrix: f_s after f_g.

    ``columns`` are the column indices of each group and ``dimensions`` its p. Where p is None, the singular values
    above ``edge`` are kept; an edge of 0 leaves the group as it is, as does a p no less than its columns or rows.
    """
    xp = namespace_of(matrix)
    changed = []
    # One by one: widths differ by much, and a padded stack would cost as if all were the widest.
    for own, wanted in zip(columns, dimensions, strict=True):
        largest = min(len(own), matrix.shape[0])
        if edge == 0 if wanted is None else wanted >= largest:
            continue
        block = taken(matrix, own, 1)
        squares, right = xp.linalg.eigh(block.T @ block)
        dimension = max(1, int(np.count_nonzero(on_host(squares) > edge**2))) if wanted is None else wanted
        if dimension < largest:
            kept = right[:, len(own) - dimension :]
            changed.append((own, block @ (kept @ kept.T)))
    return with_columns(matrix, changed)
