"""What comes in: 2D point tracks and their visibility, checked once; converters for the paper's W and S."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from nrsfm.devices import is_on_device, namespace, to_host, type_of
from nrsfm.errors import InputError
from nrsfm.numerics.finite import all_finite
from nrsfm.streaming.stored import StoredPoints, is_stored

MINIMUM_FRAMES = 3
MINIMUM_POINTS = 4

LARGE = 256 * 2**20
"""Bytes from which on a memory map stays in its file."""

# Checks look at this many numbers at a time, so that they never hold a second array of the input's size.
_CHUNK = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Tracks:
    """Point tracks of one sequence, time first.

    ``float32`` and ``float64`` arrays of any order, read-only or memory-mapped, are kept without a copy (as a
    read-only view); other real types become ``float64``. Arrays of h5py and zarr, and memory maps of 256 MB or more,
    stay in their file: without ``visible`` their coordinates are checked when they are first read (``unchecked``).
    Complete arrays of PyTorch and CuPy stay on their device.
    Construction checks what every use needs; the size that a reconstruction needs is checked by
    :meth:`require_reconstructible`.

    Parameters
    ----------
    points
        (F, P, 2): x to the right and y down, in pixels (or any one unit), of P points in F frames.
    visible
        (F, P) bool, true where the point was seen, or ``None`` where all were. Coordinates where it is false
        are never used and may be NaN.

    Raises
    ------
    InputError
        The arrays have another shape or type, are empty, or hold NaN or infinity where the point is visible.
    """

    points: np.ndarray
    visible: np.ndarray | None = None
    n_missing: int = dataclasses.field(init=False, default=0)
    unchecked: bool = dataclasses.field(init=False, default=False)

    def __post_init__(self) -> None:
        if is_on_device(self.points):
            self._keep_on_device()
            return
        points = _whole_or_stored(self.points, "points")
        if points.ndim != 3 or points.shape[2] != 2:
            raise InputError(f"points: shape (frames, points, 2) is needed, received {points.shape}")
        if points.size == 0:
            raise InputError(f"points: at least one frame and one point are needed, received {points.shape}")
        visible = None if self.visible is None else _visibility(self.visible, points.shape[:2])
        stored = isinstance(points, StoredPoints) or (isinstance(points, np.memmap) and points.nbytes >= LARGE)
        object.__setattr__(self, "unchecked", stored and visible is None)
        if not self.unchecked:
            _check_finite(points if isinstance(points, np.ndarray) else np.asarray(points), visible)
        object.__setattr__(self, "points", points if isinstance(points, StoredPoints) else _read_only(points))
        object.__setattr__(self, "visible", None if visible is None else _read_only(visible))
        missing = 0 if visible is None else visible.size - int(np.count_nonzero(visible))
        object.__setattr__(self, "n_missing", missing)

    def _keep_on_device(self) -> None:
        """Check tracks of PyTorch or CuPy as far as can be told without moving them; complete ones stay there."""
        shape = tuple(self.points.shape)
        if len(shape) != 3 or shape[2] != 2 or 0 in shape:
            raise InputError(f"points: shape (frames, points, 2) is needed, received {shape}")
        type_of(self.points)
        if self.visible is not None:
            raise InputError("visible: tracks on a device must be complete; copy those with gaps to NumPy arrays")
        xp = namespace(self.points)
        if not bool(xp.all(xp.isfinite(self.points))):
            _check_finite(to_host(self.points), None)

    @property
    def on_device(self) -> bool:
        """Whether the points are an array of PyTorch or CuPy."""
        return is_on_device(self.points)

    @property
    def n_frames(self) -> int:
        """F, the number of frames."""
        return int(self.points.shape[0])

    @property
    def n_points(self) -> int:
        """P, the number of points."""
        return int(self.points.shape[1])

    @property
    def complete(self) -> bool:
        """Whether every point was seen in every frame."""
        return self.n_missing == 0

    def __repr__(self) -> str:
        seen = "complete" if self.complete else f"{self.n_missing} of {self.n_frames * self.n_points} missing"
        return f"Tracks({self.n_frames} frames, {self.n_points} points, {self.points.dtype}, {seen})"

    @classmethod
    def from_measurement_matrix(cls, matrix: Any, visible: Any = None) -> Tracks:
        """Return the tracks of the paper's ``W`` (2F×P, rows x₁, y₁, x₂, y₂, …), as a view of it.

        ``visible`` is (F, P) bool or ``None``. Raises ``InputError`` for an odd number of rows and for all
        that the constructor refuses.
        """
        matrix = _matrix(matrix, "W", 2)
        rows, columns = matrix.shape
        return cls(matrix.reshape(rows // 2, 2, columns).transpose(0, 2, 1), visible)

    def measurement_matrix(self) -> np.ndarray:
        """Return the paper's ``W`` (2F×P, rows x₁, y₁, x₂, …), not centred; a view where memory allows one.

        Entries that were not seen keep whatever the points hold there.
        """
        points = to_host(self.points) if self.on_device else self.points
        return np.asarray(points).transpose(0, 2, 1).reshape(2 * self.n_frames, self.n_points)

    @classmethod
    def from_point_first(cls, points: Any, occluded: Any = None) -> Tracks:
        """Return tracks of point-first arrays, as TAP-Vid has them: points (P, F, 2), occluded (P, F) bool.

        Both stay views. Raises ``InputError`` as the constructor does.
        """
        points = _real_array(points, "points", keep=(np.float32, np.float64))
        if points.ndim != 3 or points.shape[2] != 2:
            raise InputError(f"points: shape (points, frames, 2) is needed, received {points.shape}")
        if occluded is None:
            return cls(points.transpose(1, 0, 2))
        occluded = _plain_array(occluded, "occluded")
        if occluded.dtype != np.bool_ or occluded.shape != points.shape[:2]:
            raise InputError(
                f"occluded: a bool array of shape {points.shape[:2]} is needed, received {occluded.dtype} "
                f"{occluded.shape}"
            )
        return cls(points.transpose(1, 0, 2), ~occluded.T)

    def in_memory(self) -> Tracks:
        """The same tracks, in memory and checked where they were left in their file or on a device."""
        if self.on_device:
            return Tracks(to_host(self.points))
        return Tracks(np.array(self.points), self.visible) if self.unchecked else self

    def require_reconstructible(self) -> None:
        """Raise ``InputError`` where no shape can come out: too few frames or points, or all points equal."""
        if self.n_frames < MINIMUM_FRAMES:
            raise InputError(f"tracks: at least {MINIMUM_FRAMES} frames are needed, received {self.n_frames}")
        if self.n_points < MINIMUM_POINTS:
            raise InputError(f"tracks: at least {MINIMUM_POINTS} points are needed, received {self.n_points}")
        for f in range(self.n_frames):
            frame = to_host(self.points[f, ...]) if self.on_device else self.points[f]
            frame = frame if self.visible is None else frame[self.visible[f]]
            if len(frame) and bool(np.any(frame != frame[0])):
                return
        raise InputError(
            f"tracks: points at different places are needed, received {self.n_points} points that are all "
            f"equal in each of the {self.n_frames} frames"
        )


def shapes_from_matrix(matrix: Any) -> np.ndarray:
    """Return the shapes (F, P, 3) of the paper's ``S`` (3F×P, rows x₁, y₁, z₁, x₂, …), as a view of it.

    Raises ``InputError`` where it is not a real matrix whose number of rows is a multiple of 3.
    """
    matrix = _matrix(matrix, "S", 3)
    rows, columns = matrix.shape
    return matrix.reshape(rows // 3, 3, columns).transpose(0, 2, 1)


def shapes_to_matrix(shapes: Any) -> np.ndarray:
    """Return the paper's ``S`` (3F×P) of shapes (F, P, 3); a view where memory allows one.

    Raises ``InputError`` where the shapes are not a real array of that form.
    """
    shapes = _real_array(shapes, "shapes", keep=(np.float32, np.float64))
    if shapes.ndim != 3 or shapes.shape[2] != 3 or shapes.size == 0:
        raise InputError(f"shapes: shape (frames, points, 3) is needed, received {shapes.shape}")
    frames, points = shapes.shape[:2]
    return shapes.transpose(0, 2, 1).reshape(3 * frames, points)


def _whole_or_stored(value: Any, name: str) -> np.ndarray | StoredPoints:
    """Points as an array, or as they are in their file where a library or a map reads them when asked."""
    if is_stored(value):
        if np.dtype(value.dtype).kind not in "fiu":
            raise InputError(f"{name}: real numbers are needed, received dtype {value.dtype}")
        if len(value.shape) != 3 or value.shape[2] != 2:
            raise InputError(f"{name}: shape (frames, points, 2) is needed, received {tuple(value.shape)}")
        return StoredPoints(value)
    if isinstance(value, np.memmap) and value.ndim == 3 and value.nbytes >= LARGE and value.dtype.kind in "fiu":
        if value.dtype in (np.float32, np.float64):
            return value
        return StoredPoints(value)
    return value if isinstance(value, StoredPoints) else _real_array(value, name, keep=(np.float32, np.float64))


def _plain_array(value: Any, name: str) -> np.ndarray:
    if isinstance(value, np.ma.MaskedArray):
        raise InputError(
            f"{name}: a plain array is needed, received a masked array (say what was seen through 'visible')"
        )
    if isinstance(value, np.memmap):
        return value  # as it is, so that what was read of the file can be given back
    try:
        return np.asarray(value)
    except Exception as error:  # array-likes of other libraries raise what they like
        text = " ".join(str(error).split())
        raise InputError(f"{name}: an array is needed, received {type(value).__name__} ({text})") from error


def _real_array(value: Any, name: str, keep: tuple[type, ...]) -> np.ndarray:
    """``value`` as an array of one of the types in ``keep``, or else as float64."""
    array = _plain_array(value, name)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real numbers are needed, received dtype {array.dtype}")
    if any(array.dtype == kind for kind in keep):  # False for the other byte order, which solvers cannot take
        return array
    return array.astype(np.float64)


def _matrix(value: Any, name: str, rows_per_frame: int) -> np.ndarray:
    matrix = _real_array(value, name, keep=(np.float32, np.float64))
    needed = f"({rows_per_frame} x frames, points)"
    if matrix.ndim != 2:
        raise InputError(f"{name}: a matrix {needed} is needed, received shape {matrix.shape}")
    if matrix.size == 0:
        raise InputError(f"{name}: at least one frame and one point are needed, received shape {matrix.shape}")
    if matrix.shape[0] % rows_per_frame:
        rule = "an even number of rows" if rows_per_frame == 2 else "a number of rows that is a multiple of 3"
        raise InputError(f"{name}: {rule} is needed, received {matrix.shape[0]} rows (shape {matrix.shape})")
    return matrix


def _visibility(value: Any, shape: tuple[int, ...]) -> np.ndarray:
    visible = _plain_array(value, "visible")
    if visible.dtype != np.bool_:
        raise InputError(f"visible: a bool array is needed, received dtype {visible.dtype}")
    if visible.shape != shape:
        raise InputError(f"visible: shape {shape} is needed, as the points have, received {visible.shape}")
    return visible


def _read_only(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written through: what was checked stays what was checked."""
    view = array.view()
    view.flags.writeable = False
    return view


def _blocks(points: np.ndarray) -> Iterator[tuple[slice, slice]]:
    """Slices over frames and points that walk through memory in its order, ``_CHUNK`` numbers at a time."""
    frames, count = points.shape[:2]
    if abs(points.strides[0]) >= abs(points.strides[1]):
        step = max(1, _CHUNK // (2 * count))
        for start in range(0, frames, step):
            yield slice(start, start + step), slice(None)
    else:
        step = max(1, _CHUNK // (2 * frames))
        for start in range(0, count, step):
            yield slice(None), slice(start, start + step)


def _check_finite(points: np.ndarray, visible: np.ndarray | None) -> None:
    entries = numbers = 0
    first: tuple[int, int] | None = None
    for rows, columns in _blocks(points):
        if all_finite(points[rows, columns]):
            continue
        wrong = ~np.isfinite(points[rows, columns])
        if visible is not None:
            wrong &= visible[rows, columns, np.newaxis]
            if not wrong.any():
                continue
        numbers += int(np.count_nonzero(wrong))
        where = np.argwhere(wrong.any(axis=2))  # frame-major: the first is this block's smallest
        entries += len(where)
        here = (int(where[0, 0]) + (rows.start or 0), int(where[0, 1]) + (columns.start or 0))
        first = here if first is None else min(first, here)
    if first is None:
        return
    value = points[first]
    raise InputError(
        f"points: every visible coordinate must be finite, received {numbers} that are NaN or infinite, in "
        f"{entries} of {points.shape[0] * points.shape[1]} entries, the first at frame {first[0]}, point "
        f"{first[1]}: ({value[0]:g}, {value[1]:g})"
    )
