"""Cameras for sequences that come without: a path that turns enough to see depth."""

from __future__ import annotations

import numpy as np


def camera_path(frames: int, *, turns: float = 1.0, yaw: float = 0.0) -> np.ndarray:
    """Return rotations (F, 3, 3), camera from object, for an object whose y axis points up.

    The camera swings ``turns`` times through ±45° about the object's vertical, around ``yaw`` degrees, and
    nods through ±15° twice as slowly. Its own axes are x right, y down, z forward.
    """
    phase = 2 * np.pi * turns * np.arange(frames) / max(frames, 1)
    around = np.radians(yaw) + np.radians(45) * np.sin(phase)
    nod = np.radians(15) * np.sin(phase / 2)
    turn, tilt = np.zeros((2, frames, 3, 3))
    turn[:, 0, 0] = turn[:, 2, 2] = np.cos(around)
    turn[:, 0, 2], turn[:, 2, 0] = np.sin(around), -np.sin(around)
    turn[:, 1, 1] = tilt[:, 0, 0] = 1
    tilt[:, 1, 1] = tilt[:, 2, 2] = np.cos(nod)
    tilt[:, 1, 2], tilt[:, 2, 1] = -np.sin(nod), np.sin(nod)
    upright = np.diag([1.0, -1.0, -1.0])  # y up, z towards the viewer → y down, z away from the viewer
    return upright @ tilt @ turn
