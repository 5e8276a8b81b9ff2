"""What is measured of a reconstruction: functions by name, each returning plain values for the record of its cell.

| name | gives |
|---|---|
| ``errors`` | {"none", "global", "per-frame", "similarity", "camera-frame"}: e3D, ``None`` where it has no meaning |
| ``rotation`` | mean angle in degrees to the true cameras, ``None`` without them |
| ``seconds`` | {"total", "cameras", "method", "shared_cameras"}: of the call and of its parts |
| ``memory`` | bytes that the process held at its peak during the call, above what it held before |
| ``reprojection`` | ‖W − RS‖_F / ‖W‖_F, both centred, against the tracks that were given |
| ``shape_fit`` | ‖S_GT − S‖_F / ‖S_GT‖_F over the sequence, each frame aligned |
| ``iterations``, ``stop_reason``, ``history``, ``warnings``, ``chosen`` | as in the diagnostics |
| ``groups`` | number of subspace groups, ``None`` where there are none |
| ``camera_report`` | K, path, turn and estimator of the cameras |
| ``noise`` | the noise level that was estimated, in the tracks' unit |

Those of single experiments are in :mod:`nrsfm.experiments.extra_measures`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import InputError, suggest

if TYPE_CHECKING:
    from nrsfm.datasets.sequence import Sequence
    from nrsfm.experiments.base import Cell
    from nrsfm.reconstruction import Reconstruction

ALIGNMENTS = ("none", "global", "per-frame", "similarity", "camera-frame")


@dataclass(frozen=True)
class Products:
    """Of each frame's estimate A and truth B (points × 3, centred): AᵀB (F, 3, 3), ‖A‖² (F,), ‖B‖² (F,).

    With them, ‖AQ − B‖² = ‖A‖² − 2 tr(Qᵀ AᵀB) + ‖B‖² for any orthogonal Q: one pass over dense shapes serves every
    alignment. Errors below about 1e-8 drown in rounding.
    """

    cross: np.ndarray
    estimate: np.ndarray
    truth: np.ndarray

    def gaps(self, turns: np.ndarray | None = None) -> np.ndarray:
        """Squared distances (F,) after the turns (F, 3, 3) or (3, 3), or without."""
        turned = np.einsum("fii->f", self.cross) if turns is None else np.sum(turns * self.cross, axis=(1, 2))
        return np.maximum(self.estimate - 2.0 * turned + self.truth, 0.0)

    def relative(self, gaps: np.ndarray) -> float | None:
        """Mean over frames of the relative error."""
        known = self.truth > 0
        return _finite(float(np.mean(np.sqrt(gaps[known] / self.truth[known])))) if known.any() else None


def _products(result: Reconstruction, sequence: Sequence) -> Products | None:
    if sequence.shapes is None:
        return None
    frames = len(sequence.shapes)
    cross, estimate, truth = np.zeros((frames, 3, 3)), np.zeros(frames), np.zeros(frames)
    for f in range(frames):
        a, b = (np.asarray(shapes[f], dtype=np.float64) for shapes in (result.shapes, sequence.shapes))
        if sequence.valid is not None:
            a, b = a[sequence.valid[f]], b[sequence.valid[f]]
        if len(a):
            a, b = a - a.mean(axis=0), b - b.mean(axis=0)
            cross[f], estimate[f], truth[f] = a.T @ b, np.sum(a * a), np.sum(b * b)
    return Products(cross, estimate, truth)


def _nearest_turns(cross: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The orthogonal Q (reflection allowed) with the largest tr(Qᵀ AᵀB), and that trace."""
    u, values, vt = np.linalg.svd(cross)
    return u @ vt, values.sum(axis=-1)


@dataclass(frozen=True)
class Measured:
    """A finished reconstruction and all that may be known of it.

    ``sequence`` holds the tracks as they were given to the method, noise included. ``folder`` and ``stem`` say where
    :meth:`keep` puts arrays.
    """

    result: Reconstruction
    sequence: Sequence
    cell: Cell
    seconds: float
    peak_bytes: int | None
    camera_seconds: float | None
    folder: Path
    stem: str

    @functools.cached_property
    def products(self) -> Products | None:
        """What every alignment needs of the shapes; ``None`` without true ones."""
        return _products(self.result, self.sequence)

    def keep(self, name: str, **arrays: np.ndarray) -> dict[str, str]:
        """Keep arrays as a compressed .npz beside the record; in the record of the cell stands the file's path."""
        from nrsfm.files.atomic import atomic_file

        path = self.folder / f"{self.stem}-{name}.npz"
        with atomic_file(path) as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]  # the stubs know no keywords
        return {"arrays": path.name}


Measure = Callable[[Measured], Any]


def errors(measured: Measured) -> dict[str, float | None]:
    """e3D under every alignment that the truth gives a meaning.

    Truth in the frame of the camera turns with it: one alignment in the object's frame means nothing. Under
    perspective the tracks have another unit than the truth, and only alignments with a scale mean something.
    """
    sequence, products = measured.sequence, measured.products
    found: dict[str, float | None] = dict.fromkeys(ALIGNMENTS)
    if products is None:
        return found
    _, traces = _nearest_turns(products.cross)
    found["similarity"] = products.relative(_similar(products, traces))
    if _other_unit(sequence):
        return found
    found["per-frame"] = products.relative(np.maximum(products.estimate - 2.0 * traces + products.truth, 0.0))
    if not _in_camera_frame(sequence):
        found["none"] = products.relative(products.gaps())
        found["global"] = _with_one_turn(products)
    # The motion-capture literature's: what the cameras see against what the true ones saw, one alignment.
    views = _true_views(sequence)
    if views is not None:
        seen = measured.result.rotations @ products.cross @ views.transpose(0, 2, 1)
        found["camera-frame"] = _with_one_turn(Products(seen, products.estimate, products.truth))
    return found


def _similar(products: Products, traces: np.ndarray) -> np.ndarray:
    """Squared distances (F,) with the best turn and scale of each frame."""
    size = np.where(products.estimate > 0, products.estimate, 1.0)
    return np.maximum(products.truth - traces * traces / size, 0.0)


def _with_one_turn(products: Products) -> float | None:
    turn, _ = _nearest_turns(products.cross.sum(axis=0))
    return products.relative(products.gaps(turn))


def _true_views(sequence: Sequence) -> np.ndarray | None:
    """Rotations (F, 3, 3) from the frame of the true shapes to the true cameras."""
    if _in_camera_frame(sequence) and sequence.shapes is not None:
        return np.broadcast_to(np.eye(3), (len(sequence.shapes), 3, 3))
    return sequence.rotations


def _other_unit(sequence: Sequence) -> bool:
    return "perspective" in str(sequence.note.get("camera", ""))


def _in_camera_frame(sequence: Sequence) -> bool:
    return sequence.note.get("frame") == "camera"


def rotation(measured: Measured) -> float | None:
    """Mean angle in degrees to the true cameras."""
    from nrsfm.metrics import rotation_error

    truth = measured.sequence.rotations
    return None if truth is None else _finite(rotation_error(measured.result, truth))


def seconds(measured: Measured) -> dict[str, float | None]:
    """Of the whole call, of its camera stage, of the method's own; of cameras that were estimated before and shared."""
    stages = measured.result.diagnostics["seconds"]
    return {
        "total": round(measured.seconds, 4),
        "cameras": round(stages.get("cameras", 0.0), 4),
        "method": round(stages.get(measured.result.method, 0.0), 4),
        "shared_cameras": measured.camera_seconds,
    }


def reprojection(measured: Measured) -> float | None:
    """‖W − RS‖_F / ‖W‖_F, W centred: over the given tracks, with scales and translations."""
    result, points = measured.result, measured.sequence.tracks.points
    gaps = total = 0.0
    for f in range(len(points)):
        frame = np.asarray(points[f], dtype=np.float64)
        shape = np.asarray(result.shapes[f], dtype=np.float64)
        seen = result.scales[f] * shape @ result.rotations[f, :2].T + result.translations[f]
        gaps += float(np.sum((frame - seen) ** 2))
        total += float(np.sum((frame - frame.mean(axis=0)) ** 2))
    return _finite(math.sqrt(gaps / total)) if total > 0 else None


def shape_fit(measured: Measured) -> float | None:
    """‖S_GT − S‖_F / ‖S_GT‖_F over the whole sequence, each frame aligned (with a scale, where units differ)."""
    products = measured.products
    if products is None or not products.truth.any():
        return None
    _, traces = _nearest_turns(products.cross)
    if _other_unit(measured.sequence):
        gaps = _similar(products, traces)
    else:
        gaps = np.maximum(products.estimate - 2.0 * traces + products.truth, 0.0)
    return _finite(math.sqrt(float(gaps.sum() / products.truth.sum())))


def groups(measured: Measured) -> int | None:
    """Number of subspace groups."""
    labels = measured.result.groups
    return None if labels is None else len(np.unique(labels))


def camera_report(measured: Measured) -> dict[str, Any]:
    """K, path, turn and estimator, without the candidates."""
    report = measured.result.diagnostics.get("cameras", {})
    return {name: report.get(name) for name in ("known", "method", "rank", "path", "turn")}


def _diagnostic(name: str) -> Measure:
    def measure(measured: Measured) -> Any:
        return measured.result.diagnostics.get(name)

    return measure


_MEASURES: dict[str, Measure] = {
    "errors": errors,
    "rotation": rotation,
    "seconds": seconds,
    "memory": lambda measured: measured.peak_bytes,
    "reprojection": reprojection,
    "shape_fit": shape_fit,
    "groups": groups,
    "camera_report": camera_report,
    **{n: _diagnostic(n) for n in ("iterations", "stop_reason", "history", "warnings", "chosen", "noise")},
}


def is_core(name: str) -> bool:
    """Whether a measure is one of this file."""
    return name in _MEASURES


def get_measure(name: str) -> Measure:
    """The measure of that name; raises ``InputError`` with the nearest names for an unknown one."""
    if name in _MEASURES:
        return _MEASURES[name]
    from nrsfm.experiments.extra_measures import MEASURES

    if name not in MEASURES:
        known = [*_MEASURES, *MEASURES]
        raise InputError(f"measure must be one of {', '.join(known)}, received {name!r}{suggest(name, known)}")
    return MEASURES[name]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
