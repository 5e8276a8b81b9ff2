"""Camera rotations: estimated from the tracks by one of several estimators, or taken as given."""

from __future__ import annotations

from nrsfm.cameras.estimate import LEAST_TURN, CameraEstimate, camera_turn, estimate_cameras
from nrsfm.cameras.known import cameras_from_known
from nrsfm.cameras.options import CameraOptions
from nrsfm.cameras.signs import choose_mirror, mirrored

__all__ = [
    "LEAST_TURN",
    "CameraEstimate",
    "CameraOptions",
    "camera_turn",
    "cameras_from_known",
    "choose_mirror",
    "estimate_cameras",
    "mirrored",
]
