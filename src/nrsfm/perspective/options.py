"""What a user may say about perspective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.options import option


@dataclass(frozen=True)
class PerspectiveOptions:
    """How far perspective is undone before the shapes are recovered."""

    intrinsics: np.ndarray | None = option(  # noqa: RUF009 - an immutable field, as the others
        None,
        "Camera matrix K (3, 3) in the tracks' unit, upper triangular with 1 in its last corner. Default: not known.",
        symbol="K",
    )
    perspective: str = option(
        "auto",
        "auto undoes perspective with the given camera matrix, and without one where the tracks themselves show a "
        "focal length; off takes the tracks as they are.",
        choices=("auto", "off"),
    )
