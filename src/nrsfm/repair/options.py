"""Options of the repair stage and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nrsfm.options import option


@dataclass(frozen=True)
class RepairOptions:
    """How tracks are made complete and clean."""

    outliers: bool = option(
        True, "Look for entries that are wrong (gross errors, drifting tracks); they are then treated as not seen."
    )
    completion_rank: int | None = option(
        None,
        "Rank of the model that completes the tracks, translations apart. Default: grown while it predicts held-out "
        "entries better.",
        minimum=1,
    )
    least_frames: int | None = option(
        None,
        "A point seen in fewer frames is not reconstructed. Default: half the completion rank (so that it is measured "
        "as often as it has unknowns), but at most a quarter of the frames and at least 3.",
        minimum=1,
    )


@dataclass(frozen=True, eq=False)
class Repaired:
    """Complete tracks.

    ``points`` (F, P, 2): the very array that came in where nothing had to be done; else a new one of its type, with
    NaN for points that are not ``kept`` (P,). ``confidence`` (F, P) float32: 1 measured and fits, down to 0 for an
    outlier; 0 where not seen; ``None`` where all are 1. ``report``: plain numbers. ``warnings``: one line each.
    ``doubt`` (P,): root mean square standard deviation of a point's filled entries, unit of the tracks, 0 where none
    were filled; ``doubt_level``: what counts as none; ``noisy``: the tracks hold noise beyond rounding; ``good``
    (F, P): seen and not found wrong. ``None`` as above.
    """

    points: np.ndarray
    kept: np.ndarray
    confidence: np.ndarray | None
    report: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    doubt: np.ndarray | None = None
    doubt_level: float = 0.0
    noisy: bool = False
    good: np.ndarray | None = None
