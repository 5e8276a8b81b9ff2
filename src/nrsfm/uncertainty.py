"""How uncertain each point's depth is in each frame, whatever method found it: a standard deviation of each.

Orthographic tracks fix two coordinates of a point and leave its depth to the model. What the model cannot know is
measured on the solution itself, without the truth:

    σ²(f, p) = κ² [ b_f q_pᵀ (ρ² E + g² D) q_p + ν² ‖t_fp‖² + m²(f, p) ]

with q_p the point's coordinates among k orthonormal shape directions. The parts:

- E: *exchange*. The shapes found are given to other frames (shifted along the sequence, so that neighbours stay
  neighbours), seen through the cameras found, and recovered again by reweighted low rank. The recovery does not know
  that these shapes once were someone's optimum; E is the second moment of its depth errors, each frame's shape turned
  onto its original. Geometry of the cameras, number of frames and richness of the deformation enter by themselves.
  What the recovery makes of the tracks themselves differs from the shapes found by a *disagreement*; where its second
  moment is the larger, it stands for ρ²E: a norm that shrinks depth shows there.
- ρ: *held-out image directions*. In blocks of frames one in-plane direction is withheld and predicted, once from the
  tracks and once from exchanged shapes. ρ² is the ratio of the mean squared errors (less the noise): how much harder
  the tracks are than the solution's own shapes.
- D, g: *missing depth*. The deformation's second moment, fitted to what is seen in the image planes over all frames,
  says how large deformation in depth should be; g is how far the solution's root mean square falls short of that,
  relative to the deformation in the image, whose second moment is D. It counts only as far as the exchange shows doubt.
- t_fp: *noise* of size ν. Depth is a linear function of the tracks with weights t, the same for all points of a cell
  of the compression.
- m: *mean shape*. Where the camera hardly turns, the mean's depth is known no better than √(h_f (τ_p² + ν²)), τ_p the
  point's deformation in the image, h_f = a_fᵀ(Σ P_g)⁻¹a_f for viewing direction a_f and image planes P_g; at most the
  object's size. Counted from h = 1 on; below, E holds it. Cameras that are estimated to turn less than 20° need not
  turn at all: from there to 10° the object's size takes over.
- b_f: frames that deform more in the image are less certain in depth, as seen in the exchange; mean 1.
- κ: one constant for what none of these see (errors of the cameras, departures from orthography), tuned once.

The deviation is meant against the truth *after each frame's shape is turned onto the true one*: an error of a frame's
camera tilts the whole shape and is not included. Source: ours; the exchange is a bootstrap (Efron, The Annals of
Statistics 7, 1979), the recovery a reweighted nuclear norm (Candès, Wakin and Boyd, J. Fourier Anal. Appl. 14, 2008).
Holds on the exact compression: everything but the last step is inner products over points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.cameras import LEAST_TURN, camera_turn
from nrsfm.compression import CompressedTracks, members_of_cells
from nrsfm.numerics.low_rank import threshold_over_frames
from nrsfm.numerics.threads import blas_threads, side_by_side, single_thread
from nrsfm.options import option

INFLATION = 1.15
"""κ. Tuned on face-seq1, face-seq3, ict-rom99 and pickup, clean and with 3% noise."""

DIRECTIONS = 40  # k: shape directions in which exchange and prediction run
FRAMES = 200  # at most so many, evenly spread, take part in the exchange
ENOUGH = 120  # recovered frames over all exchanges
REWEIGHT = 0.01
ITERATIONS, GROWTH = 60, 1.2
EVENNESS = 0.1
MISSING = 1.5  # missing depth counts for at most so many times the exchange: deformation need not be alike all round
BLOCKS = 15  # the sequence in so many blocks, a third of which loses one image direction
HARDER = (0.7, 1.6)  # bounds of ρ
_TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class UncertaintyOptions:
    """Whether depth gets a standard deviation."""

    deviation: bool = option(
        True, "Estimate the standard deviation of every depth; off saves up to about half a second on 100 frames."
    )


def depth_deviation(
    shapes: np.ndarray,
    compressed: CompressedTracks,
    rotations: np.ndarray,
    scales: np.ndarray,
    noise: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Standard deviation of the depth of every point in every frame, and what it is made of.

    Parameters
    ----------
    shapes
        (F, 3, N) solution on the virtual points, object frame, in units of the tracks' rms.
    compressed
        The compression it lives on.
    rotations
        (F, 3, 3) camera from object.
    scales
        (F,) image unit per object unit.
    noise
        Standard deviation of a track coordinate, in units of the tracks' rms.
    rng
        For the shifts, the withheld directions and the simulated noise.

    Returns
    -------
    (F, P) float32 in the unit of the tracks, and a report: ``exchange`` (or the disagreement), ``missing``, ``noise``
    and ``mean`` are root mean squares of the parts in the same unit (after κ), ``harder`` is ρ.
    """
    workers = blas_threads()
    with single_thread():
        model, report = deviation_model(shapes, compressed, rotations, scales, noise, rng)
        first = _point_quadratic(compressed, model.first, workers)
        deform = np.zeros(len(first)) if model.deform is None else _point_quadratic(compressed, model.deform, workers)
        out, total = model.of(first, deform, compressed.labels)
    return out, report | {"mean": float(model.scale * np.sqrt(total / out.size))}


def deviation_model(
    shapes: np.ndarray,
    compressed: CompressedTracks,
    rotations: np.ndarray,
    scales: np.ndarray,
    noise: float,
    rng: np.random.Generator,
) -> tuple[DeviationModel, dict[str, Any]]:
    """What :func:`depth_deviation` makes the deviations of, and its report but for ``mean``; same parameters."""
    frames, points = len(shapes), compressed.measurements.count
    basis = _leading_directions(shapes)
    small = shapes @ basis.T
    tracks = (compressed.factors / scales[:, None, None]) @ basis.T
    chosen = np.arange(0, frames, -(-frames // FRAMES))
    scene = _Scene(small[chosen], tracks[chosen], rotations[chosen], noise)
    errors, energies, deformed = scene.exchange(rng)
    harder = scene.harder(rng)

    deviations = rotations @ (small - small.mean(axis=0))
    seen = np.einsum("fin,fin->f", deviations[:, :2], deviations[:, :2]) / 2.0
    second = np.einsum("fin,fim->nm", deviations[:, :2], deviations[:, :2]) / (2.0 * frames)
    expected, found = _depth_deformation(small, rotations)
    short = max(np.sqrt(expected) - np.sqrt(found), 0.0) ** 2 / max(float(np.trace(second)), _TINY)
    certain = harder**2 * (errors.T @ errors) / len(errors)
    other = scene.disagreement()
    if float(np.trace(other)) > float(np.trace(certain)):
        certain = other
    short = min(short, MISSING**2 * float(np.trace(certain)) / max(float(np.trace(second)), _TINY))
    weights = _frame_weights(energies, deformed, seen)

    poor = np.maximum(_mean_depth_variance(rotations) - 1.0, 0.0)
    extent = float(np.sum(tracks**2)) / (2.0 * frames * points)
    still = float(np.clip(2.0 * (1.0 - camera_turn(rotations) / LEAST_TURN), 0.0, 1.0))
    scale = INFLATION * compressed.measurements.unit
    model = DeviationModel(
        first=_fields(compressed, basis, certain + short * second),
        deform=_fields(compressed, basis, second) if poor.any() else None,
        weights=weights,
        poor=poor,
        bounds=(still * extent, extent),
        ripple=noise**2 * _noise_gains(shapes, compressed, rotations),
        noise=noise,
        scale=scale,
    )
    parts = {
        "exchange": np.sqrt(float(np.trace(certain)) / points),
        "missing": np.sqrt(short * float(np.trace(second)) / points),
        "noise": np.sqrt(float(np.sum(model.ripple @ compressed.sizes)) / (frames * points)),
        "mean": 0.0,
    }
    report: dict[str, Any] = {name: float(scale * value) for name, value in parts.items()}
    return model, report | {"harder": float(harder), "frames": len(chosen)}


@dataclass(frozen=True)
class DeviationModel:
    """What makes the deviation of a point out of its track: see the formula at the head of this file.

    ``first``, ``deform``: for each cell fields (j, 2F) whose values on a track, squared and summed, are the form of the
    shapes' second moments and that of the deformation. ``weights``, ``poor`` (F,): b_f, h_f − 1. ``bounds`` of m².
    ``ripple`` (F, K): the noise's part. ``scale``: κ times the tracks' unit.
    """

    first: tuple[np.ndarray, ...]
    deform: tuple[np.ndarray, ...] | None
    weights: np.ndarray
    poor: np.ndarray
    bounds: tuple[float, float]
    ripple: np.ndarray
    noise: float
    scale: float

    def of(self, first: np.ndarray, deform: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, float]:
        """Deviations (F, n) float32 of points with these forms (n,) and cells (n,); and the sum of m² over them."""
        out = np.empty((len(self.weights), len(first)), dtype=np.float32)
        total = 0.0
        for f, weight in enumerate(self.weights):
            mean = np.clip(self.poor[f] * (deform + self.noise**2), *self.bounds)
            total += float(mean.sum())
            out[f] = self.scale * np.sqrt(weight * first + mean + self.ripple[f][labels])
        return out, total


class _Scene:
    """Shapes (F, 3, k), tracks (F, 2, k) and cameras (F, 3, 3) in k directions, for recoveries of what is known."""

    def __init__(self, shapes: np.ndarray, tracks: np.ndarray, rotations: np.ndarray, noise: float) -> None:
        self.shapes, self.tracks, self.rotations, self.noise = shapes, tracks, rotations, noise
        self.rows = rotations[:, :2]
        self.back = np.swapaxes(self.rows, 1, 2)
        self.planes = self.back @ self.rows

    def exchange(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth errors (n, k) of exchanged shapes, their energies (n,), and how much each deforms in the image (n,)."""
        errors, deformed = [], []
        mean = self.shapes.mean(axis=0)
        for turn in range(max(2, -(-ENOUGH // (2 * len(self.shapes))))):
            shapes = self._shifted(rng, backwards=turn % 2 == 1)
            true = self.rotations @ shapes
            found = self.rotations @ recover(self.planes, self.back @ self._with_noise(true[:, :2], rng))
            errors.append((_turned(found, true) - true)[:, 2])
            seen = self.rows @ (shapes - mean)
            deformed.append(np.einsum("fin,fin->f", seen, seen) / 2.0)
        stacked = np.concatenate(errors)
        return stacked, np.sum(stacked**2, axis=1), np.concatenate(deformed)

    def disagreement(self) -> np.ndarray:
        """Second moment (k, k) of the depth gap between the shapes and what is recovered from the tracks themselves."""
        shapes = self.rotations @ self.shapes
        found = self.rotations @ recover(self.planes, self.back @ self.tracks)
        gap = (_turned(found, shapes) - shapes)[:, 2]
        return np.asarray(gap.T @ gap / len(gap))

    def harder(self, rng: np.random.Generator) -> float:
        """ρ: error of predicting a withheld image direction of the tracks over that of exchanged shapes."""
        count = len(self.shapes)
        sums = np.zeros(2)
        for turn in range(1 if count > 40 else 3):
            held = (np.arange(count) * BLOCKS // count % 3) == (turn + int(rng.integers(3))) % 3
            if count < BLOCKS:
                held = np.arange(count) % 3 == turn
            angle = rng.uniform(0.0, np.pi)
            kept = np.cos(angle) * self.rows[:, 0] + np.sin(angle) * self.rows[:, 1]
            lost = np.cos(angle) * self.rows[:, 1] - np.sin(angle) * self.rows[:, 0]
            planes = self.planes.copy()
            planes[held] = kept[held, :, None] * kept[held, None, :]
            exchanged = self.rows @ self._shifted(rng, backwards=False)
            for i, tracks in enumerate((self.tracks, self._with_noise(exchanged, rng))):
                target = self.back @ tracks
                found = recover(planes, planes @ target)[held]
                gap = np.einsum("fi,fin->fn", lost[held], found - target[held])
                # A small turn about the kept direction shifts the lost one by the depth: no error of the shape.
                depth = np.einsum("fi,fin->fn", self.rotations[held, 2], found)
                turn_by = np.sum(gap * depth, axis=1) / np.maximum(np.sum(depth**2, axis=1), _TINY)
                gap -= turn_by[:, None] * depth
                sums[i] += float(np.sum(gap**2)) - self.noise**2 * gap.size
        if sums.min() <= 0:
            return 1.0
        return float(np.clip(np.sqrt(sums[0] / sums[1]), *HARDER))

    def _shifted(self, rng: np.random.Generator, *, backwards: bool) -> np.ndarray:
        count = len(self.shapes)
        moved = np.roll(self.shapes, int(rng.integers(max(count // 4, 1), max(3 * count // 4, 1) + 1)), axis=0)
        return moved[::-1] if backwards else moved

    def _with_noise(self, tracks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return tracks + self.noise * rng.standard_normal(tracks.shape)


def recover(planes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Shapes (F, 3, k) of low rank over frames with ``planes`` (F, 3, 3) @ shapes = ``target`` (F, 3, k).

    Reweighted nuclear norm by alternating directions; the penalty grows geometrically, so that the time is fixed.
    """
    low, dual = target.copy(), np.zeros_like(target)
    cut = 0.3 * float(np.linalg.norm(target.reshape(len(target), -1), 2)) / REWEIGHT
    shapes = target
    for _ in range(ITERATIONS):
        shapes = low - dual
        shapes = shapes + planes @ (target - shapes)
        low, _ = threshold_over_frames(shapes + dual, cut, REWEIGHT)
        dual = (dual + shapes - low) / GROWTH
        cut /= GROWTH
    return shapes


def _leading_directions(shapes: np.ndarray) -> np.ndarray:
    """Orthonormal rows (k, N) that hold most of the shapes (F, 3, N), k ≤ ``DIRECTIONS``."""
    flat = shapes.reshape(-1, shapes.shape[2])
    by_rows = len(flat) < flat.shape[1]
    squares, vectors = np.linalg.eigh(flat @ flat.T if by_rows else flat.T @ flat)
    kept = slice(len(squares) - min(DIRECTIONS, len(squares)), None)
    live = squares[kept] > 1e-12 * max(float(squares[-1]), _TINY)
    live[-1] = True
    squares, vectors = squares[kept][live], vectors[:, kept][:, live]
    if not by_rows:
        return np.asarray(vectors.T)
    return np.asarray(vectors.T @ flat / np.sqrt(np.maximum(squares, _TINY))[:, None])


def _turned(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """``found`` (F, 3, k) with every frame turned onto ``true``."""
    left, _, right = np.linalg.svd(true @ np.swapaxes(found, 1, 2))
    return np.asarray(left @ right @ found)


def _depth_deformation(shapes: np.ndarray, rotations: np.ndarray) -> tuple[float, float]:
    """Mean square of the deformation along the viewing directions: as the image planes lead to expect, and as found.

    The 3×3 second moment M of deformation fits P_f G_f P_f ≈ P_f M P_f, G_f the frame's own and P_f its image plane.
    """
    deviations = shapes - shapes.mean(axis=0)
    moments = deviations @ np.swapaxes(deviations, 1, 2)
    views = rotations[:, 2]
    planes = np.eye(3) - views[:, :, None] * views[:, None, :]
    forms = np.einsum("fab,fcd->facbd", planes, planes).reshape(len(planes), 9, 9)
    normal = forms.sum(axis=0)  # P ⊗ P is a projector: its square is itself
    right = np.einsum("fij,fj->i", forms, moments.reshape(-1, 9))
    even = np.einsum("fij,fij->", planes, moments) / (2.0 * len(planes)) * np.eye(3).ravel()
    ridge = EVENNESS * len(planes)
    moment = np.linalg.solve(normal + ridge * np.eye(9), right + ridge * even).reshape(3, 3)
    expected = np.einsum("fi,ij,fj->f", views, moment, views)
    found = np.einsum("fi,fij,fj->f", views, moments, views)
    return max(float(expected.mean()), 0.0), max(float(found.mean()), 0.0)


def _frame_weights(energies: np.ndarray, deformed: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """b_f (F,), mean 1: energies regressed on how much a frame deforms, evaluated at ``seen`` (F,)."""
    spread = float(np.var(deformed))
    slope = float(np.mean((deformed - deformed.mean()) * (energies - energies.mean()))) / max(spread, _TINY)
    start = float(energies.mean()) - slope * float(deformed.mean())
    if slope <= 0 or not np.isfinite(slope) or energies.mean() <= 0:
        return np.ones(len(seen))
    weights = np.maximum(start, 0.0) + slope * seen
    return np.asarray(np.clip(weights / weights.mean(), 0.1, 10.0)) if weights.mean() > 0 else np.ones(len(seen))


def _mean_depth_variance(rotations: np.ndarray) -> np.ndarray:
    """h_f (F,): variance of the mean shape's depth in units of that of one image coordinate's deformation."""
    values, vectors = np.linalg.eigh(np.einsum("fij,fik->jk", rotations[:, :2], rotations[:, :2]))
    return np.asarray((rotations[:, 2] @ vectors) ** 2 @ (1.0 / np.maximum(values, 1e-9 * len(rotations))))


def _noise_gains(shapes: np.ndarray, compressed: CompressedTracks, rotations: np.ndarray) -> np.ndarray:
    """‖t‖² (F, K): squared length of the weights that give the depth of a frame from a cell's tracks."""
    depths = np.einsum("fi,fin->fn", rotations[:, 2], shapes)
    maps = compressed.maps or (np.linalg.pinv(compressed.factors.reshape(2 * len(shapes), -1), rcond=1e-6),)
    own = (depths[:, compressed.offsets[k] : compressed.offsets[k + 1]] for k in range(len(compressed.sizes)))
    # ‖d T‖² = d T Tᵀ dᵀ: the weights themselves, F × 2F for every cell, are never formed.
    return np.stack(
        [np.sum(part @ (back @ back.T) * part, axis=1) for part, back in zip(own, maps, strict=True)], axis=1
    )


def _fields(compressed: CompressedTracks, basis: np.ndarray, form: np.ndarray) -> tuple[np.ndarray, ...]:
    """For each cell the map (j, 2F) of a track whose squares sum to q_pᵀ form q_p, form (k, k) non-negative.

    q_p = basis @ (the point's coordinates). Without cells' maps: the values (j, N) themselves.
    """
    values, vectors = np.linalg.eigh(form)
    live = values > 1e-6 * max(float(values[-1]), _TINY)
    fields = (vectors[:, live] * np.sqrt(values[live])).T @ basis
    if not compressed.maps:
        return (fields,)
    own = (fields[:, a:b] for a, b in zip(compressed.offsets[:-1], compressed.offsets[1:], strict=True))
    return tuple(part @ back for part, back in zip(own, compressed.maps, strict=True))


def _point_quadratic(compressed: CompressedTracks, fields: tuple[np.ndarray, ...], workers: int) -> np.ndarray:
    """The form (P,) of every point, from :func:`_fields`; so many cells at a time."""
    if not compressed.maps:
        return np.asarray(np.sum(fields[0] ** 2, axis=0))
    out = np.empty(compressed.measurements.count)

    def fill(cell: tuple[np.ndarray, np.ndarray]) -> None:
        left, members = cell
        for start in range(0, len(members), 4096):
            some = members[start : start + 4096]
            out[some] = np.sum((left @ compressed.measurements.columns(some)) ** 2, axis=0)

    cells = zip(fields, members_of_cells(compressed.labels, compressed.sizes), strict=True)
    for _ in side_by_side(fill, list(cells), workers):
        pass
    return out
