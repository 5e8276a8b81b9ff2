"""Local linear subspaces of an array of columns: f_g and f_s of the paper on the compressed shapes.

Cells own runs of columns; groups own cells. A cell never splits, so the compression stays exact.
"""

from __future__ import annotations

import numpy as np

from nrsfm.manifolds.grassmann import grassmann_points


class ColumnCells:
    """Cells of consecutive columns of a (d, N) array, cell k owning ``offsets[k]:offsets[k+1]``."""

    def __init__(self, offsets: np.ndarray) -> None:
        self.offsets = np.asarray(offsets)
        widths = np.diff(self.offsets)
        # One index table turns ragged cells into a zero-padded stack, so that K small problems run as one.
        steps = np.arange(int(widths.max()))
        self._mask = steps[None, :] < widths[:, None]
        self._table = np.where(self._mask, self.offsets[:-1, None] + steps[None, :], 0)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def points(self, matrix: np.ndarray, dimension: int, complete: bool = True) -> np.ndarray:
        """Grassmann points (K, d, p) of the cells of a (d, N) matrix: f_g; see :func:`grassmann_points`."""
        blocks = matrix[:, self._table] * self._mask
        return grassmann_points(np.ascontiguousarray(blocks.transpose(1, 0, 2)), dimension, complete)

    def truncate(self, matrix: np.ndarray, dimensions: np.ndarray) -> np.ndarray:
        """Best rank-``dimensions[k]`` approximation of each cell of a (d, N) matrix."""
        out = np.empty_like(matrix)
        # One by one: widths differ by much, and a padded stack would cost as if all were the widest.
        for start, stop, dimension in zip(self.offsets[:-1], self.offsets[1:], dimensions, strict=True):
            block = matrix[:, start:stop]
            right = np.linalg.eigh(block.T @ block)[1][:, stop - start - dimension :]
            out[:, start:stop] = block @ (right @ right.T)
        return out

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


class GroupRefinement:
    """Best rank-p approximation of each group's columns: f_s after f_g.

    ``columns`` are the column indices of each group and ``dimensions`` its p; None, or p no less than the number of
    columns, leaves a group as it is.
    """

    def __init__(self, columns: list[np.ndarray], dimensions: list[int | None], rows: int) -> None:
        active = [(c, p) for c, p in zip(columns, dimensions, strict=True) if p is not None and p < min(len(c), rows)]
        self._columns = np.concatenate([c for c, _ in active]) if active else np.zeros(0, dtype=np.int64)
        self._cells = ColumnCells(np.concatenate([[0], np.cumsum([len(c) for c, _ in active])])) if active else None
        self._dimensions = np.array([p for _, p in active])

    def __call__(self, matrix: np.ndarray) -> np.ndarray:
        """The refined (d, N) matrix; the input itself where no group is truncated."""
        if self._cells is None:
            return matrix
        out = matrix.copy()
        out[:, self._columns] = self._cells.truncate(matrix[:, self._columns], self._dimensions)
        return out
