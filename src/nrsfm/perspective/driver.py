"""The loop: reconstruct, read depth, undo perspective with it, reconstruct again.

1. An affine reconstruction of the tracks as they are.
2. :func:`~nrsfm.perspective.find_perspective`: is there perspective, which focal length, which mirror image? Without
   evidence the first reconstruction is the answer: nothing is undone on suspicion.
3. Depth from :func:`~nrsfm.perspective.averaged_shapes`, which sees the tracks through the perspective camera; the
   tracks without perspective; their affine reconstruction, brought into the proven mirror image.
4. Once more, with the mean of both depths.
5. The mean of both shapes, and of it with the most likely shapes near it (:func:`~nrsfm.perspective.likely_shapes`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.perspective.evidence import find_perspective, mirror_evidence
from nrsfm.perspective.geometry import perspective_error, undo_perspective
from nrsfm.perspective.likely import likely_shapes
from nrsfm.perspective.options import PerspectiveOptions
from nrsfm.perspective.shapes import CameraShapes, averaged_shapes
from nrsfm.reconstruction import Reconstruction

Solve = Callable[[np.ndarray], Reconstruction]

LARGEST_MISFIT = 0.2
"""Root mean square that the affine reconstruction may leave, in units of the tracks' own. Perspective leaves some
percent; of tracks with more, too much is wrong: outliers that are left in them look like perspective."""

_ROUNDS = 2


def with_perspective(
    points: np.ndarray,
    solve: Solve,
    options: PerspectiveOptions,
    visible: np.ndarray | None = None,
    first: Reconstruction | None = None,
    second: Callable[[], Reconstruction] | None = None,
    final: str = "average",
) -> tuple[Reconstruction, dict[str, Any]]:
    """Reconstruct tracks seen by a perspective camera with an affine method.

    Parameters
    ----------
    points
        (F, P, 2) complete tracks, image unit.
    solve
        The affine pipeline: points (F, P, 2) to a ``Reconstruction``. Called once where no perspective is found.
    options
        See :class:`PerspectiveOptions`.
    visible
        (F, P) bool: which points were seen.
    first
        ``solve(points)`` where it is at hand already.
    second
        Another affine reconstruction of the points, which is judged before the first: shapes that follow the tracks
        closely have bent what perspective did into themselves. The first is judged where it shows nothing.
    final
        ``"average"`` returns the mean of the shapes of ``solve`` and of the perspective model, and of it with the
        most likely shapes near it, ``"model"`` those of the model, ``"solve"`` those of ``solve``, where perspective
        is undone.

    Returns
    -------
    The reconstruction, for which ``points_affine[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T +
    translations[f]`` with the tracks after perspective is undone, in the tracks' unit; and a report: ``undone``,
    ``mirror`` (see :func:`mirror_evidence`), ``strength``, ``focal``, ``intrinsics``, ``gains``,
    ``perspective_rms`` (what is left through the full camera) and ``affine_rms`` (the same before), image unit.
    """
    result = solve(points) if first is None else first
    if options.perspective == "off":
        return result, {"undone": False, "reason": "off"}
    judged = result if second is None else second()
    finding = find_perspective(points, judged, options.intrinsics, visible)
    if not finding.decided and judged is not result:
        judged = result
        finding = find_perspective(points, judged, options.intrinsics, visible)
    report: dict[str, Any] = {
        "undone": False,
        "mirror": mirror_evidence(finding),
        "strength": finding.strength,
        "gains": finding.gains,
    }
    if not finding.decided or finding.intrinsics is None:
        return result, report | {"reason": finding.reason}
    affine_rms = float(np.sqrt(np.nanmean(_affine_error(points, result) ** 2)))
    if affine_rms > LARGEST_MISFIT * _size(points):
        return result, {"undone": False, "reason": "the tracks follow no camera closely enough to show it"}
    seen = averaged_shapes(points, judged, finding.intrinsics, finding.flip, visible)
    if seen is None:
        report["reason"] = "the perspective model has no solution"
        proven = judged.mirrored() if finding.flip else judged
        return _in_mirror(result, _camera_shapes(proven)), report
    report["affine_rms"] = affine_rms
    return _undone(points, solve, finding.intrinsics, seen, result, report, final)


def _undone(
    points: np.ndarray,
    solve: Solve,
    matrix: np.ndarray,
    seen: CameraShapes,
    result: Reconstruction,
    report: dict[str, Any],
    final: str,
) -> tuple[Reconstruction, dict[str, Any]]:
    ones = np.ones(len(points))
    shapes = seen.shapes
    if final != "model":
        depths = shapes[:, :, 2]
        for number in range(_ROUNDS):
            result = _in_mirror(solve(undo_perspective(points, depths, ones, matrix)), seen.shapes)
            if number + 1 < _ROUNDS:
                depths = 0.5 * (seen.shapes[:, :, 2] + _camera_shapes(result)[:, :, 2])
    if final == "average":
        shapes = 0.5 * (seen.shapes + _camera_shapes(result))
        undone = undo_perspective(points, shapes[:, :, 2], ones, matrix)
        noise = float(result.diagnostics["noise"])
        shapes = 0.5 * (shapes + likely_shapes(undone, shapes, seen.rotations, seen.scales, noise))
    if final != "solve":
        inverse = np.swapaxes(seen.rotations, 1, 2) / seen.scales[:, None, None]
        moved = np.empty_like(shapes)
        for f, shape in enumerate(shapes):
            moved[f] = shape @ inverse[f].T.astype(shape.dtype)
        result = dataclasses.replace(
            result, shapes=moved, rotations=seen.rotations, scales=seen.scales, translations=seen.translations
        )
    errors = perspective_error(points, result, matrix)
    return result, report | {
        "undone": True,
        "focal": float(matrix[0, 0]),
        "intrinsics": matrix.tolist(),
        "ranks": list(seen.ranks),
        "perspective_rms": float(np.sqrt(np.mean(errors**2))),
    }


def _camera_shapes(result: Reconstruction) -> np.ndarray:
    """(F, P, 3) in the camera's frame, centred, scaled to the image."""
    out = np.empty(result.shapes.shape, dtype=np.float32)
    for f, shape in enumerate(result.shapes):
        turned = float(result.scales[f]) * (shape @ result.rotations[f].T)
        out[f] = turned - turned.mean(axis=0)
    return out


def _in_mirror(result: Reconstruction, seen: np.ndarray) -> Reconstruction:
    """The one of the two mirror images whose depth goes with that of ``seen``."""
    agreement = sum(
        float((shape @ rotation[2]) @ frame[:, 2])
        for shape, rotation, frame in zip(result.shapes, result.rotations, seen, strict=True)
    )
    return result.mirrored() if agreement < 0 else result


def _size(points: np.ndarray) -> float:
    """Root mean square distance of the points from the centroid of their frame."""
    means = [np.nanmean(np.sum((frame - np.nanmean(frame, axis=0)) ** 2, axis=1)) for frame in points]
    return float(np.sqrt(np.mean(means)))


def _affine_error(points: np.ndarray, result: Reconstruction) -> np.ndarray:
    """(F,) root mean square distance of the points from their affine reprojection, image unit."""
    errors = np.empty(len(points))
    for f, frame in enumerate(points):
        gap = frame - (result.scales[f] * (result.shapes[f] @ result.rotations[f, :2].T))
        gap -= np.nanmean(gap, axis=0)
        errors[f] = np.sqrt(np.nanmean(np.sum(gap * gap, axis=1)))
    return errors
