"""Camera rotations: estimated from the tracks by one of several estimators, or taken as given."""

from __future__ import annotations

from nrsfm.cameras.estimate import CameraEstimate, estimate_cameras
from nrsfm.cameras.known import cameras_from_known
from nrsfm.cameras.options import CameraOptions
from nrsfm.cameras.signs import choose_mirror, mirrored

__all__ = [
    "CameraEstimate",
    "CameraOptions",
    "cameras_from_known",
    "choose_mirror",
    "estimate_cameras",
    "mirrored",
]
