"""MP: metric projections onto the motion manifold; cameras and shapes are found together.

minimise over l, R, B   ‖W − M S‖²_F,   M_f = [l_f1 R_f … l_fK R_f] (2×3K),  R_f R_fᵀ = I,  S = (B_1 … B_K) stacked

Source: Paladini, Del Bue, Xavier, Agapito, Stosic and Dodig, "Factorization for non-rigid and articulated structure
using metric projections", CVPR 2009, and "Optimal metric projections for deformable and articulated
structure-from-motion", IJCV 96, 2012. As published: start from rigid cameras, with the weights of further shapes read
off the next rank-3 parts of the residual; then in turn project every block of M onto the motion manifold (stiefel.py),
S = M⁺W, M = W S⁺.

Departures. (1) The projection is closest in the entries of M, not in the image, so that this alternation does not
descend: the error first falls, then often rises. It is run for a few rounds, its best iterate is kept, and the stated
objective is then descended for l, R and S together (motion.py), which also takes seconds in place of minutes.
(2) The minimum of the stated objective need not be a shape: a few frames whose depth hardly matters can grow without
bound. A ridge μ Σ_f ‖S_f − S̄‖² on the deformation forbids it; μ = σ²/τ² (variance of the residual over variance of the
deformation, per coordinate) is re-estimated as it goes, as in a Gaussian model of the shapes, and vanishes on tracks
that the model explains exactly. ``ridge=0`` is the published objective. (3) A rigid start fails where the shape deforms
much, so the metric upgrades of two and three triplets are tried as well and the least energy wins; ``starts="given"``
uses the given cameras only. (4) The missing entries and the articulated model of the papers are not part of this file.
With known cameras R stays, and l and S alone are found.

Only WSᵀ, SSᵀ and Frobenius norms occur: the exact compression changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.cameras import intersection, signs
from nrsfm.manifolds.motion import Motion, descend, motion_matrix
from nrsfm.manifolds.stiefel import nearest_motion
from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.options import option

FIRST_RIDGE, LARGEST_RIDGE = 1e-2, 0.1
RIDGE_ROUNDS = 8
RANK_TOLERANCE = 0.005  # share of the tracks' rms that K shapes may leave unexplained
UPGRADE_RANK = 3  # triplets of the metric upgrades that serve as further starts
SCREENING = (30, 1e-3)  # iterations and tolerance with which the starts are compared


@dataclass(frozen=True)
class MpOptions:
    """Options of :class:`Mp`."""

    rank: int | None = option(
        None,
        "Number K of basis shapes. Default: the least K whose 3K leading singular values leave at most 0.5% of the "
        "tracks' rms, or the noise where that is more; at most half the frames.",
        symbol="K",
        minimum=1,
    )
    ridge: float | None = option(
        None,
        "Weight of the squared deformation Σ‖S_f − S̄‖² against the squared reprojection error. 0 is the published "
        "objective. Default: their ratio of variances, re-estimated in rounds.",
        symbol="μ",
        minimum=0,
    )
    starts: str = option(
        "several",
        "Start from the 'given' cameras only, as published, or from 'several' (with the metric upgrades of two and "
        "three triplets; the least energy wins).",
        choices=("several", "given"),
    )
    alternations: int = option(20, "Rounds of the published alternation from each start.", minimum=1)
    max_iterations: int = option(
        200, "Upper bound on joint descent steps after the alternation; 0 leaves the alternation alone.", minimum=0
    )
    least_gain: float = option(
        1e-5, "Stop when a step lowers the energy by less than this share of itself.", above=0, maximum=0.1
    )


class Mp:
    """Alternation with metric projections, then joint descent on the motion manifold."""

    name = "mp"
    title = "Metric projections"
    year = 2009
    summary = "low rank of the shapes over frames; cameras and shapes by projection onto the motion manifold"
    assumes = "few deformation modes in all; cameras that turn; mostly rigid"
    cost = "2F²P once; F·K²·min(2F, P) per iteration"
    # Scales read off the rigid start would distort the frames; the weights hold them.
    needs = Needs(unscaled=True)
    camera_method = "rigid"
    denoise = False
    Options = MpOptions

    def cells(self, options: MpOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: MpOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Compare the starts, then descend from the best one."""
        merged, back = problem.merged()
        tracks, warnings = merged.tracks, list[str]()
        rank = _rank(merged, options.rank, warnings)
        fixed = problem.cameras_known
        paths = [problem.rotations]
        if not fixed and options.starts == "several" and options.max_iterations > 0:
            paths += _upgraded(tracks, rng)
        first = max(FIRST_RIDGE, options.ridge or 0.0) if options.max_iterations > 0 else 0.0
        fits: list[Motion] = []
        for i, rows in enumerate(paths):
            for weights, turned in _beginnings(tracks, rows, rank, options.alternations, fixed):
                if options.max_iterations == 0:
                    fits.append(descend(tracks, weights, turned, ridge=0.0, iterations=0, tolerance=1.0, fixed=fixed))
                    continue
                steps, tolerance = min(SCREENING[0], options.max_iterations), max(SCREENING[1], options.least_gain)
                fits.append(
                    descend(tracks, weights, turned, ridge=first, iterations=steps, tolerance=tolerance, fixed=fixed)
                )
            monitor(0.6 * (i + 1) / len(paths))
        best = int(np.argmin([fit.energy for fit in fits]))
        energies, ridges = list(fits[best].energies), [first] * len(fits[best].energies)
        fit, ridge = fits[best], first
        if options.max_iterations > 0:
            fit, ridge = _finish(merged, fit, options, fixed, energies, ridges, monitor)
        # The object frame is the camera frame of the first frame, as the camera estimators leave it.
        turn = np.eye(3) if fixed else np.vstack([fit.rows[0], np.cross(fit.rows[0, 0], fit.rows[0, 1])])
        return Solution(
            turn @ fit.shapes @ back,
            None,
            len(energies) - 1,
            fit.stop_reason if options.max_iterations > 0 else "alternation",
            {"energy": energies, "ridge": ridges},
            {"rank": rank, "ridge": ridge, "starts": len(fits), "start": best, "reprojection": fit.reprojection**0.5},
            warnings,
            rotations=None if fixed else fit.rows @ turn.T,
        )


def _rank(problem: Problem, wanted: int | None, warnings: list[str]) -> int:
    """K as asked for, or the least that leaves at most the tolerance or the noise; as many as the tracks hold."""
    tracks = problem.tracks
    values = np.sum(tracks * tracks, axis=(0, 1))  # squared singular values: the merged columns are orthogonal
    limit = max(1, -(-len(values) // 3))
    if wanted is not None:
        if wanted > limit:
            warnings.append(f"rank {wanted} is more shapes than tracks of rank {len(values)} can hold: {limit} is used")
        return min(wanted, limit)
    total = max(float(values.sum()), np.finfo(float).tiny)
    left = np.maximum(1.0 - np.cumsum(values) / total, 0.0)[2::3]
    enough = np.flatnonzero(left <= RANK_TOLERANCE**2 + problem.noise**2)
    least = int(enough[0]) + 1 if len(enough) else limit
    return max(1, min(least, limit, len(tracks) // 2))


def _upgraded(tracks: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Camera rows (F, 2, 3) from the metric upgrades of up to three triplets."""
    flat = tracks.reshape(2 * len(tracks), -1)
    basis = intersection.dominant_basis(flat, 3 * UPGRADE_RANK)
    if basis.shape[1] < 4:
        return []
    ranks = min(UPGRADE_RANK, intersection.rank_limit(len(tracks), basis.shape[1]))
    paths = []
    for item in intersection.upgrades(basis, ranks, rng):
        if item.rank > 1:
            blocks = (basis[:, : len(item.matrix)] @ item.matrix).reshape(-1, 2, 3)
            rotations, _ = intersection.polar_rotations(blocks)
            paths.append(signs.apply_signs(rotations, signs.consistent_signs(rotations, basis))[:, :2])
    return paths


def _beginnings(
    tracks: np.ndarray, rows: np.ndarray, rank: int, rounds: int, fixed: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights and rows to descend from: the published alternation; with known cameras also modes grown one by one."""
    begun = [_alternate(tracks, _published_weights(tracks, rows, rank), rows, rounds, fixed)]
    if fixed and rank > 1:
        begun.append((_grown_weights(tracks, rows, rank), rows))
    return begun


def _published_weights(tracks: np.ndarray, rows: np.ndarray, rank: int) -> np.ndarray:
    """l_f1 = 1; l_fk from the rank-3 parts of what the rigid shape leaves, each block along R_f: ⟨R_f, M_fk⟩ / 2."""
    frames = len(rows)
    weights = np.zeros((frames, rank))
    weights[:, 0] = 1.0
    flat, rigid = tracks.reshape(2 * frames, -1), rows.reshape(2 * frames, 3)
    left, values, _ = np.linalg.svd(flat - rigid @ np.linalg.lstsq(rigid, flat, rcond=None)[0], full_matrices=False)
    for k in range(1, rank):
        span = slice(3 * k - 3, min(3 * k, len(values)))
        blocks = (left[:, span] * np.sqrt(values[span])).reshape(frames, 2, -1)
        weights[:, k] = 0.5 * np.sum(blocks * rows[:, :, : blocks.shape[2]], axis=(1, 2))
    return weights


def _grown_weights(tracks: np.ndarray, rows: np.ndarray, rank: int) -> np.ndarray:
    """Weights one column at a time: the one along which the error falls fastest, from the SVD of R_fᵀ r_f."""
    frames = len(rows)
    flat, weights = tracks.reshape(2 * frames, -1), np.ones((frames, 1))
    for _ in range(1, rank):
        matrix = motion_matrix(weights, rows)
        residual = (flat - matrix @ np.linalg.lstsq(matrix, flat, rcond=1e-10)[0]).reshape(tracks.shape)
        pulled = (rows.transpose(0, 2, 1) @ residual).reshape(frames, -1)
        leading = np.linalg.eigh(pulled @ pulled.T)[1][:, -1:]
        weights = np.concatenate([weights, np.sqrt(frames) * leading], axis=1)
    return weights


def _alternate(
    tracks: np.ndarray, weights: np.ndarray, rows: np.ndarray, rounds: int, fixed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The published alternation; the iterate of least reprojection error."""
    frames, rank = weights.shape
    flat = tracks.reshape(2 * frames, -1)
    best, least, everywhere = (weights, rows), np.inf, True
    for _ in range(rounds):
        matrix = motion_matrix(weights, rows)
        shape = np.linalg.lstsq(matrix, flat, rcond=1e-10)[0]
        error = float(np.sum((flat - matrix @ shape) ** 2))
        if error < least:
            best, least = (weights, rows), error
        if not np.isfinite(error):
            break
        free = np.linalg.lstsq(shape.T, flat.T, rcond=1e-10)[0].T
        blocks = free.reshape(frames, 2, rank, 3).transpose(0, 2, 1, 3)
        if fixed:
            weights = 0.5 * np.einsum("fkai,fai->fk", blocks, rows)
        else:
            before = rows
            weights, rows = nearest_motion(blocks, None if everywhere else rows)
            # (−l, −R) is the same block, but with −R, a half turn in the image, the frame's depth is reversed.
            sign = np.where(np.sum(rows * before, axis=(1, 2)) < 0, -1.0, 1.0)
            weights, rows = weights * sign[:, None], rows * sign[:, None, None]
            everywhere = False
    return best


def _finish(
    problem: Problem,
    fit: Motion,
    options: MpOptions,
    fixed: bool,
    energies: list[float],
    ridges: list[float],
    monitor: Monitor,
) -> tuple[Motion, float]:
    """Descend with the ridge of the options, or with one re-estimated from each fit; extends the histories."""
    ridge, left = ridges[-1], options.max_iterations
    for number in range(RIDGE_ROUNDS):
        fresh = _variance_ratio(problem, fit) if options.ridge is None else options.ridge
        # Close to its fixed point the ridge has no more say: a tenth of it changes no digit that matters.
        last = number == RIDGE_ROUNDS - 1 or options.ridge is not None or abs(fresh - ridge) < 0.1 * ridge
        ridge = fresh
        fit = descend(
            problem.tracks,
            fit.weights,
            fit.rows,
            ridge=ridge,
            iterations=left,
            tolerance=options.least_gain if last else max(SCREENING[1], options.least_gain),
            fixed=fixed,
        )
        energies.extend(fit.energies[1:])
        ridges.extend([ridge] * (len(fit.energies) - 1))
        left -= len(fit.energies) - 1
        monitor(0.6 + 0.4 * (number + 1) / RIDGE_ROUNDS)
        if last or left <= 0:
            break
    return fit, ridge


def _variance_ratio(problem: Problem, fit: Motion) -> float:
    """σ²/τ²: variance of the reprojection error over variance of the deformation, each per coordinate."""
    frames, points = len(fit.weights), problem.points
    size = float(np.sum(problem.tracks**2))
    shapes = fit.shapes
    deformation = float(np.sum((shapes - shapes.mean(axis=0)) ** 2)) / (3 * frames * points)
    error = fit.reprojection * size / (2 * frames * points)
    return min(error / deformation, LARGEST_RIDGE) if deformation > 0 else LARGEST_RIDGE
