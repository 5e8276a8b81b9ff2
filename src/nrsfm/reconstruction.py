"""What comes out: the shape and the camera of every frame, which together give the tracks back.

points[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T + translations[f].
"""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.devices import is_on_device, namespace, to_device, to_host, type_of
from nrsfm.errors import FileError, InputError
from nrsfm.numerics.finite import all_finite
from nrsfm.streaming.readers import WrittenMap, release

if TYPE_CHECKING:
    from nrsfm.tracks import Tracks

# Rotations come out of float64 polar factors, or out of a user's float32 file: either is far below this.
_ORTHONORMAL = 1e-3
_MIRROR = np.array([1.0, 1.0, -1.0])
_LEAST_POINTS = 4  # of a sequence in which some points could not be reconstructed


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """The 3D shape in every frame, and the camera that saw it.

    A point that was seen in too few frames is not invented: it is NaN in every frame (see :attr:`reconstructed`).
    Whatever is computed from it is NaN too.

    Attributes
    ----------
    shapes
        (F, P, 3) float32 or float64: the points of each frame in the object frame, in the unit of the tracks. A
        point is finite in every frame, or NaN in every frame and coordinate; at least 4 points are finite. Of tracks
        of PyTorch or CuPy an array of theirs, as is ``depth_deviation``; :meth:`on_host` has them in NumPy's.
    rotations
        (F, 3, 3) float64, orthonormal with determinant 1: camera from object; x right, y down, z forward.
    translations
        (F, 2) float64, in the unit of the tracks: where the object's origin is seen.
    scales
        (F,) float64, positive: image unit per object unit (1 under pure orthography).
    groups
        (P,) int: the subspace label of each point, or ``None`` where the method has none.
    diagnostics
        Plain numbers, strings, lists and dicts: what the run found, and ``"warnings"`` in plain words.
    method, options
        How it was made.
    confidence
        (F, P) float32 from 0 to 1: how much each measurement was trusted. 1 where it was used and fits, near 0
        for an outlier, 0 where the point was not seen or not reconstructed. ``None``: all were used fully.
    depth_deviation
        (F, P) float32, at least 0: standard deviation of the depth of each point along its frame's camera axis,
        in the unit of the shapes; NaN for points that were not reconstructed. ``None`` where it is not known.

    Raises
    ------
    InputError
        An array has another shape or type than these, or breaks its rule.
    """

    shapes: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    scales: np.ndarray
    groups: np.ndarray | None = None
    diagnostics: dict[str, Any] = dataclasses.field(default_factory=dict)
    method: str = ""
    options: dict[str, Any] = dataclasses.field(default_factory=dict)
    confidence: np.ndarray | None = None
    depth_deviation: np.ndarray | None = None

    def __post_init__(self) -> None:
        shapes = self.shapes if is_on_device(self.shapes) else _real(self.shapes, "shapes")
        if shapes.ndim != 3 or shapes.shape[2] != 3 or 0 in shapes.shape:
            raise InputError(f"shapes: shape (frames, points, 3) is needed, received {tuple(shapes.shape)}")
        if is_on_device(shapes):
            type_of(shapes)
        elif shapes.dtype not in (np.float32, np.float64):
            shapes = shapes.astype(np.float64)
        frames, points = shapes.shape[:2]
        reconstructed = _check_points(shapes)
        checked: dict[str, Any] = {"shapes": shapes}
        for name, shape in (
            ("rotations", (frames, 3, 3)),
            ("translations", (frames, 2)),
            ("scales", (frames,)),
        ):
            array = _of_shape(getattr(self, name), name, shape).astype(np.float64, copy=False)
            bad = int(np.count_nonzero(~np.isfinite(array)))
            if bad:
                raise InputError(f"{name}: every number must be finite, received {bad} that are NaN or infinite")
            checked[name] = array
        _check_rotations(checked["rotations"])
        if not np.all(checked["scales"] > 0):
            raise InputError(f"scales: every scale must be positive, received {checked['scales'].min():g}")
        if self.groups is not None:
            groups = np.asarray(self.groups)
            if groups.dtype.kind not in "iu" or groups.shape != (points,):
                raise InputError(f"groups: {points} integers are needed, received {groups.dtype} {groups.shape}")
            checked["groups"] = groups
        for name, check in (("confidence", _check_confidence), ("depth_deviation", _check_deviation)):
            value = getattr(self, name)
            if value is not None and not is_on_device(value):  # there it was made along with the shapes
                array = _of_shape(value, name, (frames, points)).astype(np.float32, copy=False)
                check(array, reconstructed)
                checked[name] = array
        for name in ("diagnostics", "options"):
            if not isinstance(getattr(self, name), dict):
                raise InputError(f"{name}: a dict is needed, received {type(getattr(self, name)).__name__}")
        if not isinstance(self.method, str):
            raise InputError(f"method: a name is needed, received {self.method!r}")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def on_host(self) -> Reconstruction:
        """The same with NumPy arrays, copied where they are PyTorch's or CuPy's."""
        if not is_on_device(self.shapes):
            return self
        deviation = None if self.depth_deviation is None else to_host(self.depth_deviation)
        return dataclasses.replace(self, shapes=to_host(self.shapes), depth_deviation=deviation)

    @property
    def n_frames(self) -> int:
        """F, the number of frames."""
        return int(self.shapes.shape[0])

    @property
    def n_points(self) -> int:
        """P, the number of points, those that could not be reconstructed included."""
        return int(self.shapes.shape[1])

    @property
    def reconstructed(self) -> np.ndarray:
        """(P,) bool: the points that have a shape; the others are NaN in every frame."""
        first = self.shapes[0, :, 0]
        return np.asarray(np.isfinite(to_host(first) if is_on_device(first) else first))

    @property
    def n_missing(self) -> int:
        """How many points could not be reconstructed."""
        return self.n_points - int(np.count_nonzero(self.reconstructed))

    def __repr__(self) -> str:
        missing = f" ({self.n_missing} not reconstructed)" if self.n_missing else ""
        return f"Reconstruction({self.n_frames} frames, {self.n_points} points{missing}, method={self.method!r})"

    def project(self) -> np.ndarray:
        """Return the points as the cameras see them, (F, P, 2), in the unit and dtype of the shapes."""
        self = self.on_host()
        out = np.empty((self.n_frames, self.n_points, 2), dtype=self.shapes.dtype)
        for f, shape in enumerate(self.shapes):  # frame by frame: no float64 copy of the whole sequence
            out[f] = self.scales[f] * (shape @ self.rotations[f, :2].T) + self.translations[f]
        return out

    def camera_shapes(self) -> np.ndarray:
        """Return the shapes in the frame of each frame's camera, (F, P, 3): x right, y down, z away from it.

        Neither scale nor translation is applied: the unit is the shapes'.
        """
        self = self.on_host()
        out = np.empty_like(self.shapes, order="C")
        for f, shape in enumerate(self.shapes):
            out[f] = shape @ self.rotations[f].T
        return out

    def camera_depths(self) -> np.ndarray:
        """Return the depth of every point along its frame's camera axis, (F, P), in the unit of the shapes.

        It grows away from the camera and is 0 at the object's origin; ``depth_deviation`` is its standard deviation.
        """
        self = self.on_host()
        out = np.empty((self.n_frames, self.n_points), dtype=self.shapes.dtype)
        for f, shape in enumerate(self.shapes):
            out[f] = shape @ self.rotations[f, 2]
        return out

    def mirrored(self) -> Reconstruction:
        """Return the other solution, which the same cameras would see as the same tracks.

        Orthography cannot tell depth z from −z. With D = diag(1, 1, −1), every rotation R becomes D R D and
        every shape S (P×3) becomes S D, so that in the camera's frame x and y stay and z changes its sign.
        """
        mirror: Any = _MIRROR.astype(np.float32)  # signs: exact in any type
        if is_on_device(self.shapes):
            mirror = to_device(mirror.astype(type_of(self.shapes)), self.shapes)
        diagnostics = dict(self.diagnostics)
        if not diagnostics.pop("mirrored", False):
            diagnostics["mirrored"] = True
        return dataclasses.replace(
            self,
            shapes=self.shapes * mirror,
            rotations=self.rotations * np.outer(_MIRROR, _MIRROR),
            diagnostics=diagnostics,
        )

    def reprojection_errors(self, tracks: Tracks) -> np.ndarray:
        """Return the image distance of each track from its reprojection, (F, P), in the tracks' unit.

        NaN where a point was not seen, or not reconstructed. Raises ``InputError`` where the tracks are of
        another size.
        """
        self = self.on_host()
        points, shape = np.asarray(tracks.in_memory().points), (self.n_frames, self.n_points, 2)
        if points.shape != shape:
            raise InputError(f"tracks: points of shape {shape} are needed, received {points.shape}")
        errors = np.empty(shape[:2])
        for f in range(self.n_frames):  # in float64: float32 would lose far-away tracks' digits
            seen = self.scales[f] * (self.shapes[f] @ self.rotations[f, :2].T) + self.translations[f]
            errors[f] = np.linalg.norm(seen - points[f], axis=1)
        if tracks.visible is not None:
            errors[~np.asarray(tracks.visible)] = np.nan
        return errors

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
        """Write everything to one ``.npz`` file without pickled objects, whole or not at all.

        The arrays have the names of the attributes; ``about`` is a JSON text with the rest.

        Raises
        ------
        FileError
            The name does not end in ``.npz``, or the file cannot be written.
        InputError
            ``diagnostics`` or ``options`` hold something that JSON has no word for.
        """
        from nrsfm.files.reconstructions import write_reconstruction

        write_reconstruction(self.on_host(), path, overwrite=overwrite)


def load_reconstruction(path: str | os.PathLike[str]) -> Reconstruction:
    """Read a file that :meth:`Reconstruction.save` wrote, of this version or an older one. Nothing is unpickled.

    Raises
    ------
    FileError
        There is no such file, it is truncated or something else, or its content breaks a rule of
        :class:`Reconstruction`.
    """
    from nrsfm.files.reconstructions import read_reconstruction

    try:
        return Reconstruction(**read_reconstruction(path))
    except InputError as error:
        raise FileError(f"'{path}' is not a valid reconstruction: {error}") from error


def _real(value: Any, name: str) -> np.ndarray:
    array = value if isinstance(value, np.memmap) else np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real numbers are needed, received dtype {array.dtype}")
    return array


def _of_shape(value: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    array = _real(value, name)
    if array.shape != shape:
        raise InputError(f"{name}: shape {shape} is needed, received {array.shape}")
    return array


def _check_points(shapes: np.ndarray) -> np.ndarray:
    """Return which points (P,) are finite in every frame; the others must be NaN everywhere."""
    if isinstance(shapes, WrittenMap):
        return np.ones(shapes.shape[1], dtype=bool)
    if is_on_device(shapes):
        xp = namespace(shapes)
        if not bool(xp.all(xp.isfinite(shapes))):
            raise InputError("shapes: on a device every coordinate must be finite, received NaN or infinity")
        return np.ones(shapes.shape[1], dtype=bool)
    if all(_walked(all_finite(frame), shapes) for frame in shapes):  # frame by frame: no mask of the input's size
        return np.ones(shapes.shape[1], dtype=bool)
    finite = np.isfinite(shapes[0, :, 0])
    for f, frame in enumerate(shapes):
        wrong = np.where(finite, ~np.isfinite(frame).all(axis=1), ~np.isnan(frame).all(axis=1))
        if wrong.any():
            point = int(np.argmax(wrong))
            raise InputError(
                "shapes: a point must be finite in every frame, or NaN in every frame and coordinate where it could "
                f"not be reconstructed, received point {point} with {_listed(frame[point])} in frame {f} and "
                f"{_listed(shapes[0, point])} in frame 0"
            )
    count = int(np.count_nonzero(finite))
    if count < _LEAST_POINTS:
        raise InputError(
            f"shapes: at least {_LEAST_POINTS} points must be finite, received {count} of {len(finite)}, the others NaN"
        )
    return finite


def _walked(found: bool, array: np.ndarray) -> bool:
    """What was found in a frame; its pages are given back where the array is a map of a file."""
    release(array)
    return found


def _listed(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in point) + ")"


def _check_confidence(confidence: np.ndarray, reconstructed: np.ndarray) -> None:
    for f, row in enumerate(confidence):
        wrong = ~((row >= 0) & (row <= 1))  # NaN too
        if wrong.any():
            point = int(np.argmax(wrong))
            raise InputError(
                f"confidence: numbers from 0 to 1 are needed, received {row[point]:g} in frame {f}, point {point}"
            )
        lost = (row > 0) & ~reconstructed
        if lost.any():
            point = int(np.argmax(lost))
            raise InputError(
                "confidence: 0 is needed for points that were not reconstructed, received "
                f"{row[point]:g} in frame {f}, point {point}"
            )


def _check_deviation(deviation: np.ndarray, reconstructed: np.ndarray) -> None:
    if isinstance(deviation, WrittenMap):
        return
    for f, row in enumerate(deviation):
        release(deviation)
        wrong = ~(np.isfinite(row) & (row >= 0)) & reconstructed
        wrong |= ~np.isnan(row) & ~reconstructed
        if wrong.any():
            point = int(np.argmax(wrong))
            rule = "a finite number of at least 0" if reconstructed[point] else "NaN, as it was not reconstructed,"
            raise InputError(
                f"depth_deviation: {rule} is needed for point {point}, received {row[point]:g} in frame {f}"
            )


def _check_rotations(rotations: np.ndarray) -> None:
    gaps = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    worst = int(np.argmax(gaps))
    if gaps[worst] > _ORTHONORMAL:
        raise InputError(
            f"rotations: every matrix must be orthonormal, received one (frame {worst}) "
            f"that is off by {gaps[worst]:.2g}"
        )
    determinants = np.linalg.det(rotations)
    if np.any(determinants < 0):
        raise InputError(f"rotations: every determinant must be 1, received -1 in frame {int(np.argmin(determinants))}")
