"""What is measured of a reconstruction beside its sequence: plain numbers, or None where they have no meaning."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from benchmarks.tracks import Data, sequence_of

_TRUSTED = 0.5  # an entry below this confidence was taken for wrong


def _global(result: Any, sequence: Any) -> float | None:
    from nrsfm import shape_error

    # Truth in the camera's frame turns with the camera: one alignment in the object's frame means nothing.
    if sequence.note["frame"] == "camera":
        return None
    return shape_error(result, sequence.shapes, "global", valid=sequence.valid)


def _aligned(align: str) -> Callable[[Any, Any], float]:
    def measure(result: Any, sequence: Any) -> float:
        from nrsfm import shape_error

        return shape_error(result, sequence.shapes, align, valid=sequence.valid)

    return measure


def _true_rotations(sequence: Any) -> Any:
    """True cameras (F, 3, 3), the identity where the truth is in their frames, None where none are known."""
    import numpy as np

    if sequence.note["frame"] == "camera":
        return np.broadcast_to(np.eye(3), (len(sequence.shapes), 3, 3))
    return sequence.rotations


def _camera_frame(result: Any, sequence: Any) -> float | None:
    from nrsfm.metrics import camera_frame_error

    rotations = _true_rotations(sequence)
    if rotations is None or sequence.valid is not None:
        return None
    return camera_frame_error(result, sequence.shapes, rotations)


def _rotation(result: Any, sequence: Any) -> float | None:
    from nrsfm.metrics import rotation_error

    return None if sequence.rotations is None else rotation_error(result, sequence.rotations)


def _true_turn(_: Any, sequence: Any) -> float | None:
    """Largest angle in degrees between the true viewing directions of two frames."""
    import numpy as np

    if sequence.rotations is None:
        return None
    axes = sequence.rotations[:, 2]
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))


def _unreflected(result: Any, sequence: Any) -> float:
    """Mean over frames of the similarity error without reflection: it tells a shape from its mirror image."""
    import numpy as np

    errors = []
    for estimate, truth in zip(result.shapes, sequence.shapes, strict=True):
        a = np.asarray(estimate, dtype=np.float64)
        b = np.asarray(truth, dtype=np.float64)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        u, values, vt = np.linalg.svd(a.T @ b)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        scale = float(values @ sign) / float(np.sum(a * a))
        errors.append(np.linalg.norm(scale * a @ (u * sign) @ vt - b) / np.linalg.norm(b))
    return float(np.mean(errors))


def _counts(result: Any, sequence: Any) -> dict[str, int]:
    """Points, points with a shape, entries of the tracks, entries seen, and entries that are scored."""
    import numpy as np

    tracks = sequence.tracks
    entries = tracks.n_frames * tracks.n_points
    reconstructed = np.asarray(result.reconstructed)
    valid = np.ones((tracks.n_frames, tracks.n_points), dtype=bool) if sequence.valid is None else sequence.valid
    return {
        "points": tracks.n_points,
        "reconstructed": int(np.count_nonzero(reconstructed)),
        "entries": entries,
        "seen": entries if tracks.visible is None else int(np.count_nonzero(tracks.visible)),
        "valid": int(np.count_nonzero(valid)),
        "scored": int(np.count_nonzero(valid & reconstructed)),
    }


def _calibration(result: Any, sequence: Any) -> dict[str, Any]:
    from nrsfm.metrics import depth_calibration

    return depth_calibration(result, sequence.shapes, _true_rotations(sequence), valid=sequence.valid)


@functools.lru_cache(maxsize=1)  # the damages of one sequence follow one another
def _complete(data: Data, method: str) -> Any:
    from nrsfm import reconstruct

    return reconstruct(sequence_of(data).tracks, method).shapes


def _robust(result: Any, sequence: Any) -> dict[str, Any]:
    """Per-frame error of the entries that were seen and are right, and of the same ones from undamaged tracks."""
    import dataclasses

    import numpy as np

    from nrsfm import shape_error

    tracks, wrong, data = sequence.tracks, sequence.note["wrong"], sequence.note["data"]
    shape = (tracks.n_frames, tracks.n_points)
    reconstructed = np.asarray(result.reconstructed)
    seen = np.ones(shape, dtype=bool) if tracks.visible is None else np.asarray(tracks.visible)
    right = seen & reconstructed & (True if wrong is None else ~wrong)
    rest = reconstructed & ~right
    undamaged = result.shapes if not data.damage else _complete(dataclasses.replace(data, damage=""), result.method)

    def error(shapes: Any, valid: Any) -> float | None:
        # The shapes of points that were not reconstructed are not looked at: none of their entries counts.
        shapes = np.where(np.isfinite(shapes), shapes, 0.0)
        return shape_error(shapes, sequence.shapes, "per-frame", valid=valid) if valid.any() else None

    found = {
        "error": error(result.shapes, right),
        "complete": error(undamaged, right),
        "hidden": error(result.shapes, rest),  # entries that were not seen, or are wrong
        "hidden_complete": error(undamaged, rest),
        "not_reconstructed": float(1 - reconstructed.mean()),
        "seen_of_these": float(np.count_nonzero(seen & ~reconstructed) / np.count_nonzero(seen)),
        "damaged": float(1 - (seen & (True if wrong is None else ~wrong)).mean()),
    }
    if tracks.visible is None:
        confidence = np.ones(shape) if result.confidence is None else result.confidence
        accused = (confidence < _TRUSTED) & reconstructed
        true = np.zeros(shape, dtype=bool) if wrong is None else wrong & reconstructed
        both = int(np.count_nonzero(accused & true))
        found["accused"] = float(accused.mean())
        found["precision"] = both / int(accused.sum()) if accused.any() else None
        found["recall"] = both / int(true.sum()) if true.any() else None
    return found


MEASURES: dict[str, Callable[[Any, Any], Any]] = {
    "per_frame": _aligned("per-frame"),
    "similarity": _aligned("similarity"),
    "global": _global,
    "camera_frame": _camera_frame,
    "rotation": _rotation,
    "true_turn": _true_turn,
    "unreflected": _unreflected,
    "counts": _counts,
    "calibration": _calibration,
    "robust": _robust,
}
"""Functions of (reconstruction, sequence)."""
