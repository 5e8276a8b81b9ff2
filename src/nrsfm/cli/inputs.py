"""What a run starts from, for the verbs that make it and the pictures that show it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from nrsfm.cli.scores import Truth
    from nrsfm.tracks import Tracks


@dataclasses.dataclass(frozen=True)
class Inputs:
    """What a run starts from; ``record`` is what ``config.json`` says of it, the rest is for pictures.

    ``mesh`` is the faces that came with the tracks, for methods that want neighbours.
    """

    tracks: Tracks
    rotations: np.ndarray | None
    truth: Truth | None
    record: dict[str, Any]
    faces: np.ndarray | None = None
    edges: np.ndarray | None = None
    mesh: np.ndarray | None = None
    unit: str = ""
