"""The signs that the metric upgrade leaves open: one per frame, and one mirror for the whole sequence."""

from __future__ import annotations

import numpy as np

FEW_FRAMES = 400
"""Frames up to which the products of all pairs of frames are formed; both ways give the same signs."""


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
    own = np.sum(back * back, axis=1)
    if frames <= FEW_FRAMES:
        gram = back @ back.T
        leading = eigh(gram, subset_by_index=(frames - 1, frames - 1), check_finite=False)[1][:, 0]
    else:  # through the smaller Gram matrix: A Aᵀ of all frames is never formed
        leading = back @ np.linalg.eigh(back.T @ back)[1][:, -1]
    sign = np.where(leading < 0, -1.0, 1.0)
    for _ in range(50):
        pull = sign * (gram @ sign if frames <= FEW_FRAMES else back @ (back.T @ sign)) - own
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


def canonical(rotations: np.ndarray) -> np.ndarray:
    """The same cameras in a fixed object frame and mirror, so that the output does not depend on chance.

    Object frame: the camera frame of the first frame (R₀ = I). Mirror: of the two, the one whose turns from the
    first frame have a positive sum about the camera's y axis, or about x where that is the larger. This settles
    only which solution is called which; see :func:`choose_mirror`.
    """
    moved = rotations @ rotations[0].T
    # The axis part of each rotation, sin(angle) × axis; the mirror negates its x and y.
    turns = np.array([np.sum(moved[:, 2, 1] - moved[:, 1, 2]), np.sum(moved[:, 0, 2] - moved[:, 2, 0])])
    larger = turns[1] if abs(turns[1]) >= abs(turns[0]) else turns[0]
    return mirrored(moved) if larger < 0 else moved


def choose_mirror(rotations: np.ndarray, shapes: np.ndarray, mirror: bool = False) -> dict[str, object]:
    """Which of the two mirror solutions to show: the one that bulges towards the camera.

    Parameters
    ----------
    rotations
        (F, 3, 3) camera from object.
    shapes
        (F, P, 3) reconstructed shapes in the object frame.

    Under orthography z → −z (in every camera frame) is not observable. What is tracked is mostly the outside of a
    thing, and an outside is nearer in the middle of its outline than at its rim. In each frame the depth z = (R S)_z
    (forward positive) is correlated over points with the squared distance from the image centroid; a
    positive correlation is a bulge. The convention keeps the solution whose mean correlation is positive.

    ``mirror`` asks for the other one. It is a convention, not a measurement: things that are hollow towards the
    camera come out inverted (docs/cameras.md says how often).

    Returns ``flip`` (bool: apply :func:`mirrored` to the rotations and negate the z of the shapes), ``bulge``
    (mean correlation over frames as given, −1 to 1), ``agreement`` (share of frames with the sign of the mean),
    ``decided`` (|bulge| ≥ 0.1 in at least 70% of the frames; otherwise the choice is arbitrary) and ``rule``.
    """
    bulge = np.empty(len(rotations))
    for f, (rotation, shape) in enumerate(zip(rotations, shapes, strict=True)):
        seen = np.asarray(shape, dtype=np.float64)
        seen = (seen - seen.mean(axis=0)) @ rotation.T
        radius = np.sum(seen[:, :2] ** 2, axis=1)
        radius -= radius.mean()
        size = np.linalg.norm(radius) * np.linalg.norm(seen[:, 2])
        bulge[f] = radius @ seen[:, 2] / size if size > 0 else 0.0
    mean = float(bulge.mean()) if len(bulge) else 0.0
    agreement = float(np.mean(np.sign(bulge) == np.sign(mean))) if mean != 0 else 0.0
    return {
        "rule": "convex towards the camera",
        "flip": bool((mean < 0) != mirror),
        "bulge": mean,
        "agreement": agreement,
        "decided": bool(abs(mean) >= 0.1 and agreement >= 0.7),
    }
