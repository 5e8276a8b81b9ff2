"""Options of the camera estimators."""

from __future__ import annotations

from dataclasses import dataclass

from nrsfm.options import option


@dataclass(frozen=True)
class CameraOptions:
    """How the camera rotations are estimated when they are not given."""

    camera_method: str | None = option(
        None,
        "Estimator: 'intersection' (metric upgrade of a rank-3K factorisation; Dai, Li and He 2014), 'rigid' "
        "(rank-3 factorisation; Tomasi and Kanade 1992), 'trajectory' (upgrade of the constant triplet of a "
        "trajectory basis; Akhter et al. 2008), 'grown' (the same, K grown until it gains nothing; Gotardo and "
        "Martinez 2011), 'smoothest' (of the K triplets' paths the smoothest; Kumar 2020), 'averaged' (rotation "
        "average of the K triplets; Kumar and Van Gool 2022) or 'proximal' (thresholded Gram matrix; Ansari, Golyanik "
        "and Stricker 2017). Default: the one that the method was published with.",
        choices=("intersection", "rigid", "trajectory", "grown", "smoothest", "averaged", "proximal"),
    )
    camera_rank: int | None = option(
        None, "Number of basis shapes in the metric upgrade. Default: chosen from the data.", symbol="K", minimum=1
    )
    scales: str = option(
        "auto",
        "Scale of each frame: 'fixed' (orthographic, all 1), 'free' (scaled orthographic, one scale per frame, "
        "mean 1) or 'auto' (free where the tracks show that the size changes, else fixed).",
        choices=("auto", "fixed", "free"),
    )
    camera_path: str = option(
        "auto",
        "Camera path: 'free' (one rotation per frame), 'orbit' (an even turn, R_f = exp(f ω) R₀) or 'auto' (an "
        "orbit where it explains the tracks as well as free rotations, which then follow it closely).",
        choices=("auto", "free", "orbit"),
    )
    refine: bool = option(
        True,
        "Refine the rotations against low-rank shapes where the metric upgrade leaves much unexplained, as it does "
        "under perspective and in few frames.",
    )
    mirror: bool = option(
        False, "Return the other of the two solutions that orthographic tracks cannot tell apart (z reversed)."
    )
