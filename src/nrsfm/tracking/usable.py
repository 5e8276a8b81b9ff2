"""What a reconstruction should take of tracks whose deviations are known: which entries, and how noisy they are.

Ours. A reconstruction has one noise level for all entries, and cannot see errors that neighbouring points and frames
share: smooth tracks look exact. So it is told the level, and entries far above the usual one count as not seen; the
stages that complete tracks and resect points then make up for them. In every frame the best entries stay, whatever
their deviation, so that no frame comes apart from the others.
"""

from __future__ import annotations

import numpy as np

from nrsfm.errors import InputError, OptionError
from nrsfm.tracks import Tracks

MULTIPLE = 1.5
_LEAST = 0.25  # of what is visible in a frame


def usable(tracks: Tracks, deviation: np.ndarray, multiple: float = MULTIPLE) -> tuple[Tracks, float]:
    """Return the tracks less the entries that are too uncertain, and the noise level of the others in pixels.

    Parameters
    ----------
    tracks
        F frames of P points.
    deviation
        (F, P), standard deviation of each coordinate in pixels; not looked at where a point is not visible. Infinity:
        nothing is known.
    multiple
        Entries whose deviation is above so many times the median of the visible ones count as not seen.

    Returns
    -------
    tracks, noise_level
        The same points with fewer visible entries; the root mean square deviation of those left, in every frame but
        those in which points are exact by definition, for ``nrsfm.reconstruct(tracks, noise_level=...)``. 0 where
        nothing is visible.

    Raises
    ------
    InputError
        The deviation has another shape or type, or is negative or NaN where a point is visible.
    OptionError
        ``multiple`` is not a number above 0.
    """
    if isinstance(multiple, bool) or not isinstance(multiple, (int, float)) or not multiple > 0:
        raise OptionError(f"multiple must be a number above 0, received {multiple!r}")
    array = np.asarray(deviation)
    shape = tracks.points.shape[:2]
    if array.shape != shape or array.dtype.kind != "f":
        raise InputError(f"deviation: real numbers of shape {shape} are needed, received {array.dtype} {array.shape}")
    visible = np.ones(shape, dtype=bool) if tracks.visible is None else tracks.visible.copy()
    told = array[visible]
    if not (told >= 0).all():  # NaN is not
        worst = told[~(told >= 0)][0]
        raise InputError(f"deviation: numbers of at least 0 are needed where a point is visible, received {worst}")
    limit = multiple * float(np.median(told)) if told.size else 0.0
    squares, count = 0.0, 0
    for f in range(shape[0]):
        own = array[f][visible[f]]
        if not own.size:
            continue
        least = np.partition(own, int(_LEAST * (own.size - 1)))[int(_LEAST * (own.size - 1))]
        visible[f] &= np.isfinite(array[f]) & (array[f] <= max(limit, float(least)))
        kept = array[f][visible[f]].astype(np.float64)
        if kept.size and np.ptp(kept) > 0:  # the reference's are all alike: its points are where they are by definition
            squares, count = squares + float(kept @ kept), count + kept.size
    return Tracks(tracks.points, visible), float(np.sqrt(squares / count)) if count else 0.0
