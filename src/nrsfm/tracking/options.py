"""What can be set about tracking."""

from __future__ import annotations

import dataclasses

from nrsfm.options import option

METHODS = {
    "subspace": "multi-frame flow with a low-rank trajectory basis; best, and able to find again what was hidden",
    "dis": "chained pairwise flow, corrected against the reference in every frame; fast",
    "naive": "chained pairwise flow alone, for comparison: drifts",
}
"""The ways to track, by name."""


@dataclasses.dataclass(frozen=True)
class TrackingOptions:
    """Options of :func:`nrsfm.tracking.track`."""

    rank: int = option(
        36, "largest number of trajectory basis vectors; the rounds grow towards it", symbol="R", minimum=1
    )
    rounds: int = option(5, "alternations between the trajectory subspace and matching", minimum=1, maximum=100)
    fine: int = option(
        28, "steps of the photometric fit of basis and coefficients that follows", minimum=0, maximum=200
    )
    sweeps: int = option(
        3, "passes over the video that look for what the chain of pairwise flow lost", minimum=0, maximum=10
    )
    extrapolate: bool = option(
        True, "look for lost regions where a low-rank model of the trusted points says that they must be"
    )
    object_size: float = option(
        0.0,
        "pixels: images are enlarged, at most twice, until the square root of the object's area is so many (240 helps "
        "small faces); 0: never",
        minimum=0,
    )
    grid: int = option(
        4, "pixels between the samples on which coefficients of the basis are held", minimum=1, maximum=32
    )
    normalisation: float = option(
        6.0, "pixels: deviation of the Gaussian over which brightness and contrast are evened out", above=0
    )
    furthest: float = option(
        10.0, "pixels: corrections against the reference that are longer are not believed", above=0
    )
    forward_backward: float = option(
        1.0, "pixels: scale of the disagreement of forward and backward flow at which a step loses its trust", above=0
    )
    likeness: float = option(
        0.35,
        "local correlation with the reference above which a point counts as visible; lower in noise, as the best is",
        minimum=-1,
        maximum=1,
    )
