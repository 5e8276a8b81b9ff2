"""The signs that the metric upgrade leaves open: one per frame, and one mirror for the whole sequence."""

from __future__ import annotations

import numpy as np


def consistent_signs(rotations: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Sign ±1 of each frame's first two rows that makes the frames agree on one mean shape.

    A triplet of ΠG is c_f R_f with c_f of either sign, and −R_f is a half turn about the optical axis. Seen from
    the object, frame f shows A_f = R_fᵀW_f (3×P, rank 2); a half turn negates it. The signs maximise
    Σ_fg s_f s_g ⟨A_f, A_g⟩: the leading eigenvector, then single flips until none helps. Nothing is assumed about
    the speed of the camera. The common sign is the one that leaves the majority as it is.
    """
    from scipy.linalg import eigh

    frames = len(rotations)
    back = (np.swapaxes(rotations[:, :2], 1, 2) @ factor.reshape(frames, 2, -1)).reshape(frames, -1)
    norms = np.linalg.norm(back, axis=1, keepdims=True)
    back = back / np.where(norms > 0, norms, 1.0)
    gram = back @ back.T
    leading = eigh(gram, subset_by_index=(frames - 1, frames - 1), check_finite=False)[1][:, 0]
    sign = np.where(leading < 0, -1.0, 1.0)
    for _ in range(50):
        pull = sign * (gram @ sign) - np.diag(gram)
        worst = int(np.argmin(pull))
        if pull[worst] >= -1e-12:
            break
        sign[worst] *= -1.0
    return sign if sign.sum() >= 0 else -sign


def apply_signs(rotations: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Rotations with the first two rows of each frame times its sign; determinant stays +1."""
    out = rotations.copy()
    out[:, :2] *= sign[:, None, None]
    return out


def mirrored(rotations: np.ndarray) -> np.ndarray:
    """The other solution: R → D R D with D = diag(1, 1, −1); shapes then change by z → −z in the object frame."""
    flip = np.array([1.0, 1.0, -1.0])
    return rotations * flip[:, None] * flip[None, :]
