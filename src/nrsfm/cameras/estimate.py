"""From the compressed measurement matrix to camera rotations: the steps in order, and their report."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nrsfm.cameras import intersection, orbit, refinement, selection, signs, triplets
from nrsfm.cameras.intersection import Upgraded
from nrsfm.cameras.options import CameraOptions
from nrsfm.cameras.rigid import rigid_upgrade
from nrsfm.cameras.triplets import LARGEST_RANK, ONE_SCALE_FRAMES
from nrsfm.errors import InputError
from nrsfm.numerics.threads import single_thread

logger = logging.getLogger(__name__)

JUDGED_RANKS = (1, 2, 3, 4, 5, 7, 8, 10, 12, 13)
"""Chosen once on the tuning sequences of docs/cameras.md; see there."""

LEAST_TURN = 20.0
SIZE_CHANGE = 0.15
ORBIT_DEVIATION = 12.0
ORBIT_SHARE = 0.03
REFINED_TURN = 180.0

PUBLISHED = ("trajectory", "grown", "smoothest", "averaged", "proximal")
"""Estimators that are a module of this package each, with a function ``upgrade(basis, rank, rng) -> Upgraded``."""

Progress = Callable[[str, float | None], None]


@dataclass(frozen=True)
class CameraEstimate:
    """Estimated cameras and how they were found.

    Attributes
    ----------
    rotations
        (F, 3, 3) camera from object; the object frame is the camera frame of the first frame.
    scales
        (F,) with mean 1; all 1 for orthographic cameras.
    rank
        The number K of basis shapes in the chosen metric upgrade.
    candidates
        One dict per compared camera path: ``K``, ``start``, ``cost`` (mean squared residual per frame), ``norm``
        and ``log`` (see :mod:`nrsfm.cameras.selection`), ``chosen``.
    warnings
        Sentences for the user.
    turn
        The largest angle in degrees between the viewing directions of two frames.
    path
        ``"free"`` or ``"orbit"`` (an even turn, see :mod:`nrsfm.cameras.orbit`).
    method
        The estimator, one of the choices of the option ``camera_method``.
    """

    rotations: np.ndarray
    scales: np.ndarray
    rank: int
    candidates: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    turn: float = 0.0
    path: str = "free"
    method: str = "intersection"


def estimate_cameras(
    factor: np.ndarray,
    options: CameraOptions,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> CameraEstimate:
    """Estimate one rotation per frame, up to the mirror that :func:`nrsfm.cameras.choose_mirror` settles.

    Parameters
    ----------
    factor
        (2F, r) with W = factor @ Qᵀ and orthonormal rows in Qᵀ; W centred per row, of unit RMS per entry, rows
        x₁, y₁, x₂, y₂, ...
    seed
        Seeds the random starts.
    progress
        Called with a stage name and the fraction done.

    Raises ``InputError`` when the factor is not a finite (2F, r) matrix with F ≥ 2.
    """
    factor = np.asarray(factor, dtype=np.float64)
    if factor.ndim != 2 or len(factor) % 2 or len(factor) < 4 or factor.shape[1] < 1:
        raise InputError(f"factor: shape (2 × frames, r) with at least 2 frames is needed, received {factor.shape}")
    if not np.isfinite(factor).all():
        raise InputError("factor: every entry must be finite, received NaN or infinity")
    report = progress or (lambda stage, fraction: None)
    # Matrices of some 100 rows: a BLAS with several threads was seen to take 10 to 80 times as long.
    with single_thread():
        if options.camera_method in PUBLISHED:
            return _published(factor, options, seed, report)
        return _estimate(factor, options, seed, report)


def _published(factor: np.ndarray, options: CameraOptions, seed: int, report: Progress) -> CameraEstimate:
    """An estimator as it was published; signs, object frame and scales are settled as for the others."""
    name = str(options.camera_method)
    module = importlib.import_module(f"nrsfm.cameras.{name}")
    basis = intersection.dominant_basis(factor, 3 * (options.camera_rank or LARGEST_RANK))
    basis, warnings = _with_depth(basis)
    found: Upgraded = module.upgrade(basis, options.camera_rank, np.random.default_rng(seed))
    rotations = signs.canonical(found.rotations)
    turn = camera_turn(rotations)
    warnings += _hardly_turning(turn)
    report("cameras", 1.0)
    row = {"K": found.rank, "start": name, "cost": found.cost, "chosen": True}
    scales = _scales(rotations, basis, options)
    return CameraEstimate(rotations, scales, found.rank, [row], [*warnings, *found.warnings], turn, "free", name)


def _with_depth(basis: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Π filled up to three columns, and a warning where that was needed."""
    columns = basis.shape[1]
    if columns >= 3:
        return basis, []
    filled = np.hstack([basis, np.zeros((len(basis), 3 - columns))])
    return filled, [f"the tracks have rank {columns}, below 3: there is no depth in them to recover"]


def _hardly_turning(turn: float) -> list[str]:
    if turn >= LEAST_TURN:
        return []
    return [f"the camera hardly turns: {turn:.1f} degrees in all; depth and cameras are poorly determined"]


def _estimate(factor: np.ndarray, options: CameraOptions, seed: int, report: Progress) -> CameraEstimate:
    frames = len(factor) // 2
    basis = intersection.dominant_basis(
        factor, max(3 * (options.camera_rank or LARGEST_RANK), selection.VIRTUAL_POINTS)
    )
    columns = basis.shape[1]
    basis, warnings = _with_depth(basis)

    solved = _solve(basis, columns, options, np.random.default_rng(seed), report, warnings)
    paths = [_path(basis, item) for item in solved]
    judge = selection.Judge(basis)
    rows: list[dict[str, Any]] = []
    for i, (item, path) in enumerate(zip(solved, paths, strict=True)):
        row: dict[str, Any] = {"K": item.rank, "start": item.start, "cost": item.cost}
        rows.append(row | judge.criteria(path))
        report("cameras", 0.4 + 0.4 * (i + 1) / len(solved))
    exact = intersection.first_exact(solved, frames) if options.camera_rank is None else None
    best = selection.choose(rows) if exact is None else exact
    rotations, rank, shape = paths[best], solved[best].rank, "free"
    if rank > 1:
        # Where the rank is exact the valley is long and flat; only the winner is worth walking it to the end.
        final = triplets.polished(basis, solved[best])
        rotations = _path(basis, final)
        rows[best] |= {"cost": final.cost} | judge.criteria(rotations)

    if options.camera_path == "orbit" or (
        options.camera_path == "auto" and options.camera_method != "rigid" and exact is None
    ):
        orbits = _orbits(paths, rows, judge, must=options.camera_path == "orbit")
        if orbits is not None:
            rotations, row = orbits
            rows.append(row)
            best, rank, shape = len(rows) - 1, row["K"], "orbit"
    for i, row in enumerate(rows):
        row["chosen"] = i == best

    if options.refine and shape == "free" and rows[best]["cost"] >= refinement.LEAST_COST:
        rotations = refinement.refine_rotations(rotations, factor)
        rows[best]["refined"] = True
    rotations = signs.canonical(rotations)
    scales = _scales(rotations, basis, options)
    turn = camera_turn(rotations)
    warnings += _hardly_turning(turn)
    report("cameras", 1.0)
    logger.debug("cameras: K=%d, %s path, turn %.1f degrees, %d candidates", rank, shape, turn, len(rows))
    name = options.camera_method or "intersection"
    return CameraEstimate(rotations, scales, rank, rows, warnings, turn, shape, name)


def _solve(
    basis: np.ndarray,
    columns: int,
    options: CameraOptions,
    rng: np.random.Generator,
    report: Progress,
    warnings: list[str],
) -> list[intersection.Upgrade]:
    """The metric upgrades to be compared."""
    frames = len(basis) // 2
    if options.camera_method == "rigid":
        if options.camera_rank not in (None, 1):
            warnings.append(f"camera_rank {options.camera_rank} is ignored: rigid factorisation has one shape")
        return [rigid_upgrade(basis, free_scales=options.scales == "free")]
    limit = intersection.rank_limit(frames, columns)
    wanted = options.camera_rank
    if wanted is not None and wanted > limit:
        warnings.append(
            f"camera_rank {wanted} is more than {frames} frames of rank {columns} can decide: {limit} is used"
        )
    ranks = min(wanted or LARGEST_RANK, limit)
    weight = 0.0 if options.scales == "free" else min(1.0, ONE_SCALE_FRAMES / frames)
    solved = intersection.upgrades(
        basis, ranks, rng, weight=weight, progress=lambda done: report("cameras", 0.4 * done)
    )
    if not solved:
        warnings.append("the metric upgrade has no solution: the tracks hold no shape")
        return [intersection.Upgrade(1, np.eye(3), 0.0, "identity", 0)]
    if wanted is not None:
        return [u for u in solved if u.rank == ranks]
    judged = [k for k in JUDGED_RANKS if k <= ranks]
    if ranks not in judged:
        judged.append(ranks)
    kept = []
    for k in judged:
        at = [u for u in solved if u.rank == k]
        # A second minimum is worth judging only while its cost says little; far costlier ones have never won.
        kept.extend(at[:1] + [u for u in at[1:2] if k <= 3 and u.cost < 5.0 * at[0].cost])
    return kept


def _path(basis: np.ndarray, item: intersection.Upgrade) -> np.ndarray:
    return triplets.rotations_of(basis, triplets.first_triplet(basis, item))


def _orbits(
    paths: list[np.ndarray], rows: list[dict[str, Any]], judge: selection.Judge, *, must: bool
) -> tuple[np.ndarray, dict[str, Any]] | None:
    """The orbit of least ``log`` near the acceptable candidates, if it is close to them and hardly worse."""
    count = len(paths[0])
    if count < 4:
        return None
    numbers = np.arange(count) - (count - 1) / 2.0
    least = min(row["norm"] for row in rows)
    found: list[tuple[float, np.ndarray, float, int]] = []
    seen: list[np.ndarray] = []
    for i, path in enumerate(paths):
        if rows[i]["norm"] > (1.0 + selection.NORM_TOLERANCE) * least and not must:
            continue
        velocity, deviation, turn = orbit.fit_orbit(path)
        if not must and deviation > min(ORBIT_DEVIATION, ORBIT_SHARE * turn):
            continue
        if any(np.linalg.norm(velocity - v) * count < np.radians(0.5) for v in seen):
            continue
        seen.append(velocity)
        score = judge.criteria(orbit.orbit_path(velocity, numbers, path))
        if must or score["norm"] <= (1.0 + selection.NORM_TOLERANCE) * least:
            found.append((score["log"], velocity, turn, i))
    if not found:
        return None
    # ``log`` and not ``norm``: the norm alone is lowered by giving the object's own slow turning to the camera.
    _, velocity, turn, i = min(found, key=lambda entry: entry[0])
    # On a path of less than half a turn the criterion rewards turning less, and the fit alone is the better one.
    if turn >= REFINED_TURN:
        velocity, _ = orbit.refine_orbit(
            velocity, count, lambda v: judge.criteria(orbit.orbit_path(v, numbers, paths[i]))["log"], 40
        )
    rotations = orbit.orbit_path(velocity, numbers, paths[i])
    row = {"K": rows[i]["K"], "start": "orbit", "cost": rows[i]["cost"]} | judge.criteria(rotations)
    return rotations, row


def _scales(rotations: np.ndarray, basis: np.ndarray, options: CameraOptions) -> np.ndarray:
    """Scale of each frame against one mean shape, W_f ≈ s_f R_f S̄, or ones.

    ``auto`` frees the scales only when they spread by more than 15%: deformation alone mimics up to 14% (hulk),
    and to first order a missed scale only scales that frame's shape.
    """
    frames = len(rotations)
    ones = np.ones(frames)
    if options.scales == "fixed":
        return ones
    rows, tracks = rotations[:, :2], basis.reshape(frames, 2, -1)
    back = np.swapaxes(rows, 1, 2)
    scales = ones
    for _ in range(10):
        normal = np.einsum("f,fij,fjk->ik", scales**2, back, rows)
        mean = np.linalg.lstsq(normal, np.einsum("f,fij,fjn->in", scales, back, tracks), rcond=1e-6)[0]
        seen = rows @ mean
        size = np.sum(seen * seen, axis=(1, 2))
        scales = np.sum(tracks * seen, axis=(1, 2)) / np.where(size > 0, size, 1.0)
        if not (np.isfinite(scales).all() and (scales > 0.05).all()):
            return ones
        scales = scales / scales.mean()
    if options.scales == "auto" and scales.std() < SIZE_CHANGE:
        return ones
    return scales


def camera_turn(rotations: np.ndarray) -> float:
    """Largest angle in degrees between two viewing directions (third rows)."""
    axes = rotations[:, 2]
    axes = axes[:: -(-len(axes) // 2000)]
    # Through the chord: arccos of a cosine near 1 would lose small angles.
    cosine = axes @ axes.T
    i, j = np.unravel_index(int(np.argmin(cosine)), cosine.shape)
    half = np.clip(np.linalg.norm(axes[i] - axes[j]) / 2.0, 0.0, 1.0)
    return float(np.degrees(2.0 * np.arcsin(half)))
