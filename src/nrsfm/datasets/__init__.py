"""Sequences with and without truth: a folder of data sets, the published benchmark files, and a generator.

``load(name, root)`` reads one of ``names()`` from a folder on this machine (``root``, or the environment
variable ``NRSFM_DATA``). Nothing is downloaded, and no data set comes with the package. ``synthetic``
generates sequences that need no file.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from nrsfm.datasets.benchmarks import KINECT_WINDOWS, Window, crop_to_window, load_benchmark_mat
from nrsfm.datasets.cloth import ClothVideo, load_cloth_video
from nrsfm.datasets.folder import data_folder
from nrsfm.datasets.loading import load
from nrsfm.datasets.sequence import Sequence, add_noise
from nrsfm.datasets.table import DatasetInfo, names, table

if TYPE_CHECKING:
    from nrsfm.datasets import synthetic

__all__ = [
    "KINECT_WINDOWS",
    "ClothVideo",
    "DatasetInfo",
    "Sequence",
    "Window",
    "add_noise",
    "crop_to_window",
    "data_folder",
    "load",
    "load_benchmark_mat",
    "load_cloth_video",
    "names",
    "synthetic",
    "table",
]


def __getattr__(name: str) -> Any:
    if name == "synthetic":  # loaded when used: it is the one part that needs no data folder
        return importlib.import_module("nrsfm.datasets.synthetic")
    raise AttributeError(f"module 'nrsfm.datasets' has no attribute '{name}'")
