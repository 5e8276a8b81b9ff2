"""The real video of moving cloth with a depth sensor's clouds: images to track, clouds to compare."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.datasets.folder import DataFile, data_folder
from nrsfm.errors import FileError

_VIDEO, _CLOUDS = "phisft_R1_video", "phisft_R1_pointclouds.npz"


@dataclasses.dataclass(frozen=True, eq=False)
class ClothVideo:
    """Images, masks and clouds of one recording; there are no tracks, and clouds have no correspondence.

    Attributes
    ----------
    images, masks
        Files, one per frame: the picture, and white where the cloth is.
    clouds
        One (N, 3) array per frame, in metres, in the camera's frame.
    camera
        ``fx, fy, cx, cy``: a cloud's point (X, Y, Z) is seen at (fx·X/Z + cx, fy·Y/Z + cy); ``size`` of an
        image.
    note
        ``origin``, ``licence`` and ``camera``.
    """

    images: tuple[Path, ...]
    masks: tuple[Path, ...]
    clouds: tuple[np.ndarray, ...]
    camera: dict[str, Any]
    note: dict[str, str]


def load_cloth_video(root: str | os.PathLike[str] | None = None) -> ClothVideo:
    """Return the φ-SfT recording R1 from the folder of the data sets.

    Raises
    ------
    FileError
        The folder is not given or not there, a file is missing or damaged, or the numbers of files differ.
    """
    folder = data_folder(root)
    video = folder / _VIDEO
    if not video.is_dir():
        raise FileError(f"the data set needs the folder '{_VIDEO}' in folder '{folder}', which is not there")
    images, masks = (tuple(sorted(video.glob(pattern))) for pattern in ("rgb_*.jpg", "mask_*.png"))
    try:
        camera = json.loads((video / "camera.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"cannot read '{video / 'camera.json'}': {error}") from error
    file = DataFile(folder, _CLOUDS)
    clouds: list[np.ndarray] = []
    while f"pc{len(clouds):03d}" in file:
        clouds.append(file[f"pc{len(clouds):03d}"])
    if not len(images) == len(masks) == len(clouds):
        raise FileError(
            f"'{folder}': as many images as masks and clouds are needed, found {len(images)}, {len(masks)} "
            f"and {len(clouds)}"
        )
    note = {
        "origin": "φ-SfT, real sequence R1",
        "licence": "non-commercial use",
        "camera": "static, perspective",
    }
    return ClothVideo(images, masks, tuple(clouds), camera, note)
