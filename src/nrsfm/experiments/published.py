"""Numbers that were published, to stand beside measured ones. Sequences carry the names of the original files.

Sources: the tables and figures of the paper; its conference versions (CVPR 2018, CVPR 2019); Kumar, "Non-rigid
structure from motion: prior-free factorization method revisited" (WACV 2020); Kumar and Van Gool, "Organic priors in
non-rigid structure from motion" (ECCV 2022). The alignment behind the e3D is not stated in them. Values of figures were
read off.
"""

from __future__ import annotations

SEQUENCES = (
    *(f"original-face{i}" for i in range(1, 5)),
    "original-actor1",
    "original-actor2",
    "original-paper",
    "original-tshirt",
)

_ROWS: dict[str, tuple[float, ...]] = {
    "mp": (0.0926, 0.0819, 0.1057, 0.0717, 0.5226, 0.2737, 0.0827, 0.0741),
    "pta": (0.1559, 0.1503, 0.1252, 0.1348, 0.0418, 0.0532, 0.0918, 0.0712),
    "csf1": (0.5325, 0.9266, 0.5274, 0.5392, 0.3711, 0.2275, 0.0842, 0.0644),
    "csf2": (0.4677, 0.7909, 0.5474, 0.5292, 0.3708, 0.2279, 0.0801, 0.0628),
    "dv": (0.0531, 0.0457, 0.0346, 0.0379),
    "ds": (0.0636, 0.0569, 0.0374, 0.0428, 0.0891, 0.0822, 0.0612, 0.0636),
    "smsr": (0.1893, 0.2133, 0.1345, 0.0984, 0.0352, 0.0334),
    "grassmann": (0.0443, 0.0381, 0.0294, 0.0309, 0.0340, 0.0342, 0.0394, 0.0362),
    "geometry-aware": (0.0404, 0.0392, 0.0280, 0.0327, 0.0274, 0.0289, 0.0338, 0.0386),
    "rbmm": (0.0591, 0.0478, 0.0281, 0.0308),
    "organic": (0.0624, 0.0451, 0.0279, 0.0419),
}

ERRORS: dict[str, dict[str, float]] = {
    method: dict(zip(SEQUENCES, values, strict=False)) for method, values in _ROWS.items()
}
"""e3D by method and sequence; what a paper leaves out is missing."""

COMPARED = ("mp", "pta", "csf1", "csf2", "dv", "ds", "smsr")
"""The methods that the paper compares its two algorithms with, in its table."""

NOISE_RATIOS = (0.01, 0.02, 0.03, 0.04, 0.05)
NOISE: dict[str, tuple[float, ...]] = {
    "ds": (0.0622, 0.0639, 0.0655, 0.0679, 0.0703),
    "grassmann": (0.0487, 0.0510, 0.0530, 0.0550, 0.0575),
    "geometry-aware": (0.0377, 0.0400, 0.0420, 0.0440, 0.0460),
}
"""Mean e3D of the four faces, by method, at the noise ratios above."""

SECONDS_SEQUENCES = ("original-face1", "original-face3", "original-paper", "original-tshirt")
SECONDS: dict[str, tuple[float, ...]] = {
    "mp": (280, 2068, 3212, 3713),
    "ds": (361, 4033, 4213, 4513),
    "grassmann": (121, 894, 1577, 2190),
    "geometry-aware": (156, 907, 1685, 2229),
}
"""Seconds in MATLAB on a desktop computer, by method, for the sequences above."""

SPATIAL_CELLS = {5: 0.088, 10: 0.053, 15: 0.041, 20: 0.032, 25: 0.030}
"""e3D of face 3 against the number of spatial subspaces K_s."""

SINGULAR_VALUES = {
    "original-face1": {3: 0.167, 9: 0.082, 15: 0.040},
    "original-face3": {15: 0.066, 27: 0.027},
}
"""e3D of Algorithm 2 against the number p of singular values."""

TAU = {0.70: 0.144, 0.90: 0.071}
"""e3D of face 1 against τ; from .95 the curve is flat."""

ABLATION: dict[str, tuple[float, ...]] = {
    "neither": (0.084, 0.070, 0.056, 0.060),
    "spatial": (0.052, 0.051, 0.034, 0.038),
    "temporal": (0.050, 0.043, 0.037, 0.036),
    "both": (0.044, 0.038, 0.028, 0.030),
}
"""e3D of Algorithm 1 on faces 1 to 4 with parts of it."""


def stood_in_for(sequence: str) -> str | None:
    """The original that a stand-in takes the place of; ``None`` for a sequence of another kind."""
    if sequence.startswith(("face-seq", "built-in-face")):
        return f"original-face{sequence[-1]}"
    return None


def published_error(method: str, sequence: str) -> tuple[float | None, bool]:
    """The published e3D to stand beside a measured one, and whether the data are the same."""
    same = ERRORS.get(method, {}).get(sequence)
    if same is not None:
        return same, True
    return ERRORS.get(method, {}).get(stood_in_for(sequence) or ""), False
