"""Where the cameras are in the world, what they see, and how a still camera sees the object move.

Frame f of a reconstruction is seen at u = s_f (R_f X)_xy + t_f. In a world w = c A X (A: :mod:`nrsfm.export.axes`,
c: the unit), a camera with axes x right, y up, z backward has the orientation C_f = A R_fᵀ D, D = diag(1, −1, −1). It
looks at the middle m of the view, from the point

    p_f = c A R_fᵀ ((m − t_f)_x / s_f, (m − t_f)_y / s_f, −d)

with d free for an orthographic camera, whose view is h/s_f world units about its axis for h pixels. A format that
cannot animate that (glTF) lets the object grow by k_f = s_f / s̄ instead and uses s̄ throughout.

Where perspective was undone, with K = [f, 0, c; 0, f_y, c_y], the tracks before that are seen at
u − c = s (R X + t/s)_xy / (1 + s z/f): those of a pinhole camera at the distance d = f / s_f, m = c (the
equation of :mod:`nrsfm.perspective.geometry`). No scale is left over then: distance does it all.

A still camera, that of the reference frame r, sees the object moved by w ↦ C_r C_fᵀ (k_f w − p_f) + p_r, which in the
reference frame moves nothing but k.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.export.axes import UPRIGHT
from nrsfm.reconstruction import Reconstruction

_MARGIN = 0.1  # around the points, where the image's size is not known
_DISTANCE = 3.0  # of an orthographic camera from the object, in the object's radii: nothing is cut off in front


@dataclasses.dataclass(frozen=True, eq=False)
class Cameras:
    """Cameras of all frames.

    Attributes
    ----------
    orientations
        (F, 3, 3) world from camera; camera x right, y up, z backward.
    positions
        (F, 3) world.
    scales
        (F,) image unit per object unit, s_f; all 1 and of no use for perspective.
    growth
        (F,) k_f = s_f / s̄; 1 for perspective.
    window
        (left, right, top, bottom) of the view in the image, image unit.
    focal
        (fx, fy), image unit, or ``None`` for orthographic cameras.
    centre
        (2,) image point on the camera's axis.
    near, far
        Distances along the axis between which everything is.
    unit
        c, world unit per object unit.
    skew
        Of K, image unit: told of, because no camera of a file has it.
    """

    orientations: np.ndarray
    positions: np.ndarray
    scales: np.ndarray
    growth: np.ndarray
    window: tuple[float, float, float, float]
    focal: tuple[float, float] | None
    centre: np.ndarray
    near: float
    far: float
    unit: float
    skew: float = 0.0

    @property
    def kind(self) -> str:
        """``orthographic`` or ``perspective``."""
        return "orthographic" if self.focal is None else "perspective"

    @property
    def mean_scale(self) -> float:
        """s̄, the mean of the scales."""
        return float(self.scales.mean())

    @property
    def half_view(self) -> tuple[float, float]:
        """Half width and height, image unit, of the smallest view about ``centre`` that holds the window."""
        left, right, top, bottom = self.window
        x, y = (float(value) for value in self.centre)
        return max(right - x, x - left), max(bottom - y, y - top)

    @property
    def grows(self) -> bool:
        """Whether the scales differ by more than rounding."""
        return bool(np.ptp(self.growth) > 1e-6)

    def positions_at(self, scale: float) -> np.ndarray:
        """(F, 3) positions for a growing object seen at one scale: for orthographic cameras without their own."""
        if self.focal is not None:
            return self.positions
        local = np.einsum("fji,fj->fi", self.orientations, self.positions)
        local[:, :2] *= (self.scales / scale)[:, None]
        return np.asarray(np.einsum("fij,fj->fi", self.orientations, local))

    def still(self, reference: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Motion of the object before the reference frame's camera: turns (F, 3, 3), shifts (F, 3), growth (F,)."""
        base = self.orientations[reference]
        positions = self.positions_at(self.mean_scale)
        turns = base @ np.swapaxes(self.orientations, 1, 2)
        shifts = positions[reference] - np.einsum("fij,fj->fi", turns, positions)
        return turns, shifts, self.growth


def find_cameras(
    result: Reconstruction,
    world: np.ndarray,
    unit: float,
    image_size: tuple[float, float] | None,
    kept: np.ndarray,
) -> Cameras:
    """Return the cameras in the world ``c A X``, ``world`` (3, 3) being A and ``unit`` c; points ``kept`` are shown."""
    matrix = _intrinsics(result)
    low, high, radius, depth = _extent(result, kept)
    scales = np.asarray(result.scales, dtype=np.float64)
    if matrix is None:
        window = _window(low, high, image_size)
        centre = np.array([(window[0] + window[1]) / 2, (window[2] + window[3]) / 2])
        distances = np.full(len(scales), _DISTANCE * radius)
        focal, growth = None, scales / scales.mean()
    else:
        focal, centre = (float(matrix[0, 0]), float(matrix[1, 1])), matrix[:2, 2]
        distances, growth = focal[0] / scales, np.ones(len(scales))
        # The box of the points as undone perspective shows them is not that of the image: a little more room.
        low, high = low - depth * np.abs(low - centre), high + depth * np.abs(high - centre)
        window = _window(low, high, image_size)
    axes = np.swapaxes(np.asarray(result.rotations, dtype=np.float64), 1, 2)  # object from camera
    local = np.column_stack([(centre - result.translations) / scales[:, None], -distances])
    positions = unit * np.einsum("ij,fjk,fk->fi", world, axes, local)
    room = 1.1 * radius * float(growth.max())
    return Cameras(
        orientations=world @ axes @ UPRIGHT,
        positions=positions,
        scales=scales,
        growth=growth,
        window=window,
        focal=focal,
        centre=centre,
        near=unit * max(float(distances.min()) - room, 1e-3 * float(distances.min())),
        far=unit * (float(distances.max()) + room),
        unit=unit,
        skew=0.0 if matrix is None else float(matrix[0, 1]),
    )


def _intrinsics(result: Reconstruction) -> np.ndarray | None:
    """K where the reconstruction says that perspective was undone with it."""
    report = result.diagnostics.get("perspective")
    if not isinstance(report, dict) or not report.get("undone") or report.get("intrinsics") is None:
        return None
    from nrsfm.perspective.geometry import checked_intrinsics

    try:
        matrix = checked_intrinsics(np.array(report["intrinsics"], dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise InputError(f"diagnostics: 'perspective' must hold a camera matrix 'intrinsics': {error}") from error
    return matrix


def _extent(result: Reconstruction, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Box of the image points, largest distance from the object's origin, largest |s z / f| (0 without K)."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    radius = deepest = 0.0
    for f, shape in enumerate(result.shapes):
        turned = np.asarray(shape[kept], dtype=np.float64) @ result.rotations[f].T
        seen = result.scales[f] * turned[:, :2] + result.translations[f]
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        radius = max(radius, float(np.sqrt(np.max(np.sum(turned * turned, axis=1)))))
        deepest = max(deepest, float(result.scales[f] * np.abs(turned[:, 2]).max()))
    report: Any = result.diagnostics.get("perspective")
    focal = float(report["focal"]) if isinstance(report, dict) and report.get("focal") else np.inf
    return low, high, radius or 1.0, min(deepest / focal, 0.5)


def _window(
    low: np.ndarray, high: np.ndarray, image_size: tuple[float, float] | None
) -> tuple[float, float, float, float]:
    if image_size is not None:  # pixel centres are whole numbers: the image begins half a pixel before the first
        return -0.5, float(image_size[0]) - 0.5, -0.5, float(image_size[1]) - 0.5
    room = _MARGIN * max(float((high - low).max()), 1e-9)
    return float(low[0] - room), float(high[0] + room), float(low[1] - room), float(high[1] + room)
