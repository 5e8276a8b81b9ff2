"""Perspective: undone as far as an affine camera can, found in the tracks that show it, and the mirror it tells."""

from nrsfm.perspective.driver import with_perspective
from nrsfm.perspective.evidence import PerspectiveFinding, find_perspective, mirror_evidence
from nrsfm.perspective.geometry import perspective_error, undo_perspective
from nrsfm.perspective.likely import likely_shapes
from nrsfm.perspective.options import PerspectiveOptions
from nrsfm.perspective.shapes import CameraShapes, averaged_shapes

__all__ = [
    "CameraShapes",
    "PerspectiveFinding",
    "PerspectiveOptions",
    "averaged_shapes",
    "find_perspective",
    "likely_shapes",
    "mirror_evidence",
    "perspective_error",
    "undo_perspective",
    "with_perspective",
]
