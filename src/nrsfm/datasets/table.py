"""The data sets that ``load`` knows: what they are, how large, whose."""

from __future__ import annotations

import dataclasses

from nrsfm.errors import InputError, suggest

_FACES = ("face_poses.npz", "face_sequences.npz")
_ICT = ("ict_face_model.npz", "ict_sequences.npz")
_TAKES = ("ict_face_model.npz", "ict_livelink_rom_coeffs.npz")
_FACES_ORIGIN = "face-poses mesh (Sumner and Popović) through CraGL/Hyperspectral-Inverse-Skinning"
_ICT_ORIGIN = "ICT-FaceKit blendshapes moved by LiveLink range-of-motion takes"
_FACES_LICENCE = "MIT repository, mesh of a third party without a stated licence"
_NONE = "no licence stated"
_NON_COMMERCIAL = "non-commercial use"


@dataclasses.dataclass(frozen=True)
class DatasetInfo:
    """One row of the table; ``frames`` and ``points`` are those of the default options."""

    name: str
    frames: int
    points: int
    title: str
    camera: str
    truth: str
    units: str
    origin: str
    licence: str
    files: tuple[str, ...]


def _face(number: int, frames: int, motion: str) -> DatasetInfo:
    return DatasetInfo(
        f"face-seq{number}",
        frames,
        29299,
        f"stand-in for the dense synthetic face {number}: {motion}",
        "orthographic",
        "shapes, rotations",
        "model units",
        _FACES_ORIGIN,
        _FACES_LICENCE,
        _FACES,
    )


def _ict(name: str, frames: int, title: str, camera: str, files: tuple[str, ...]) -> DatasetInfo:
    return DatasetInfo(name, frames, 6706, title, camera, "shapes, rotations", "model units", _ICT_ORIGIN, "MIT", files)


def _mocap(name: str, frames: int, points: int, title: str, licence: str = _NONE) -> DatasetInfo:
    return DatasetInfo(
        name,
        frames,
        points,
        title,
        "orthographic",
        "shapes, rotations",
        "not stated",
        "motion capture classic",
        licence,
        (f"{name}.npz",),
    )


def _other(
    name: str,
    frames: int,
    points: int,
    title: str,
    camera: str,
    units: str,
    origin: str,
    licence: str = _NONE,
) -> DatasetInfo:
    return DatasetInfo(name, frames, points, title, camera, "shapes", units, origin, licence, (f"{name}.npz",))


_PERSPECTIVE = "perspective"
_CAMERA_FRAME = "orthographic; shapes are in the camera's frame, the tracks are their x and y"
_PATH = "orthographic; chosen by the loader unless rotations= says otherwise"
_SURFACES = "deforming surface benchmark"
_PIXELS, _PIXELS_MM = "pixels; unit of the truth not stated", "pixels, truth in mm"

_ROWS = (
    _face(1, 10, "one expression a frame, camera ±30°"),
    _face(2, 10, "one expression a frame, camera ±90°"),
    _face(3, 99, "smooth expressions, fast camera"),
    _face(4, 99, "smooth expressions, slow camera"),
    _ict("ict-rom99", 99, "face with real expressions", "orthographic", _ICT),
    _ict("ict-rom346", 346, "face with real expressions, longer", "orthographic", _ICT),
    _ict("ict-take3", 4030, "face, a whole range-of-motion take", _PATH, _TAKES),
    _ict("ict-take4", 3809, "face, a whole range-of-motion take", _PATH, _TAKES),
    _mocap("pickup", 357, 41, "a person picks something up"),
    _mocap("yoga", 307, 41, "a person does yoga"),
    _mocap("stretch", 370, 41, "a person stretches"),
    _mocap("drink", 1102, 41, "a person drinks"),
    _mocap("dance", 264, 75, "a person dances", _NON_COMMERCIAL),
    _mocap("face1", 74, 37, "markers on a talking face", _NON_COMMERCIAL),
    _other(
        "walking",
        260,
        55,
        "a person walks",
        _CAMERA_FRAME,
        "not stated",
        "motion capture classic",
        _NON_COMMERCIAL,
    ),
    _other(
        "shark",
        240,
        91,
        "a synthetic shark swims",
        _CAMERA_FRAME,
        "model units",
        "synthetic classic",
        _NON_COMMERCIAL,
    ),
    _other(
        "back_real126",
        150,
        126,
        "tracks from a real video of a bending back",
        _PERSPECTIVE,
        _PIXELS_MM,
        "real video",
    ),
    _other(
        "back_real245",
        150,
        245,
        "the same video, more tracks, truth known in part",
        _PERSPECTIVE,
        _PIXELS_MM,
        "real video",
    ),
    _other("mat1500_persp", 60, 1500, "a bending mat", _PERSPECTIVE, _PIXELS_MM, _SURFACES),
    _other("flag250_persp", 30, 250, "a deforming flag", _PERSPECTIVE, _PIXELS, _SURFACES),
    _other("hulk_persp", 21, 122, "a deforming surface, truth known in part", _PERSPECTIVE, _PIXELS, _SURFACES),
    _other(
        "mesh_horse_gallop",
        48,
        8431,
        "a galloping horse, large deformation",
        _PATH,
        "model units",
        "Sumner and Popović",
    ),
)

_TABLE = {info.name: info for info in _ROWS}


def names() -> list[str]:
    """Return the names that ``load`` takes."""
    return list(_TABLE)


def table() -> tuple[DatasetInfo, ...]:
    """Return what is known about every data set."""
    return _ROWS


def find(name: str) -> DatasetInfo:
    """Return the row of ``name``; ``-`` and ``_`` count as equal, and so do small and capital letters.

    Raises
    ------
    InputError
        There is none; the nearest names are suggested.
    """
    plain = {n.lower().replace("_", "-"): n for n in _TABLE}
    key = str(name).lower().replace("_", "-")
    if key not in plain:
        hint = suggest(str(name), _TABLE) or f"; known: {', '.join(_TABLE)}"
        raise InputError(f"'{name}' is not a data set{hint}")
    return _TABLE[plain[key]]
