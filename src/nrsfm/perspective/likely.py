"""Most likely shapes near given ones, for tracks without perspective: what perspective has told is where they begin.

Cameras estimated from the tracks without perspective know nothing of how deep the object is, beyond what its turning
tells; the perspective model's do. So the Gaussian over frames freed from rigid motion
(:mod:`nrsfm.methods.procrustean_fit`) is fitted to the undone tracks from the model's shapes and cameras. Its σ does
not end at the noise of the tracks but at ``LEVEL`` of their size: a depth that is wrong by some percent leaves so much
of perspective in them, and shapes that follow the tracks more closely bend it into themselves. Tracks with more noise
than that are left alone: there it was of no use (docs/decisions.md).

All cells merged, on at most 2F virtual points: O(F²P) once, then independent of P. Ours.
"""

from __future__ import annotations

import numpy as np

from nrsfm.compression import CompressedTracks, compress, measure
from nrsfm.methods.procrustean_fit import Schedule, fit, unit_size
from nrsfm.numerics.threads import single_thread

LEVEL = 0.01
"""Root mean square of what is left of perspective in the tracks, in units of the tracks' own."""

FIRST = 1e-4
"""First σ², as a share of a shape's squared size: remembers depth and cameras of the beginning, not its details."""

FACTORS, COOLING, NEGLIGIBLE = 60, 0.8, 0.1
"""As in :mod:`nrsfm.methods.auto`."""


def likely_shapes(
    points: np.ndarray, shapes: np.ndarray, rotations: np.ndarray, scales: np.ndarray, noise: float = 0.0
) -> np.ndarray:
    """Shapes (F, P, 3) float32 in the frames of their cameras, centred, scaled to the image.

    Parameters
    ----------
    points
        (F, P, 2) complete tracks without perspective, image unit.
    shapes
        (F, P, 3) to begin with, in the frames of their cameras, scaled to the image.
    rotations, scales
        (F, 3, 3) and (F,) of mean 1: the cameras.
    noise
        Standard deviation of a coordinate of the tracks, image unit.

    Where the fit breaks down, and under more noise than ``LEVEL``, the shapes given.
    """
    count = points.shape[1]
    with single_thread(), np.errstate(all="ignore"):
        measured = measure(points)
        if noise > LEVEL * measured.unit:
            return shapes
        compressed = compress(measured, np.zeros(count, dtype=np.int64), tolerance=0.1 * LEVEL)
        sizes = scales[:, None, None]
        tracks = compressed.factors / sizes
        unit = unit_size(tracks)
        begin = np.swapaxes(rotations, 1, 2) @ (_virtual(compressed, shapes) / (sizes * unit))
        floor = LEVEL**2 * count / tracks.shape[2] / unit**2
        first = max(FIRST, floor)
        schedule = Schedule(FACTORS, first, floor, first / 10, COOLING, negligible=NEGLIGIBLE)
        try:
            found = fit(tracks / unit, rotations, begin, schedule, lambda _: None).shapes
        except np.linalg.LinAlgError:
            return shapes
    if not np.isfinite(found).all():
        return shapes
    return compressed.expand(unit * sizes * found, np.dtype(np.float32))


def _virtual(compressed: CompressedTracks, shapes: np.ndarray) -> np.ndarray:
    """Shapes (F, 3, N) of the virtual points of one cell, in units of the tracks; centred shapes (F, P, 3) given."""
    frames, measured = len(shapes), compressed.measurements
    out = np.zeros((3 * frames, compressed.factors.shape[2]))
    for part in measured.chunks():
        block = np.moveaxis(shapes[:, part], 2, 1).astype(np.float64, order="C").reshape(3 * frames, -1)
        out += block @ (compressed.maps[0] @ measured.columns(part)).T
    return out.reshape(frames, 3, -1) / measured.unit
