"""Data sets stored as the paper's matrices: W (2F×P), S (3F×P) and, for some, R (2F×3)."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.datasets.folder import DataFile
from nrsfm.datasets.paths import camera_path
from nrsfm.datasets.sequence import Sequence, choose_dtype, project
from nrsfm.datasets.table import DatasetInfo
from nrsfm.errors import InputError
from nrsfm.files.cameras import rotations_from_array
from nrsfm.tracks import Tracks, shapes_from_matrix

logger = logging.getLogger(__name__)

_CAMERA_ARRAYS = ("K", "P34", "K_fit", "R_fit")
_IN_CAMERA_FRAME = ("walking", "shark", "mat1500_persp", "flag250_persp", "hulk_persp")
_REMARKS = {
    "back_real126": "four glitch steps near frames 58 and 106",
    "back_real245": "four glitch steps near frames 58 and 106",
    "dance": "the stored camera is the same in every frame",
}


def load_stacked(info: DatasetInfo, folder: Path, options: dict[str, Any]) -> Sequence:
    """Return a sequence with W and S; perspective cameras go into ``note`` as lists."""
    file = DataFile(folder, info.files[0])
    matrix = file["W"]
    dtype = choose_dtype(options["dtype"], matrix.size)
    tracks = Tracks.from_measurement_matrix(matrix.astype(dtype))
    shapes = valid = None
    if options["truth"]:
        shapes = shapes_from_matrix(file["S"].astype(dtype))
        known = np.isfinite(shapes).all(axis=2)
        if "S_valid" in file:
            known &= file["S_valid"]
        valid = None if known.all() else known
    rotations = rotations_from_array(file["R"], "R") if "R" in file else None
    edges = file["edges"] if "edges" in file else None  # noqa: SIM401 (a DataFile is no dict)
    note: dict[str, Any] = {name: file[name].tolist() for name in _CAMERA_ARRAYS if name in file}
    note["frame"] = "camera" if info.name in _IN_CAMERA_FRAME else "object"
    if info.name in _REMARKS:
        note["remark"] = _REMARKS[info.name]
    return Sequence(info.name, tracks, shapes, rotations, valid, edges=edges, note=note)


def load_horse(info: DatasetInfo, folder: Path, options: dict[str, Any]) -> Sequence:
    """Return the galloping horse, seen from its side by a swinging camera unless ``rotations`` are given."""
    file = DataFile(folder, info.files[0])
    matrix = file["S"]
    dtype = choose_dtype(options["dtype"], matrix.size * 2 // 3)
    shapes = shapes_from_matrix(matrix.astype(dtype))
    rotations = options["rotations"]
    if rotations is None:
        rotations = camera_path(len(shapes), yaw=90.0)
    if len(rotations) != len(shapes):
        raise InputError(f"rotations: {len(shapes)} cameras are needed, received {len(rotations)}")
    tracks = Tracks(project(shapes, rotations))
    return Sequence(info.name, tracks, shapes if options["truth"] else None, rotations, faces=file["faces"])
