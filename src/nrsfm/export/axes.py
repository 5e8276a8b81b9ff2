"""World axes of a file, and the one rotation that leads there.

The reference frame's camera (x right, y down, z forward) sees the object upright. A world in which that camera looks
along −z with y up is w = diag(1, −1, −1) R_r X, X in the object frame, R_r the camera of the reference frame r: what
glTF prescribes (right-handed, y up, +z towards the viewer), and what USD, OBJ and most viewers take by default. A
further fixed rotation leads from there to worlds with z up, or to the camera's own axes.

Source: glTF 2.0 specification, 3.4 (coordinate system and units), Khronos 2021; the rest ours.
"""

from __future__ import annotations

import numpy as np

UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""Axes of an OpenGL or glTF camera (x right, y up, z backward) from those of ours, and back: its own inverse."""

_FROM_Y_UP = {
    "y-up": np.eye(3),
    "z-up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "opencv": UPRIGHT,
}

CONVENTIONS = tuple(_FROM_Y_UP)
"""``y-up``: x right, y up, z towards the viewer. ``z-up``: x right, y away from the viewer, z up, as in Blender.
``opencv``: x right, y down, z away from the viewer. Right and viewer as in the reference frame's image."""


def from_y_up(convention: str) -> np.ndarray:
    """(3, 3) rotation from the y-up world to that of the convention."""
    return _FROM_Y_UP[convention].copy()


def world_from_object(rotation: np.ndarray, convention: str) -> np.ndarray:
    """(3, 3) rotation from the object frame to the world, ``rotation`` (3, 3) being the reference frame's camera."""
    return np.asarray(from_y_up(convention) @ UPRIGHT @ rotation)
