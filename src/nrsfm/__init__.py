"""Dense non-rigid structure from motion: the 3D shape of something that bends, in every frame, from tracks.

The public names are those below. They are loaded when first used, so that ``import nrsfm`` stays quick.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nrsfm import datasets, errors
    from nrsfm.files import load_tracks
    from nrsfm.methods import method_names
    from nrsfm.metrics import shape_error
    from nrsfm.pipeline import reconstruct
    from nrsfm.reconstruction import Reconstruction, load_reconstruction
    from nrsfm.tracks import Tracks

    __version__: str

__all__ = [
    "Reconstruction",
    "Tracks",
    "__version__",
    "datasets",
    "errors",
    "load_reconstruction",
    "load_tracks",
    "method_names",
    "reconstruct",
    "shape_error",
]

# The library speaks through logging and never by itself: without this, warnings would reach stderr unasked.
logging.getLogger(__name__).addHandler(logging.NullHandler())

_HOMES = {
    "Reconstruction": "nrsfm.reconstruction",
    "Tracks": "nrsfm.tracks",
    "load_reconstruction": "nrsfm.reconstruction",
    "load_tracks": "nrsfm.files",
    "method_names": "nrsfm.methods",
    "reconstruct": "nrsfm.pipeline",
    "shape_error": "nrsfm.metrics",
}


def __getattr__(name: str) -> Any:
    import importlib

    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("nrsfm")
    elif name in ("datasets", "errors"):
        value = importlib.import_module(f"nrsfm.{name}")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'nrsfm' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
