"""e3D of shapes of any size against a truth that is made stretch by stretch: no array of all points is held.

With both centred, ‖A Q − B‖² = ‖A‖² + ‖B‖² − 2 tr(Qᵀ AᵀB) for an orthogonal Q, and the best Q comes from AᵀB: a 3×3
matrix and two squared norms of each frame are all that the error needs, and they are sums over the points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from nrsfm.streaming.readers import release


class Moments:
    """Sums over the points of F frames, about the first stretch's centres so that no digits are lost."""

    def __init__(self, frames: int) -> None:
        self.count = 0
        self._about = np.zeros((2, frames, 1, 3))
        self._sums = np.zeros((2, frames, 3))
        self._squares = np.zeros((2, frames))
        self._cross = np.zeros((frames, 3, 3))

    def add(self, estimate: np.ndarray, truth: np.ndarray) -> None:
        """Add some points: both (F, n, 3)."""
        pair = np.stack([estimate, truth]).astype(np.float64, copy=False)
        if not self.count:
            self._about = pair.mean(axis=2, keepdims=True)
        pair -= self._about
        self.count += pair.shape[2]
        self._sums += pair.sum(axis=2)
        self._squares += np.einsum("kfpi,kfpi->kf", pair, pair)
        self._cross += pair[0].transpose(0, 2, 1) @ pair[1]

    def error(self, align: str) -> float:
        """e3D, the mean over frames; ``align`` as in ``nrsfm.shape_error``: "none", "global" or "per-frame"."""
        squares = self._squares - np.sum(self._sums**2, axis=2) / self.count
        cross = self._cross - self._sums[0][:, :, None] * self._sums[1][:, None, :] / self.count
        if align == "per-frame":
            along = np.linalg.svd(cross, compute_uv=False).sum(axis=1)  # tr(Qᵀ AᵀB) of the best Q
        elif align in ("none", "global"):
            u, _, vt = np.linalg.svd(cross.sum(axis=0))
            along = np.einsum("ij,fij->f", u @ vt if align == "global" else np.eye(3), cross)
        else:
            raise ValueError(f"align must be none, global or per-frame, received '{align}'")
        gaps = np.maximum(squares.sum(axis=0) - 2.0 * along, 0.0)
        return float(np.sqrt(gaps / squares[1]).mean())


def errors_of(
    shapes: np.ndarray, truth: Callable[[int, int], np.ndarray], chunks: Iterable[tuple[int, int]]
) -> dict[str, float]:
    """Errors of shapes (F, P, 3), perhaps a memory map; ``truth(start, stop)`` gives the true ones (F, n, 3)."""
    moments = Moments(len(shapes))
    for start, stop in chunks:
        moments.add(shapes[:, start:stop], truth(start, stop))
        release(shapes)
    return {align: moments.error(align) for align in ("global", "per-frame")}
