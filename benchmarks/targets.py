"""What the numbers are compared with. A number passes when it is at most its target, unrounded."""

from __future__ import annotations

import dataclasses

SEQUENCES = ("face-seq1", "face-seq2", "face-seq3", "face-seq4", "ict-rom99")
NOISE = 0.03
SEEDS = range(5)
OWN = ("grassmann", "geometry-aware")
METHODS = ("bmm", *OWN)


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of the accuracy table; the best of ``methods`` counts. ``limits`` go with ``SEQUENCES``."""

    title: str
    methods: tuple[str, ...]
    cameras: str
    noise: float
    limits: tuple[float, ...]


ACCURACY = (
    Row("`bmm`, known cameras, clean", ("bmm",), "known", 0.0, (0.064, 0.058, 0.019, 0.043, 0.032)),
    Row("best of two, known cameras, clean", OWN, "known", 0.0, (0.064, 0.058, 0.019, 0.043, 0.032)),
    Row("best of two, known cameras, 3% noise", OWN, "known", NOISE, (0.080, 0.070, 0.031, 0.047, 0.043)),
    Row("best of two, estimated cameras, clean", OWN, "estimated", 0.0, (0.071, 0.059, 0.022, 0.044, 0.031)),
    Row("best of two, estimated cameras, 3% noise", OWN, "estimated", NOISE, (0.085, 0.071, 0.032, 0.049, 0.045)),
)
REAL = 0.072
MOCAP = {"pickup": 0.031, "yoga": 0.028, "stretch": 0.026}
SPEED_RATIO = 2.0  # times one dense SVD of a 2F×P-like 297×29,299 matrix
SPEED_SHORT = 1.0  # seconds for 29,299 points in 10 frames
SPEED_CELLS = 20
SCALING_TIME = 16.0  # 29,299 → 468,784 points
SCALING_ITERATION = 1.25  # "not at all", with room for the clock
SCALING_MEMORY = 3.0  # times the input array
IMPORT_SECONDS = 0.4
DEMO_SECONDS = 60.0

# The default method.
AUTO = "auto"
TUNED = (
    "face-seq1",
    "face-seq2",
    "face-seq3",
    "face-seq4",
    "ict-rom99",
    "pickup",
    "yoga",
    "stretch",
    "dance",
    "shark",
    "walking",
    "face1",
    "back_real126",
    "flag250_persp",
    "hulk_persp",
    "mat1500_persp",
    "horse",
    "mesh_horse_gallop",
)
"""Sequences that were looked at while the default method or a stage was being made; every other number is held out."""

AUTO_ACCURACY = {0.0: (0.058, 0.048, 0.004, 0.017, 0.016), NOISE: (0.074, 0.061, 0.024, 0.036, 0.036)}
AUTO_MEAN = {0.0: 0.028, NOISE: 0.046}
AUTO_MOCAP = {"pickup": 0.016, "yoga": 0.015, "stretch": 0.015, "drink": 0.008, "dance": 0.10, "shark": 0.05}
AUTO_REAL = {"back_real126": 0.055, "back_real245": 0.060}
NEVER_WORSE = 1.05  # times the better of Algorithms 1 and 2
ROBUST = {"30% missing in blocks": 1.25, "5% gross outliers": 1.15}  # times the error with complete tracks
AUTO_TIME = 4.0  # times Algorithm 2's
REPAIR_GROWTH = 1.1  # times linear growth with the number of points

# Size.
SIZE_SECONDS = 300.0  # 1,180,232 points in 346 frames, from file to file
SIZE_MEMORY = 8.0  # GB, the same
SIZE_ERROR = 2.0  # percent between its error and that of 6,706 points
SIZE_PASS = 4.0  # times one W·Wᵀ: what grows with the number of points
SIZE_BUDGET = 4.0  # GB for 10,000,000 points in 100 frames
SIZE_LONG_SECONDS = 600.0  # 4,030 frames of 6,706 points
SIZE_LONG_ERROR = 1.05  # times the mean error of its 99-frame pieces
SIZE_SVD = 1.0  # times one dense SVD: 29,299 points in 99 frames, 3% noise, Algorithm 2

# Tracking.
TRACK_RATIO = 0.5  # times the end-point error of the naive chain, over 99 frames
TRACK_MEDIAN = 1.0  # pixels, rendered faces at 480 × 480
TRACK_SECONDS = 600.0  # 100 frames of 480 × 480, 2 cores


def marked(sequence: str) -> str:
    """The name of a sequence, with a mark where the default method was tuned on it."""
    return f"{sequence} (tuned)" if sequence in TUNED else sequence
