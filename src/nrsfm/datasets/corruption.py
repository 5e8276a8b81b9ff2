"""What trackers do to tracks, made on purpose and from a seed: occlusion, outliers, drift; for tests and experiments.

Masks are ``visible`` arrays (F, P) bool as :class:`nrsfm.Tracks` takes them. Everything is told as a share of all F·P
entries and in units of the points' own spread, so that it means the same for pixels and for metres.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nrsfm.errors import InputError, suggest

OCCLUSIONS = ("blocks", "random")
_FULLEST = 0.85  # no frame loses more of its points than this by occluders
_KINDS = ("passing", "lost", "late", "leaving", "flicker")
_TRIES = 100_000
_EARLIEST = 0.5  # of the frames: before, no track begins to drift


def _points(points: Any) -> np.ndarray:
    array = np.asarray(getattr(points, "points", points))
    if array.ndim != 3 or array.shape[2] != 2 or array.dtype.kind != "f" or array.size == 0:
        raise InputError(f"points: real numbers of shape (frames, points, 2) are needed, received {array.shape}")
    return array


def _share(share: float, most: float) -> float:
    if isinstance(share, bool) or not isinstance(share, (int, float, np.number)) or not 0 <= share <= most:
        raise InputError(f"share must be a number from 0 to {most:g}, received {share!r}")
    return float(share)


def _exactly(hidden: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Show again as many hidden entries, the last ones of their stretches first, as exceed ``count``."""
    extra = int(np.count_nonzero(hidden)) - count
    while extra > 0:
        ends = hidden.copy()
        ends[:-1] &= ~hidden[1:]
        where = np.flatnonzero(ends)
        chosen = rng.choice(where, size=min(extra, len(where)), replace=False)
        hidden.reshape(-1)[chosen] = False
        extra -= len(chosen)
    return hidden


def occlude(points: Any, share: float, rng: np.random.Generator, kind: str = "blocks") -> np.ndarray:
    """A mask with a given share of entries not seen.

    Parameters
    ----------
    points
        (F, P, 2), or tracks; complete.
    share
        Entries to hide, 0 to 0.8 of all.
    rng
        Source of every choice.
    kind
        ``"random"``: each entry by itself. ``"blocks"``: compact patches for stretches of frames, in equal parts an
        occluder that crosses the image, a patch that is lost for a while, one that appears late, one that leaves
        early, and one whose points flicker. No frame loses more than 85% of its points.

    Returns
    -------
    (F, P) bool, true where seen; exactly round(share · F · P) entries are false (fewer only where 85% forbids).
    """
    points = _points(points)
    share = _share(share, 0.8)
    frames, count = points.shape[:2]
    target = round(share * frames * count)
    if kind == "random":
        visible = np.ones(frames * count, dtype=bool)
        visible[rng.permutation(frames * count)[:target]] = False
        return visible.reshape(frames, count)
    if kind != "blocks":
        raise InputError(f"kind must be one of {', '.join(OCCLUSIONS)}, received {kind!r}{suggest(kind, OCCLUSIONS)}")
    hidden = np.zeros((frames, count), dtype=bool)
    most = math.floor(_FULLEST * count)
    spread = float(np.sqrt(np.mean(np.var(points.astype(np.float64), axis=1))))
    done = 0
    for turn in range(_TRIES):
        if done >= target:
            break
        block = _block(_KINDS[turn % len(_KINDS)], points, spread, rng)
        both = hidden | block
        full = both.sum(axis=1) > most
        both[full] = hidden[full]
        hidden, done = both, int(np.count_nonzero(both))
    return ~_exactly(hidden, target, rng)


def _block(kind: str, points: np.ndarray, spread: float, rng: np.random.Generator) -> np.ndarray:
    """One event of the named kind: (F, P) bool of what it hides."""
    frames, count = points.shape[:2]
    block = np.zeros((frames, count), dtype=bool)
    middle = int(rng.integers(frames))
    length = max(1, round(frames * rng.uniform(0.05, 0.4)))
    radius = spread * rng.uniform(0.3, 0.9)
    seed = points[middle, rng.integers(count)].astype(np.float64)
    start = max(0, min(frames - length, middle - length // 2))
    if kind == "passing":  # a disc that moves over the image
        angle = rng.uniform(0, 2 * np.pi)
        speed = 4 * spread / max(length, 2) * np.array([np.cos(angle), np.sin(angle)])
        for f in range(start, start + length):
            block[f] = np.linalg.norm(points[f] - (seed + speed * (f - middle)), axis=1) < radius
        return block
    patch = np.flatnonzero(np.linalg.norm(points[middle] - seed, axis=1) < radius)
    if kind == "flicker":
        share = rng.uniform(0.2, 0.6)
        block[start : start + length, patch] = rng.random((length, len(patch))) < share
        return block
    # Points of a patch are not lost in the very same frame: each has its own edge.
    edges = rng.integers(-max(1, length // 5), max(1, length // 5) + 1, size=(2, len(patch)))
    rows = np.arange(frames)[:, None]
    if kind == "late":
        block[:, patch] = rows < length + edges[0]
    elif kind == "leaving":
        block[:, patch] = rows >= frames - length + edges[0]
    else:
        block[:, patch] = (rows >= start + edges[0]) & (rows < start + length + edges[1])
    return block


def back_facing(camera_shapes: np.ndarray, faces: np.ndarray, share: float | None = None) -> np.ndarray:
    """A mask that hides the side of a surface that is turned away from the camera.

    Parameters
    ----------
    camera_shapes
        (F, P, 3) points in each frame's camera frame: ``rotations @ shapes``.
    faces
        (M, 3) or (M, 4) numbers of points; all wound alike. Which way they are wound is settled by what hides less.
    share
        Entries to hide, 0 to 0.8: those most turned away. Default: all that face away.

    Returns
    -------
    (F, P) bool, true where seen. A vertex faces the way of the sum of its faces' area vectors.
    """
    shapes = np.asarray(camera_shapes)
    faces = np.asarray(faces)
    if shapes.ndim != 3 or shapes.shape[2] != 3:
        raise InputError(f"camera_shapes: shape (frames, points, 3) is needed, received {shapes.shape}")
    frames, count = shapes.shape[:2]
    if faces.ndim != 2 or faces.shape[1] not in (3, 4) or faces.dtype.kind not in "iu":
        raise InputError(f"faces: whole numbers of shape (faces, 3 or 4) are needed, received {faces.shape}")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= count:
        raise InputError(f"faces: numbers of points from 0 to {count - 1} are needed, received others")
    towards = np.zeros((frames, count))
    for f, shape in enumerate(shapes):
        corners = shape[faces].astype(np.float64)
        # The area vector of a triangle, or of a quad through its diagonals.
        across = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
        normal = np.cross(*across)
        total = np.stack([np.bincount(faces.T.ravel(), np.tile(n, faces.shape[1]), count) for n in normal.T])
        towards[f] = total[2] / np.maximum(np.linalg.norm(total, axis=0), np.finfo(float).tiny)
    if np.count_nonzero(towards < 0) > np.count_nonzero(towards > 0):
        towards = -towards
    if share is None:
        return towards >= 0
    target = round(_share(share, 0.8) * towards.size)
    visible = np.ones(towards.size, dtype=bool)
    visible[np.argsort(towards, axis=None, kind="stable")[:target]] = False
    return visible.reshape(frames, count)


def gross_outliers(
    points: Any, share: float, rng: np.random.Generator, visible: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Single entries thrown anywhere into the image.

    Returns the points (F, P, 2), a copy, and the (F, P) bool mask of the round(share · F · P) entries (among the
    visible ones) that are wrong: uniform over the rectangle that all points ever reach, widened by a tenth.
    """
    points = _points(points)
    seen = np.flatnonzero(np.ones(points.shape[:2], dtype=bool) if visible is None else visible)
    number = min(len(seen), round(_share(share, 1.0) * points.shape[0] * points.shape[1]))
    chosen = rng.choice(seen, size=number, replace=False)
    out = np.array(points, order="C")
    flat = out.reshape(-1, 2)
    low, high = flat[seen].min(axis=0), flat[seen].max(axis=0)
    margin = 0.05 * (high - low)
    flat[chosen] = rng.uniform(low - margin, high + margin, size=(number, 2))
    wrong = np.zeros(points.shape[:2], dtype=bool)
    wrong.reshape(-1)[chosen] = True
    return out, wrong


def drifting(points: Any, share: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Tracks that from some frame on are wrong: half of them slide away, half jump onto another point's track.

    Parameters
    ----------
    points
        (F, P, 2), or tracks; complete.
    share
        Share of all entries that become wrong, about: whole tracks are chosen until it is reached.
    rng
        Source of every choice.

    Returns
    -------
    The points, a copy, and the (F, P) bool mask of the wrong entries. A sliding track leaves at 0.02 to 0.1 of the
    spread a frame (in 99 frames; at the same speed per length of the sequence otherwise). Tracks go wrong between 0.5
    and 0.9 of the sequence: one that is wrong for most of its length is a track of something else.
    """
    points = _points(points)
    frames, count = points.shape[:2]
    target = round(_share(share, 0.8) * frames * count)
    spread = float(np.sqrt(np.mean(np.var(points.astype(np.float64), axis=1))))
    out = np.array(points, order="C")
    wrong = np.zeros((frames, count), dtype=bool)
    order, others = rng.permutation(count), rng.permutation(count)
    for turn, point in enumerate(order):
        if np.count_nonzero(wrong) >= target or frames < 2:
            break
        start = int(rng.integers(max(1, round(_EARLIEST * frames)), max(2, round(0.9 * frames))))
        if turn % 2:
            other = int(others[turn])
            if other == point:
                continue
            out[start:, point] = points[start:, other]
        else:
            angle, speed = rng.uniform(0, 2 * np.pi), spread * rng.uniform(0.02, 0.1) * 99 / frames
            steps = np.arange(1, frames - start + 1)[:, None]
            out[start:, point] += (speed * steps * np.array([np.cos(angle), np.sin(angle)])).astype(out.dtype)
        wrong[start:, point] = True
    return out, wrong
