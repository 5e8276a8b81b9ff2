"""Eight camera paths of the experiment on camera motion, from nearly still to full turns.

Each is a function of the frame's place t in the sequence, 0 to 1, so that more frames sample the same path more finely;
``shake`` alone changes from frame to frame. Angles are degrees about the object's own axes: yaw about y, pitch about x,
roll about z, the last being the viewing direction at rest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.errors import InputError, suggest

_Angles = tuple[np.ndarray, np.ndarray, np.ndarray]


def _pan(reach: float) -> Callable[[np.ndarray], _Angles]:
    def path(t: np.ndarray) -> _Angles:
        return reach * (2.0 * t - 1.0), np.zeros_like(t), np.zeros_like(t)

    return path


def _still(t: np.ndarray) -> _Angles:
    phase = 2.0 * np.pi * t
    return np.sin(2.0 * phase), 0.5 * np.sin(3.0 * phase + 1.0), np.zeros_like(t)


def _turn(t: np.ndarray) -> _Angles:
    # The last frame is one step short of the first: no view is seen twice.
    return 360.0 * t * (1.0 - 1.0 / max(len(t), 1)), np.zeros_like(t), np.zeros_like(t)


def _two_axes(t: np.ndarray) -> _Angles:
    phase = 2.0 * np.pi * t
    return 40.0 * np.sin(2.0 * phase), 25.0 * np.sin(3.0 * phase + 0.7), np.zeros_like(t)


def _shake(t: np.ndarray) -> _Angles:
    # Steps of irrational parts of a turn: neighbouring frames have unlike angles, and no generator is needed.
    number = np.arange(len(t))
    return (
        15.0 * np.sin(2.0 * np.pi * 0.381966 * number),
        10.0 * np.sin(2.0 * np.pi * 0.292893 * number + 1.0),
        4.0 * np.sin(2.0 * np.pi * 0.236068 * number + 2.0),
    )


def _orbit(t: np.ndarray) -> _Angles:
    phase = 2.0 * np.pi * t
    return _turn(t)[0], 15.0 * np.sin(phase), 30.0 * np.sin(2.0 * phase)


_PATHS: dict[str, tuple[Callable[[np.ndarray], _Angles], str]] = {
    "still": (_still, "nearly still: trembles by ±1°"),
    "pan5": (_pan(5.0), "one slow pan, ±5°"),
    "pan15": (_pan(15.0), "one slow pan, ±15°"),
    "pan45": (_pan(45.0), "one slow pan, ±45°"),
    "turn": (_turn, "one full turn at even speed"),
    "two-axes": (_two_axes, "swings about two axes, ±40° and ±25°"),
    "shake": (_shake, "shakes by ±15° from frame to frame"),
    "orbit-roll": (_orbit, "a full turn that nods by ±15° and rolls by ±30°"),
}


def path_names() -> list[str]:
    """The names that :func:`camera_path` takes, from the least to the most motion."""
    return list(_PATHS)


def path_meaning(name: str) -> str:
    """What the camera does, in words."""
    return _find(name)[1]


def camera_path(name: str, frames: int) -> np.ndarray:
    """Rotations (F, 3, 3), camera from object, of the named path.

    Raises ``InputError`` for an unknown name, or less than one frame.
    """
    angles, _ = _find(name)
    if frames < 1:
        raise InputError(f"camera path '{name}': at least 1 frame is needed, received {frames}")
    yaw, pitch, roll = np.radians(angles(np.linspace(0.0, 1.0, frames)))
    matrices = np.tile(np.eye(3), (3, frames, 1, 1))
    for matrix, angle, (i, j) in zip(matrices, (yaw, pitch, roll), ((2, 0), (1, 2), (0, 1)), strict=True):
        matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
        matrix[:, j, i] = np.sin(angle)
        matrix[:, i, j] = -np.sin(angle)
    return np.asarray(matrices[2] @ matrices[1] @ matrices[0])


def _find(name: str) -> tuple[Callable[[np.ndarray], _Angles], str]:
    if name not in _PATHS:
        raise InputError(f"camera path must be one of {', '.join(_PATHS)}, received {name!r}{suggest(name, _PATHS)}")
    return _PATHS[name]
