"""``load``: one call for every data set of the folder."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from nrsfm.datasets.faces import load_face, load_ict
from nrsfm.datasets.folder import data_folder
from nrsfm.datasets.sequence import Sequence
from nrsfm.datasets.stacked import load_horse, load_stacked
from nrsfm.datasets.table import find
from nrsfm.errors import InputError
from nrsfm.files.cameras import rotations_from_array

_DEFAULTS: dict[str, Any] = {"subdivide": 0, "points": None, "vertices": "narrow", "rotations": None}
_ICT = ("subdivide", "points", "vertices")


def load(
    name: str,
    root: str | os.PathLike[str] | None = None,
    *,
    noise: float = 0.0,
    seed: int = 0,
    dtype: Any = None,
    truth: bool = True,
    subdivide: int = 0,
    points: int | None = None,
    vertices: str = "narrow",
    rotations: Any = None,
) -> Sequence:
    """Return the data set ``name`` (see :func:`~nrsfm.datasets.names`) from a folder on this machine.

    Parameters
    ----------
    name
        One of ``names()``.
    root
        The folder; by default what the environment variable ``NRSFM_DATA`` says.
    noise, seed
        Add Gaussian noise with standard deviation ``noise`` · max|W|, as in the paper (see
        :func:`~nrsfm.datasets.add_noise`).
    dtype
        float32 or float64; by default float64 up to 10⁷ track coordinates and float32 above.
    truth
        Whether to build the true shapes, which take 1.5 times the memory of the tracks.
    subdivide
        Faces only: how often to split the mesh, each time to about four times as many points.
    points
        Faces only: this many points exactly, on the same surface.
    vertices
        ``ict-`` faces only: ``"narrow"`` (6,706 vertices), ``"face"`` (9,409) or ``"all"`` (11,248).
    rotations
        Cameras for the sequences that come without (mesh_horse_gallop, ict-take3, ict-take4), (F, 3, 3) or
        (F, 2, 3); by default a documented path.

    Raises
    ------
    InputError
        The name is unknown (the nearest are suggested), or an option is out of range or not one of this data
        set.
    FileError
        The folder is not given or not there, or a file is missing or damaged.
    """
    info = find(name)
    own: tuple[str, ...]
    if info.name.startswith("face-seq"):
        loader, own = load_face, ("subdivide", "points")
    elif info.name.startswith("ict-take"):
        loader, own = load_ict, (*_ICT, "rotations")
    elif info.name.startswith("ict-"):
        loader, own = load_ict, _ICT
    elif info.name == "mesh_horse_gallop":
        loader, own = load_horse, ("rotations",)
    else:
        loader, own = load_stacked, ()
    options = {"subdivide": subdivide, "points": points, "vertices": vertices, "rotations": rotations}
    for key, value in options.items():
        # An array has no truth value: "is" tells a given option from its default for every type used here.
        if key not in own and value is not _DEFAULTS[key] and not _equal(value, _DEFAULTS[key]):
            raise InputError(f"'{key}' is not an option of the data set '{info.name}'")
    if rotations is not None:
        options["rotations"] = rotations_from_array(np.asarray(rotations), "rotations")
    options.update(dtype=dtype, truth=truth)
    sequence = loader(info, data_folder(root), options)
    about = {
        "origin": info.origin,
        "licence": info.licence,
        "units": info.units,
        "camera": info.camera,
        "frame": "object",
    }
    if rotations is not None:
        about["camera"] = "orthographic; given by the caller"
    sequence = dataclasses.replace(sequence, note={**about, **sequence.note})
    return sequence.with_noise(noise, seed) if noise != 0 else sequence


def _equal(value: Any, default: Any) -> bool:
    return isinstance(value, (int, str)) and value == default
