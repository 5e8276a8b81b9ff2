"""Dense faces whose truth is known: expressions mixed by weights, seen by turning orthographic cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.datasets.folder import DataFile
from nrsfm.datasets.meshes import Density, densify
from nrsfm.datasets.paths import camera_path
from nrsfm.datasets.sequence import Sequence, choose_dtype
from nrsfm.datasets.table import DatasetInfo
from nrsfm.errors import InputError, suggest
from nrsfm.files.cameras import rotations_from_array
from nrsfm.tracks import Tracks

VERTICES = ("narrow", "face", "all")
_TAKE_NAMES = {"ict-take3": "alex_rom_3", "ict-take4": "alex_rom_4"}


def load_face(info: DatasetInfo, folder: Path, options: dict[str, Any]) -> Sequence:
    """Return one of face-seq1 to face-seq4: shape of frame f = Σ_j weights[f, j] · poses[j]."""
    number = info.name[-1]
    model, motion = DataFile(folder, info.files[0]), DataFile(folder, info.files[1])
    poses = model["poses"].astype(np.float64)
    weights = motion[f"weights_{number}"].astype(np.float64)
    rotations = rotations_from_array(motion[f"rotations_{number}"])
    density = densify(model["faces"], poses.shape[1], options["subdivide"], options["points"])
    return _build(info, np.zeros(poses.shape[1:]), poses, weights, rotations, density, options)


def load_ict(info: DatasetInfo, folder: Path, options: dict[str, Any]) -> Sequence:
    """Return a sequence of the blendshapes: shape of frame f = neutral + Σ_j weights[f, j] · offsets[j]."""
    vertices = options["vertices"]
    if vertices not in VERTICES:
        hint = suggest(str(vertices), VERTICES)
        raise InputError(f"vertices must be one of {', '.join(VERTICES)}, received {vertices!r}{hint}")
    model, motion = DataFile(folder, info.files[0]), DataFile(folder, info.files[1])
    neutral = model["neutral"].astype(np.float64)
    kept = {"narrow": int(model["n_narrow"]), "face": int(model["n_face"]), "all": len(neutral)}[vertices]
    quads = model["quads"]
    quads = quads[(quads < kept).all(axis=1)]
    offsets = model["expr"][:, :kept].astype(np.float64)
    if info.name in _TAKE_NAMES:
        weights = motion[_TAKE_NAMES[info.name]].astype(np.float64)
        rotations = camera_path(len(weights), turns=len(weights) / 400)  # about as fast as a head moves at 30 Hz
    else:
        take = info.name.removeprefix("ict-")
        weights = motion[f"weights_{take}"].astype(np.float64)
        rotations = rotations_from_array(motion[f"rotations_{take}"])
    if options["rotations"] is not None:
        rotations = options["rotations"]
    density = densify(quads, kept, options["subdivide"], options["points"])
    return _build(info, neutral[:kept], offsets, weights, rotations, density, options)


def _build(
    info: DatasetInfo,
    mean: np.ndarray,
    bases: np.ndarray,
    weights: np.ndarray,
    rotations: np.ndarray,
    density: Density,
    options: dict[str, Any],
) -> Sequence:
    """Frame by frame, so that at any density only the tracks, and the truth if asked for, take memory."""
    frames = len(weights)
    if rotations.shape != (frames, 3, 3):
        raise InputError(f"rotations: {frames} cameras are needed, received {len(rotations)}")
    dtype = choose_dtype(options["dtype"], frames * density.n_points * 2)
    image = np.empty((frames, density.n_points, 2), dtype=dtype)
    shapes = np.empty((frames, density.n_points, 3), dtype=dtype) if options["truth"] else None
    flat = bases.reshape(len(bases), -1)
    for f in range(frames):
        shape = density.apply(mean + (weights[f] @ flat).reshape(mean.shape))
        image[f] = shape @ rotations[f, :2].T
        if shapes is not None:
            shapes[f] = shape
    return Sequence(info.name, Tracks(image), shapes, rotations, faces=density.faces)
