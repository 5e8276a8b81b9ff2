"""The object frame along a sequence: which part of the motion is the camera's and which is the object's.

R_f Oᵀ_f and O_f S_f show the same tracks for all rotations O_f, so the tracks do not say how an object is turned from
one frame to the next. Cameras from a metric upgrade carry their own errors into the shapes; a method that aligns every
shape with its mean lets a jaw turn the head. Nothing here changes R_f S_f; only the split is chosen. The candidates:

- ``cameras``: the cameras as estimated, before the method moved them.
- ``mean``: every shape turned onto their mean (generalised Procrustes analysis).
- ``even``: cameras on an even turn exp(f ω) R₀ (:mod:`nrsfm.cameras.orbit`), ω refined for the least mean
  log(σ_i + 10⁻³ ‖S♯‖) of the shapes it leaves, σ_i the singular values of S♯.
- ``steady``: object frames turned by ω_f = A z_f, z_f the r leading coefficients of the deformation, with the A (3 × r)
  that makes the camera's turn change least from frame to frame, in squared angles. A camera that jerks whenever the
  object deforms has taken over a part of the deformation; one that jerks on its own is left alone.

``auto``: an even turn where the estimated cameras are one, or where the cameras or the mean's are so near to one that
it is the simpler account (the thresholds of :mod:`nrsfm.cameras.estimate`). Otherwise, with fewer than ``FEW`` frames,
the mean: so few frames do not overdetermine a metric upgrade. Otherwise the one of cameras and mean with the steadier
path, then ``steady`` from there, if that lowers the cross-validated change of turn by a quarter and turns no frame far.
Of long sequences less of a gain is asked: there the cameras' jitter, which harms little, hides what does harm.
The rank of the shapes decides nothing between cameras and mean: it always favours the mean, because every turning of
the object costs rank.

Sources: Gower, "Generalized Procrustes analysis", Psychometrika 40, 1975; generalised cross-validation: Golub, Heath
and Wahba, Technometrics 21, 1979; the rest ours. Holds on the exact compression, being inner products over points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.cameras import orbit
from nrsfm.cameras.estimate import ORBIT_DEVIATION, ORBIT_SHARE, REFINED_TURN
from nrsfm.cameras.selection import NORM_TOLERANCE
from nrsfm.manifolds.procrustes import align
from nrsfm.manifolds.rotations import from_vectors, to_vectors
from nrsfm.numerics.threads import single_thread
from nrsfm.options import option

FEW = 20  # frames, below which a path's changes say nothing
ROUGHER = 1.05  # the mean must be steadier than the cameras by this factor to be taken
COEFFICIENTS = 5  # r: leading coefficients of the deformation
GAIN = 0.25  # least relative gain in the cross-validated mean square for ``steady`` to be taken
LONG = 100  # frames from which on less of a gain is no chance: it falls with the root of their number
LARGEST_TURN = 8.0  # degrees, root mean square: a larger ``steady`` turn is no correction
_DIRECTIONS = 60  # leading directions over points in which gauges are judged
_ROUNDS = 100
_EVALUATIONS = 80
_TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class GaugeOptions:
    """How the object frames of the sequence are tied together."""

    gauge: str = option(
        "auto",
        "Object frame along the sequence: cameras as estimated, as the method left them (method), shapes turned onto "
        "their mean (mean), cameras on an even turn (even), cameras as steady as the deformation allows (steady), or "
        "chosen from the data (auto). Changes no depth and no reprojection.",
        choices=("auto", "method", "cameras", "mean", "even", "steady"),
    )


def fix_gauge(
    shapes: np.ndarray,
    rotations: np.ndarray,
    options: GaugeOptions | None = None,
    *,
    reference: np.ndarray | None = None,
    even: bool = False,
    ordered: bool = True,
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Shapes and cameras in one consistent object frame; R_f S_f stays as it is.

    Parameters
    ----------
    shapes
        (F, 3, N), real or virtual points (of orthonormal maps), object frame of ``rotations``.
    rotations
        (F, 3, 3) camera from object, as the method left them.
    options
        ``auto`` where not given.
    reference
        (F, 3, 3) cameras as estimated; ``rotations`` where the method did not move them.
    even
        The estimated cameras are an even turn.
    ordered
        The frames follow one another in time; else only ``method``, ``cameras`` and ``mean`` are considered.

    Returns
    -------
    Shapes, rotations and a report: ``chosen`` (a word as in the options), ``moved`` (root mean square angle in degrees
    between the old and the new object frames) and what was compared. The first camera stays as it is.
    """
    wanted = (options or GaugeOptions()).gauge
    with single_thread():
        return _fix_gauge(shapes, rotations, wanted, reference, even, ordered)


def _fix_gauge(
    shapes: np.ndarray, rotations: np.ndarray, wanted: str, reference: np.ndarray | None, even: bool, ordered: bool
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    report: dict[str, Any] = {"chosen": wanted}
    given = rotations if reference is None else reference
    seen = rotations @ _leading(shapes)
    if wanted == "auto":
        path = _automatic(seen, given, rotations, even, ordered, report)
    elif wanted == "mean":
        path = mean_gauge(seen, given)
    elif wanted == "even" and ordered and len(seen) >= 4:
        path = even_gauge(seen, given)
    elif wanted == "steady" and ordered and len(seen) > 2 * COEFFICIENTS:
        path, _, _ = steady_gauge(seen, given)
    else:
        path = rotations if wanted == "method" else given
    # One turn for the whole sequence is free: the first camera stays where it was.
    path = path @ (path[0].T @ rotations[0])
    turns = np.swapaxes(path, 1, 2) @ rotations
    report["moved"] = float(np.degrees(np.sqrt(np.mean(_angles(turns) ** 2))))
    return turns @ shapes, path, report


def _automatic(
    seen: np.ndarray, given: np.ndarray, own: np.ndarray, even: bool, ordered: bool, report: dict[str, Any]
) -> np.ndarray:
    """The rule of this module's head, for shapes (F, 3, n) in the frames of their cameras."""
    if even:
        report["chosen"] = "even"
        return given
    if len(seen) < FEW and not np.allclose(own, given, atol=1e-9):
        report["chosen"] = "method"  # cameras estimated together with so few shapes are better than either
        return own
    mean = mean_gauge(seen, given)
    if not ordered or len(seen) < FEW:
        report["chosen"] = "mean" if len(seen) < FEW else "cameras"
        return mean if len(seen) < FEW else given
    near = _near_even(seen, (given, mean))
    if near is not None:
        report["chosen"] = "even"
        return near
    rough = {"cameras": roughness(given), "mean": roughness(mean)}
    report["roughness"] = rough
    name = "mean" if ROUGHER * rough["mean"] < rough["cameras"] else "cameras"
    path = mean if name == "mean" else given
    steady, gain, turn = steady_gauge(seen, path)
    report |= {"chosen": name, "gain": gain, "steady_turn": turn}
    if gain < GAIN * min(1.0, np.sqrt(LONG / len(seen))) or turn > LARGEST_TURN:
        return path
    report["chosen"] = "steady"
    return steady


def mean_gauge(seen: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Cameras (F, 3, 3) whose shapes are turned onto their mean; ``seen`` (F, 3, n) are R_f S_f."""
    path = rotations
    for _ in range(_ROUNDS):
        mean = (np.swapaxes(path, 1, 2) @ seen).mean(axis=0)
        turns, _ = align(seen, mean)
        change = float(np.abs(np.swapaxes(turns, 1, 2) - path).max())
        path = np.swapaxes(turns, 1, 2)
        if change < 1e-9:
            break
    return path


def even_gauge(seen: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """The even turn nearest to the cameras; over at least half a turn, refined for shapes of least log rank."""
    count = len(seen)
    frames = np.arange(count) - (count - 1) / 2.0
    velocity, _, turn = orbit.fit_orbit(rotations)
    if turn >= REFINED_TURN:

        def criterion(candidate: np.ndarray) -> float:
            return _log_rank(seen, orbit.orbit_path(candidate, frames, rotations))

        velocity, _ = orbit.refine_orbit(velocity, count, criterion, _EVALUATIONS)
    return orbit.orbit_path(velocity, frames, rotations)


def steady_gauge(seen: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Cameras whose turns change least, by turns of the object frame that are linear in its deformation.

    Returns the cameras, the relative gain in the cross-validated mean square change of turn, and the root mean square
    angle in degrees by which they were turned. The number of coefficients, up to ``COEFFICIENTS``, is the one of most
    gain.
    """
    count = len(seen)
    shapes = (np.swapaxes(rotations, 1, 2) @ seen).reshape(count, -1)
    left, values, _ = np.linalg.svd(shapes - shapes.mean(axis=0), full_matrices=False)
    rank = min(COEFFICIENTS, int(np.count_nonzero(values > 1e-6 * max(float(values[0]), _TINY))))
    before = roughness(rotations) ** 2
    best = (rotations, 0.0, 0.0)
    for size in range(1, rank + 1):
        scores = left[:, :size] * np.sqrt(count)
        path = rotations
        for _ in range(4):  # turns do not add up like vectors: the linear step is repeated from where it led
            slope = np.linalg.lstsq(np.diff(scores, n=2, axis=0), np.diff(_steps(path), axis=0), rcond=1e-8)[0]
            path = path @ np.swapaxes(from_vectors(scores @ slope), 1, 2)
        left_over = roughness(path) ** 2 / (1.0 - min(size / (count - 2), 0.9)) ** 2
        gain = 1.0 - left_over / max(before, _TINY)
        if gain > best[1]:
            angles = _angles(np.swapaxes(path, 1, 2) @ rotations)
            best = (path, float(gain), float(np.degrees(np.sqrt(np.mean(angles**2)))))
    return best


def roughness(rotations: np.ndarray) -> float:
    """Root mean square change of the camera's turn from one pair of frames to the next, in degrees."""
    changes = np.diff(_steps(rotations), axis=0)
    return float(np.degrees(np.sqrt(np.mean(np.sum(changes**2, axis=1)))))


def _near_even(seen: np.ndarray, paths: tuple[np.ndarray, ...]) -> np.ndarray | None:
    """An even turn that is close to one of the paths and whose shapes need hardly more of a nuclear norm."""
    for path in paths:
        _, deviation, turn = orbit.fit_orbit(path)
        if turn < REFINED_TURN or deviation > min(ORBIT_DEVIATION, ORBIT_SHARE * turn):
            continue
        found = even_gauge(seen, path)
        if _nuclear(seen, found) <= (1.0 + NORM_TOLERANCE) * _nuclear(seen, path):
            return found
    return None


def _leading(shapes: np.ndarray) -> np.ndarray:
    """Shapes (F, 3, n ≤ ``_DIRECTIONS``) in their leading directions over points; inner products are kept."""
    flat = np.asarray(shapes, dtype=np.float64).reshape(-1, shapes.shape[2])
    if flat.shape[1] <= _DIRECTIONS:
        return flat.reshape(len(shapes), 3, -1)
    gram = flat @ flat.T if len(flat) < flat.shape[1] else flat.T @ flat
    squares, vectors = np.linalg.eigh(gram)
    squares, vectors = squares[::-1][:_DIRECTIONS], vectors[:, ::-1][:, :_DIRECTIONS]
    small = vectors * np.sqrt(np.maximum(squares, 0.0)) if len(flat) < flat.shape[1] else flat @ vectors
    return np.asarray(small.reshape(len(shapes), 3, -1))


def _singular_values(seen: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    shapes = (np.swapaxes(rotations, 1, 2) @ seen).reshape(len(seen), -1)
    gram = shapes @ shapes.T if len(shapes) <= shapes.shape[1] else shapes.T @ shapes
    return np.sqrt(np.maximum(np.linalg.eigvalsh(gram), 0.0))


def _log_rank(seen: np.ndarray, rotations: np.ndarray) -> float:
    values = _singular_values(seen, rotations)
    return float(np.mean(np.log(values + 1e-3 * max(float(np.linalg.norm(values)), _TINY))))


def _nuclear(seen: np.ndarray, rotations: np.ndarray) -> float:
    return float(_singular_values(seen, rotations).sum())


def _steps(rotations: np.ndarray) -> np.ndarray:
    """Turn (F − 1, 3) between consecutive cameras in the object frame, as rotation vectors in radians."""
    return to_vectors(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:])


def _angles(rotations: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(to_vectors(rotations), axis=1))
