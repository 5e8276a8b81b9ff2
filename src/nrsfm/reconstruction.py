"""What comes out: the shape and the camera of every frame, which together give the tracks back.

points[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T + translations[f].
"""

from __future__ import annotations

import dataclasses
import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import FileError, InputError

if TYPE_CHECKING:
    from nrsfm.tracks import Tracks

_FORMAT = "nrsfm-reconstruction-1"
_ARRAYS = ("shapes", "rotations", "translations", "scales")
_NAMES = (*_ARRAYS, "about")
# Rotations come out of float64 polar factors, or out of a user's float32 file: either is far below this.
_ORTHONORMAL = 1e-3
_MIRROR = np.array([1.0, 1.0, -1.0])


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """The 3D shape in every frame, and the camera that saw it.

    Attributes
    ----------
    shapes
        (F, P, 3) float32 or float64: the points of each frame in the object frame, in the unit of the tracks.
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

    Raises
    ------
    InputError
        An array has another shape or type than these, or holds NaN or infinity.
    """

    shapes: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    scales: np.ndarray
    groups: np.ndarray | None = None
    diagnostics: dict[str, Any] = dataclasses.field(default_factory=dict)
    method: str = ""
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        shapes = _real(self.shapes, "shapes")
        if shapes.ndim != 3 or shapes.shape[2] != 3 or shapes.size == 0:
            raise InputError(f"shapes: shape (frames, points, 3) is needed, received {shapes.shape}")
        if shapes.dtype not in (np.float32, np.float64):
            shapes = shapes.astype(np.float64)
        frames, points = shapes.shape[:2]
        checked: dict[str, Any] = {"shapes": shapes}
        for name, shape in (
            ("rotations", (frames, 3, 3)),
            ("translations", (frames, 2)),
            ("scales", (frames,)),
        ):
            array = _real(getattr(self, name), name)
            if array.shape != shape:
                raise InputError(f"{name}: shape {shape} is needed, received {array.shape}")
            checked[name] = array.astype(np.float64, copy=False)
        for name, array in checked.items():
            _check_finite(array, name)
        _check_rotations(checked["rotations"])
        if not np.all(checked["scales"] > 0):
            raise InputError(f"scales: every scale must be positive, received {checked['scales'].min():g}")
        if self.groups is not None:
            groups = np.asarray(self.groups)
            if groups.dtype.kind not in "iu" or groups.shape != (points,):
                raise InputError(f"groups: {points} integers are needed, received {groups.dtype} {groups.shape}")
            checked["groups"] = groups
        for name in ("diagnostics", "options"):
            if not isinstance(getattr(self, name), dict):
                raise InputError(f"{name}: a dict is needed, received {type(getattr(self, name)).__name__}")
        if not isinstance(self.method, str):
            raise InputError(f"method: a name is needed, received {self.method!r}")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def n_frames(self) -> int:
        """F, the number of frames."""
        return int(self.shapes.shape[0])

    @property
    def n_points(self) -> int:
        """P, the number of points."""
        return int(self.shapes.shape[1])

    def __repr__(self) -> str:
        return f"Reconstruction({self.n_frames} frames, {self.n_points} points, method={self.method!r})"

    def project(self) -> np.ndarray:
        """Return the points as the cameras see them, (F, P, 2), in the unit and dtype of the shapes."""
        out = np.empty((self.n_frames, self.n_points, 2), dtype=self.shapes.dtype)
        for f, shape in enumerate(self.shapes):  # frame by frame: no float64 copy of the whole sequence
            out[f] = self.scales[f] * (shape @ self.rotations[f, :2].T) + self.translations[f]
        return out

    def camera_shapes(self) -> np.ndarray:
        """Return the shapes in the frame of each frame's camera, (F, P, 3): x right, y down, z away from it.

        Neither scale nor translation is applied: the unit is the shapes'.
        """
        out = np.empty_like(self.shapes, order="C")
        for f, shape in enumerate(self.shapes):
            out[f] = shape @ self.rotations[f].T
        return out

    def mirrored(self) -> Reconstruction:
        """Return the other solution, which the same cameras would see as the same tracks.

        Orthography cannot tell depth z from −z. With D = diag(1, 1, −1), every rotation R becomes D R D and
        every shape S (P×3) becomes S D, so that in the camera's frame x and y stay and z changes its sign.
        """
        mirror = _MIRROR.astype(self.shapes.dtype)
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

        Points that were not seen get NaN. Raises ``InputError`` where the tracks are of another size.
        """
        points, shape = np.asarray(tracks.points), (self.n_frames, self.n_points, 2)
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
        from nrsfm.files.atomic import atomic_file

        if Path(path).suffix.lower() != ".npz":
            raise FileError(f"cannot save a reconstruction as '{path}': the name must end in .npz")
        about = {
            "format": _FORMAT,
            "method": self.method,
            "options": self.options,
            "diagnostics": self.diagnostics,
        }
        try:
            text = json.dumps(about, default=_plain)
        except (TypeError, ValueError) as error:
            raise InputError(f"cannot save '{path}': options or diagnostics do not fit JSON: {error}") from error
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        if self.groups is not None:
            arrays["groups"] = self.groups
        with atomic_file(path, overwrite=overwrite) as stream:
            # Not compressed: the mantissas of coordinates are noise, and the gain would be a few percent.
            np.savez(stream, about=np.array(text), **arrays)


def load_reconstruction(path: str | os.PathLike[str]) -> Reconstruction:
    """Read a file that :meth:`Reconstruction.save` wrote. Nothing is ever unpickled.

    Raises
    ------
    FileError
        There is no such file, it is truncated or something else, or its content breaks a rule of
        :class:`Reconstruction`.
    """
    found = _read_arrays(path)
    about = _read_about(path, found["about"])
    try:
        return Reconstruction(
            **{name: found[name] for name in _ARRAYS},
            groups=found.get("groups"),
            diagnostics=about["diagnostics"],
            method=about["method"],
            options=about["options"],
        )
    except InputError as error:
        raise FileError(f"'{path}' is not a valid reconstruction: {error}") from error


def _read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    try:
        with open(path, "rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise FileError(f"'{path}' is not a reconstruction: it is not a .npz file, or it is truncated")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                missing = [name for name in _NAMES if name not in archive.files]
                if missing:
                    listed = ", ".join(sorted(archive.files)) or "nothing"
                    raise FileError(f"'{path}' is not a reconstruction: {', '.join(missing)} missing, found {listed}")
                return {name: archive[name] for name in (*_NAMES, "groups") if name in archive.files}
    except FileError:  # a ValueError too: keep it from the clause below
        raise
    except OSError as error:
        raise FileError(f"cannot read '{path}': {error.strerror or error}") from error
    except (
        zipfile.BadZipFile,
        zlib.error,
        ValueError,
        EOFError,
        KeyError,
        RuntimeError,
        MemoryError,
    ) as error:
        # ValueError covers pickled members and malformed headers, RuntimeError encrypted ones.
        raise FileError(f"'{path}' is not a reconstruction: {_first_line(error)}") from error


def _read_about(path: str | os.PathLike[str], array: np.ndarray) -> dict[str, Any]:
    try:
        about = json.loads(str(array[()])) if array.dtype.kind == "U" and array.ndim == 0 else None
    except ValueError:
        about = None
    if not isinstance(about, dict) or not {"format", "method", "options", "diagnostics"} <= about.keys():
        raise FileError(f"'{path}' is not a valid reconstruction: 'about' is not the JSON text that save() writes")
    if about["format"] != _FORMAT:
        raise FileError(f"'{path}' has format {about['format']!r}, and this version of nrsfm reads '{_FORMAT}'")
    return about


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__


def _real(value: Any, name: str) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real numbers are needed, received dtype {array.dtype}")
    return array


def _check_finite(array: np.ndarray, name: str) -> None:
    bad = sum(int(np.count_nonzero(~np.isfinite(part))) for part in array)
    if bad:
        raise InputError(f"{name}: every number must be finite, received {bad} that are NaN or infinite")


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


def _plain(value: Any) -> Any:
    """JSON's word for a NumPy scalar or array."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} {value!r}")
