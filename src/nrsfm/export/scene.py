"""What every writer needs, worked out once: points in the world's axes, faces, colours, attributes, cameras, time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from nrsfm.errors import InputError, OptionError
from nrsfm.export.axes import world_from_object
from nrsfm.export.cameras import Cameras, find_cameras
from nrsfm.export.options import FORMATS, ExportOptions
from nrsfm.export.surfaces import Surface
from nrsfm.reconstruction import Reconstruction


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """N points that are written, of the P of a reconstruction.

    Attributes
    ----------
    result, options
        What is exported, and how.
    kept
        (N,) the numbers of the points that are written: those that were reconstructed.
    world
        (3, 3) world from object.
    unit
        World unit per object unit, in the numbers of the file.
    metres
        Metres per number of the file, or ``None`` where the format has no unit.
    faces
        (T, 3) int32 of numbers below N, or ``None`` for points.
    colours
        (N, 3) uint8 sRGB, or ``None``.
    cameras
        In the world, in its unit.
    notes
        Where faces come from, and what to know, in words.
    """

    result: Reconstruction
    options: ExportOptions
    kept: np.ndarray
    world: np.ndarray
    unit: float
    metres: float | None
    faces: np.ndarray | None
    colours: np.ndarray | None
    cameras: Cameras
    surface: str
    warnings: tuple[str, ...]

    @property
    def n_frames(self) -> int:
        """F."""
        return self.result.n_frames

    @property
    def n_points(self) -> int:
        """N."""
        return len(self.kept)

    @property
    def left_out(self) -> int:
        """How many points are not written."""
        return self.result.n_points - len(self.kept)

    @property
    def reference(self) -> int:
        """The frame whose camera the world's axes are those of."""
        return self.options.reference

    @property
    def view(self) -> tuple[float, float]:
        """(width, height) of the cameras' picture, image unit: the window, but symmetric about the axis in glTF."""
        left, right, top, bottom = self.cameras.window
        if self.options.format == "usd":
            return right - left, bottom - top
        across, down = self.cameras.half_view
        return 2 * across, 2 * down

    @property
    def times(self) -> np.ndarray:
        """(F,) seconds, float64."""
        return np.asarray(np.arange(self.n_frames) / self.options.fps)

    def still_points(self, frame: int) -> np.ndarray:
        """(N, 3) float64: the points of a frame in the world, the camera moving."""
        shape = np.asarray(self.result.shapes[frame], dtype=np.float64)
        return np.asarray((shape if self.left_out == 0 else shape[self.kept]) @ (self.unit * self.world).T)

    def points(self, frame: int) -> np.ndarray:
        """(N, 3) float64: the points of a frame in the world, moving as ``options.frame`` says."""
        points = self.still_points(frame)
        if self.options.frame == "object":
            return points
        turns, shifts, growth = self._still
        return np.asarray(growth[frame] * (points @ turns[frame].T) + shifts[frame])

    def sequence(self) -> Iterator[np.ndarray]:
        """Yield the points of one frame after the other."""
        for frame in range(self.n_frames):
            yield self.points(frame)

    @property
    def _still(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.cameras.still(self.reference)

    @property
    def groups(self) -> np.ndarray | None:
        """(N,) int32, or ``None``."""
        return None if self.result.groups is None else self.result.groups[self.kept].astype(np.int32)

    def has(self, name: str) -> bool:
        """Whether there is ``confidence`` or ``depth_deviation``."""
        return getattr(self.result, name) is not None

    def per_frame(self, name: str, frame: int) -> np.ndarray:
        """(N,) float32 ``confidence`` or ``depth_deviation`` (in the world's unit) of a frame."""
        row = getattr(self.result, name)[frame, self.kept].astype(np.float32)
        return np.asarray(row * np.float32(self.unit) if name == "depth_deviation" else row)

    def about(self) -> dict[str, Any]:
        """What a reader of the file may want to know, as plain values."""
        options = self.options
        return {
            "frames": self.n_frames,
            "fps": float(options.fps),
            "reference_frame": int(options.reference),
            "frame": options.frame,
            "axes": options.axes,
            "unit": f"{self.unit:.9g} per unit of the reconstruction",
            **({} if self.metres is None else {"metres_per_unit": float(self.metres)}),
            "points": {"written": self.n_points, "of": self.result.n_points},
            "surface": self.surface,
            "camera": self.cameras.kind,
            "view": list(self.view),
            "method": self.result.method,
        }


def make_scene(
    result: Reconstruction, options: ExportOptions, surface: Surface | None, colours: np.ndarray | None
) -> Scene:
    """Bring a reconstruction into the world of a file; ``colours`` (P, 3) uint8 or ``None``."""
    form = FORMATS[options.format]
    if options.reference >= result.n_frames:
        raise OptionError(
            f"option 'reference' must be a frame from 0 to {result.n_frames - 1}, received {options.reference}"
        )
    kept = np.flatnonzero(result.reconstructed)
    metres, unit = None, 1.0 if options.scale is None else float(options.scale)
    if form.metres:
        metres = unit if options.scale is not None else _one_metre(result, kept, options.reference)
        unit = 1.0 if options.format == "usd" else metres  # USD states its unit, glTF's is the metre
    if not np.isfinite(np.float32(unit)) or unit < np.finfo(np.float32).tiny:
        raise InputError(f"option 'scale': a number that float32 can hold is needed, received {unit:g}")
    world = world_from_object(result.rotations[options.reference], options.axes)
    cameras = find_cameras(result, world, unit, options.image_size, kept)
    skewed = (
        [f"the camera matrix has a skew of {cameras.skew:g}, which no camera of a file has: it is left out"]
        if cameras.skew
        else []
    )
    faces = None
    if surface is not None:
        number = np.full(result.n_points, -1, dtype=np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        faces = number[surface.faces]
    return Scene(
        result=result,
        options=options,
        kept=kept,
        world=world,
        unit=unit,
        metres=1.0 if options.format == "glb" else metres,
        faces=faces,
        colours=None if colours is None else colours[kept],
        cameras=cameras,
        surface="points, without faces" if surface is None else surface.origin,
        warnings=(*(() if surface is None else surface.warnings), *skewed),
    )


def _one_metre(result: Reconstruction, kept: np.ndarray, reference: int) -> float:
    """Metres per unit that make the largest side of the box around the reference frame's points one metre."""
    shape = np.asarray(result.shapes[reference], dtype=np.float64)[kept] @ result.rotations[reference].T
    side = float(np.ptp(shape, axis=0).max())
    return float(f"{1.0 / side:.4g}") if side > 0 else 1.0
