"""Measures of single experiments; those of many are in :mod:`nrsfm.experiments.measures`.

| name | gives |
|---|---|
| ``fits`` | {"reprojection", "shape"}: the distances of the paper's rank experiment, relative |
| ``yardsticks`` | {"rigid", "flat", "turn"}: e3D of the true mean shape, of no depth; the true camera's turn |
| ``acceleration`` | {"estimate", "error", "truth", "track", "true_track", "point"}: second differences over time |
| ``gallery`` | arrays of one frame: tracks, shape, truth, groups, triangles, edges |
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from nrsfm.experiments.measures import Measured

GALLERY_POINTS = 80_000
_LINKED = 100  # fewer points than this are joined by lines, where no one says how


def _centred(shapes: Any) -> np.ndarray:
    """(F, P, 3) float64, each frame about its mean."""
    array = np.asarray(shapes, dtype=np.float64)
    return np.asarray(array - array.mean(axis=1, keepdims=True))


def fits(measured: Measured) -> dict[str, float | None]:
    """‖W − RS‖_F/‖W‖_F against the given tracks; ‖S_GT − S‖_F/‖S_GT‖_F after one orthogonal alignment."""
    result, sequence = measured.result, measured.sequence
    shapes, tracks = _centred(result.shapes), _centred(sequence.tracks.points)
    seen = np.einsum("f,fij,fpj->fpi", result.scales, result.rotations[:, :2], shapes, optimize=True)
    found: dict[str, float | None] = {
        "reprojection": float(np.linalg.norm(tracks - seen) / np.linalg.norm(tracks)),
        "shape": None,
    }
    if sequence.shapes is not None and sequence.valid is None:
        truth = _centred(sequence.shapes)
        values = np.linalg.svd(np.einsum("fpi,fpj->ij", shapes, truth, optimize=True), compute_uv=False)
        size = float(np.sum(truth * truth))
        # ‖T − SQ‖² = ‖T‖² + ‖S‖² − 2 Σσ at the best orthogonal Q; never below 0 but for rounding.
        gap = size + float(np.sum(shapes * shapes)) - 2.0 * float(values.sum())
        found["shape"] = float(np.sqrt(max(gap, 0.0) / size)) if size > 0 else None
    return found


def yardsticks(measured: Measured) -> dict[str, float | None]:
    """What an answer is worth that knows no deformation, or no depth, and how far the camera turns (degrees).

    ``rigid``: e3D, each frame aligned, of the true mean shape in every frame. ``flat``: of the true x and y as the
    camera sees them with all depths equal, not aligned.
    """
    from nrsfm.cameras import camera_turn
    from nrsfm.metrics import shape_error

    sequence = measured.sequence
    if sequence.shapes is None or sequence.valid is not None:
        return {"rigid": None, "flat": None, "turn": None}
    truth = _centred(sequence.shapes)
    rigid = shape_error(np.broadcast_to(truth.mean(axis=0), truth.shape), truth, "per-frame")
    if sequence.rotations is None:
        return {"rigid": rigid, "flat": None, "turn": None}
    depth = np.einsum("fj,fpj->fp", sequence.rotations[:, 2], truth)
    flat = np.mean(np.linalg.norm(depth, axis=1) / np.linalg.norm(truth, axis=(1, 2)))
    return {"rigid": rigid, "flat": float(flat), "turn": camera_turn(sequence.rotations)}


def acceleration(measured: Measured) -> dict[str, Any] | None:
    """Second differences over time, s(f+1) − 2 s(f) + s(f−1) at f = 1 … F−2, in units of the object's size.

    Root mean squares over the points: of the recovered shapes, of their error S − S_GT, and of the truth. Only where
    the true cameras were given: the shapes are in the frame of the truth then, and nothing is aligned. Of the point
    that moves most in truth, the coordinate along which it moves most: ``track`` and ``true_track`` (F,).
    """
    sequence, result = measured.sequence, measured.result
    given = bool(result.diagnostics.get("cameras", {}).get("known"))
    if sequence.shapes is None or sequence.valid is not None or not given or len(result.shapes) < 3:
        return None
    shapes, truth = _centred(result.shapes), _centred(sequence.shapes)
    size = float(np.sqrt(np.mean(np.sum(truth * truth, axis=2))))

    def series(array: np.ndarray) -> list[float]:
        second = array[2:] - 2.0 * array[1:-1] + array[:-2]
        return [float(v) for v in np.sqrt(np.mean(np.sum(second * second, axis=2), axis=1)) / size]

    moved = truth - truth.mean(axis=0)
    point = int(np.argmax(np.sum(moved * moved, axis=(0, 2))))
    axis = np.linalg.svd(moved[:, point], full_matrices=False)[2][0]
    return {
        "estimate": series(shapes),
        "error": series(shapes - truth),
        "truth": series(truth),
        "track": [float(v) for v in shapes[:, point] @ axis / size],
        "true_track": [float(v) for v in truth[:, point] @ axis / size],
        "point": point,
    }


def gallery(measured: Measured) -> dict[str, str]:
    """What a picture needs of one frame, the one that is least like the others.

    ``tracks`` (P, 2) of the frame, and ``widest`` (P, 2) of the frame by which points get their colours; ``shape``,
    ``truth`` (P, 3) aligned as the sequence allows, in view coordinates (x right, y down, z away) of the frame's
    camera, or of the average one for surfaces; ``groups``, ``triangles``, ``edges``; ``frame``. Of very dense
    sequences evenly numbered points, without their mesh.
    """
    from nrsfm.viewing.scene import choose_frames, make_scene
    from nrsfm.viewing.tracks import track_array, widest_frame

    sequence, result = measured.sequence, measured.result
    points = track_array(sequence.tracks)
    total, count = points.shape[:2]
    whole = count <= GALLERY_POINTS
    kept = np.arange(count) if whole else np.unique(np.linspace(0, count - 1, GALLERY_POINTS).astype(int))
    shapes = np.asarray(result.shapes[:, kept])
    frame = int(choose_frames(shapes, 1)[0])
    camera_frame = sequence.note.get("frame") == "camera"
    edges = sequence.edges if whole else None
    if edges is None and sequence.faces is None and count < _LINKED:
        edges = links(shapes)
    scene = make_scene(
        shapes,
        None if sequence.shapes is None else np.asarray(sequence.shapes[:, kept]),
        rotations=result.rotations,
        truth_rotations=np.tile(np.eye(3), (total, 1, 1)) if camera_frame else sequence.rotations,
        valid=None if sequence.valid is None else np.asarray(sequence.valid[:, kept]),
        edges=edges,
        faces=sequence.faces if whole else None,
        # Several frames: what looks like one sheet in a single one need not be a surface.
        frames=np.unique([frame, *choose_frames(shapes, 24)]),
        align="similarity" if "perspective" in str(sequence.note.get("camera", "")) else "per-frame",
    )
    shown = int(np.searchsorted(scene.frames, frame))
    # A surface is drawn from where its front is seen, as a frame's own camera may look at its back.
    view = scene.views[shown] if scene.triangles is None else scene.middle
    if np.linalg.det(view) < 0:  # an estimate that had to be mirrored to meet the truth
        view = np.diag([1.0, 1.0, -1.0]) @ view
    arrays = {
        "frame": np.array(frame),
        "tracks": points[frame][kept].astype(np.float32),
        "widest": widest_frame(points)[kept].astype(np.float32),
        "shape": (scene.shapes[shown] @ view.T).astype(np.float32),
    }
    if scene.truth is not None:
        arrays["truth"] = (scene.truth[shown] @ view.T).astype(np.float32)
    for name, value in (("triangles", scene.triangles), ("edges", scene.edges)):
        if value is not None:
            arrays[name] = value.astype(np.int32)
    if result.groups is not None:
        arrays["groups"] = np.asarray(result.groups)[kept].astype(np.int32)
    return measured.keep("gallery", **arrays)


def links(shapes: np.ndarray) -> np.ndarray:
    """Lines (E, 2) between points of (F, P, 3) that stay near each other: a skeleton, for points without one.

    The minimum spanning tree and each point's nearest, by the mean distance over the frames plus four times its
    standard deviation.
    """
    from scipy.sparse.csgraph import minimum_spanning_tree

    some = np.asarray(shapes[:: max(1, len(shapes) // 60)], dtype=np.float64)
    gaps = np.linalg.norm(some[:, :, None] - some[:, None], axis=3)
    cost = gaps.mean(axis=0) + 4.0 * gaps.std(axis=0)
    cost += 1e-12 * float(cost.max() or 1.0)  # the tree takes zero for "no line"
    np.fill_diagonal(cost, 0.0)
    tree = np.argwhere(minimum_spanning_tree(cost).toarray() > 0)
    np.fill_diagonal(cost, np.inf)
    nearest = np.stack([np.arange(len(cost)), np.argmin(cost, axis=1)], axis=1)
    return np.asarray(np.unique(np.sort(np.concatenate([tree, nearest]), axis=1), axis=0))


MEASURES: dict[str, Callable[[Measured], Any]] = {
    "fits": fits,
    "yardsticks": yardsticks,
    "acceleration": acceleration,
    "gallery": gallery,
}
