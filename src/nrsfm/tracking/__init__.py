"""Dense tracks from frames: chained pairwise flow corrected against the reference, and multi-frame subspace flow.

Needs the extra ``nrsfm[video]`` (OpenCV). Positions are in pixels, x to the right, y down; the centre of the top
left pixel is (0, 0).
"""

from __future__ import annotations

from nrsfm.tracking.driver import track
from nrsfm.tracking.options import METHODS, TrackingOptions
from nrsfm.tracking.result import Layout, TrackingDiagnostics, TrackingResult, save_tracking
from nrsfm.tracking.usable import usable

__all__ = [
    "METHODS",
    "Layout",
    "TrackingDiagnostics",
    "TrackingOptions",
    "TrackingResult",
    "save_tracking",
    "track",
    "usable",
]
