"""How far an estimate is from the truth: e3D under its alignments, the mocap literature's error, camera error.

The papers of this field do not agree on alignment, so every alignment is here and each has a name.

Points that a ``Reconstruction`` says it could not reconstruct (see ``Reconstruction.reconstructed``) are not scored:
they count in no mean, no centre and no alignment, and :func:`scored_points` says which points do. A plain array has
no such word: NaN in it is an error, except where ``valid`` is false.

Shapes of any size are taken: every score walks from frame to frame, holds the two shapes of one frame in float64, and
gives back the memory that reading a mapped file has taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.devices import is_on_device, to_host
from nrsfm.errors import InputError, suggest
from nrsfm.streaming.readers import release

ALIGNMENTS = ("none", "global", "per-frame", "similarity")


def _shapes(value: Any, name: str) -> np.ndarray:
    value = getattr(value, "shapes", value)
    if is_on_device(value):
        value = to_host(value)
    array = value if isinstance(value, np.memmap) else np.asarray(value)  # a map stays one: see release
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: real numbers are needed, received dtype {array.dtype}")
    if array.ndim != 3 or array.shape[2] != 3:
        raise InputError(f"{name}: shape (frames, points, 3) is needed, received {array.shape}")
    if array.size == 0:
        raise InputError(f"{name}: at least one frame and one point are needed, received {array.shape}")
    return array


def scored_points(estimate: Any, truth: Any) -> np.ndarray:
    """Return which points (P,) are scored: those that neither side says it could not reconstruct.

    ``estimate`` and ``truth`` are shapes (F, P, 3), all of whose points are scored, or objects with ``.shapes``
    and, if points are missing, ``.reconstructed`` (P,) bool.
    """
    scored = np.ones(_shapes(truth, "truth").shape[1], dtype=bool)
    for value in (estimate, truth):
        reconstructed = getattr(value, "reconstructed", None)
        if reconstructed is not None:
            scored &= reconstructed
    return scored


@dataclass(frozen=True)
class _Pair:
    """Two shapes (F, P, 3) that belong together, as they came in, and what of them is scored.

    ``valid`` (F, P) or None: what counts in each frame; ``scored`` (P,): what has a shape on both sides.
    """

    est: np.ndarray
    true: np.ndarray
    valid: np.ndarray | None
    scored: np.ndarray

    def frames(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Number of a frame and both of its shapes (n, 3), float64 and centred, for each frame where points count.

        Raises ``InputError`` at the first frame with a coordinate that is not finite, where all must be.
        """
        everything = self.valid is None and bool(self.scored.all())
        for f in range(len(self.true)):
            known = None if everything else self.known(f)
            if known is not None and not known.any():
                continue
            a, b = _centred(self.est[f], known), _centred(self.true[f], known)
            # One coordinate that is not finite spoils the mean, and so all of its axis.
            if self.valid is None and not (np.isfinite(a[0]).all() and np.isfinite(b[0]).all()):
                self._require_finite()
            yield f, a, b
            release(self.est)
            release(self.true)

    def known(self, f: int) -> np.ndarray:
        """Which points (P,) count in a frame."""
        return self.scored if self.valid is None else self.scored & self.valid[f]

    def cross(self) -> np.ndarray:
        """Σ aᵀb (3, 3) over the frames."""
        return sum((a.T @ b for _, a, b in self.frames()), np.zeros((3, 3)))

    def _require_finite(self) -> None:
        for name, array in (("estimate", self.est), ("truth", self.true)):
            bad = sum(int(np.count_nonzero(~np.isfinite(frame[self.scored]))) for frame in array)
            if bad:
                raise InputError(f"{name}: every coordinate must be finite, received {bad} that are NaN or infinite")


def _pair(estimate: Any, truth: Any, valid: Any) -> _Pair:
    """Both shapes and the mask, checked as far as that needs no reading of the shapes."""
    est, true = _shapes(estimate, "estimate"), _shapes(truth, "truth")
    if est.shape != true.shape:
        raise InputError(f"estimate and truth must have the same shape, received {est.shape} and {true.shape}")
    if valid is not None:
        valid = np.asarray(valid)
        if valid.shape != true.shape[:2] or valid.dtype != np.bool_:
            raise InputError(
                f"valid: a bool array of shape {true.shape[:2]} is needed, received {valid.dtype} {valid.shape}"
            )
    return _Pair(est, true, valid, scored_points(estimate, truth))


def _check_alignment(align: str) -> None:
    if align not in ALIGNMENTS:
        listed, near = ", ".join(ALIGNMENTS), suggest(str(align), ALIGNMENTS)
        raise InputError(f"align must be one of {listed}, received {align!r}{near}")


def _centred(frame: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
    """The points (n, 3) that are known, in float64, about their mean."""
    frame = np.array(frame if known is None else frame[known], dtype=np.float64)
    with np.errstate(invalid="ignore"):  # infinity less itself: the caller refuses it by name
        frame -= frame.mean(axis=0)
    return frame


def _procrustes(cross: np.ndarray) -> np.ndarray:
    """Orthogonal Q (reflection allowed) that maximises trace(Qᵀ cross)."""
    u, _, vt = np.linalg.svd(cross)
    return u @ vt


def _moved(a: np.ndarray, b: np.ndarray, align: str, rotation: np.ndarray) -> np.ndarray:
    """One centred frame ``a`` put onto ``b``: by its own alignment where that is asked for, else by ``rotation``."""
    if align not in ("per-frame", "similarity"):
        return a @ rotation
    moved = a @ _procrustes(a.T @ b)
    size = float(np.sum(moved * moved))
    return moved * (float(np.sum(moved * b)) / size) if align == "similarity" and size > 0 else moved


def frame_errors(estimate: Any, truth: Any, align: str = "global", *, valid: np.ndarray | None = None) -> np.ndarray:
    """Relative 3D error of each frame, ‖S_est − S_true‖_F / ‖S_true‖_F, both centred per frame.

    Parameters
    ----------
    estimate, truth
        Shapes (F, P, 3), or objects with ``.shapes``; points that were not reconstructed are not scored.
    align
        ``"none"``: only centred. ``"global"``: one orthogonal matrix for the whole sequence, reflection allowed.
        ``"per-frame"``: orthogonal Procrustes in each frame, reflection allowed. ``"similarity"``: the same with
        one scale per frame (the scale that minimises the frame's error).
    valid
        Optional (F, P) bool: the points of each frame that count.

    Returns
    -------
    (F,) errors. A frame whose true shape is a single point gives 0 where the estimate is one too, else infinity
    (under ``"similarity"`` 0: the best scale is 0); a frame without any valid point gives NaN.

    Source: the paper's equation for e3D.
    """
    _check_alignment(align)
    return _frame_errors(_pair(estimate, truth, valid), align)


def _frame_errors(pair: _Pair, align: str) -> np.ndarray:
    rotation = _procrustes(pair.cross()) if align == "global" else np.eye(3)
    errors = np.full(len(pair.true), np.nan)
    for f, a, b in pair.frames():
        moved = _moved(a, b, align, rotation)
        norm, gap = np.linalg.norm(b), np.linalg.norm(moved - b)
        errors[f] = gap / norm if norm > 0 else (0.0 if gap == 0 else np.inf)
    return errors


def shape_error(estimate: Any, truth: Any, align: str = "global", *, valid: np.ndarray | None = None) -> float:
    """Mean over frames of the relative 3D error e3D; parameters as in :func:`frame_errors`; NaN if none counts."""
    return _mean(frame_errors(estimate, truth, align, valid=valid))


def _mean(errors: np.ndarray) -> float:
    known = errors[~np.isnan(errors)]
    return float(known.mean()) if len(known) else float("nan")


def point_errors(estimate: Any, truth: Any, align: str = "per-frame") -> np.ndarray:
    """Distance of every point from the truth after alignment, in the truth's unit: (F, P); NaN where not scored."""
    pair = _pair(estimate, truth, None)
    gaps = np.full(pair.true.shape[:2], np.nan)
    for f, moved, b in _aligned_frames(pair, align):
        gaps[f, pair.scored] = np.linalg.norm(moved - b, axis=1)
    return gaps


def aligned(estimate: Any, truth: Any, align: str = "global") -> np.ndarray:
    """Return the centred estimate moved onto the (centred) truth by the named alignment, (F, P, 3).

    Points that are not scored are NaN.
    """
    pair = _pair(estimate, truth, None)
    out = np.full(pair.true.shape, np.nan)
    for f, moved, _ in _aligned_frames(pair, align):
        out[f, pair.scored] = moved
    return out


def _aligned_frames(pair: _Pair, align: str) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Number of each frame, the estimate moved onto the truth, and the truth, both centred (n, 3)."""
    _check_alignment(align)
    rotation = _procrustes(pair.cross()) if align == "global" else np.eye(3)
    for f, a, b in pair.frames():
        yield f, _moved(a, b, align, rotation), b


@dataclass(frozen=True)
class _SeenPair(_Pair):
    """Both shapes as their cameras (F, 3, 3) see them."""

    cameras: tuple[np.ndarray, np.ndarray]

    def frames(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """See :meth:`_Pair.frames`."""
        for f, a, b in super().frames():
            yield f, a @ self.cameras[0][f].T, b @ self.cameras[1][f].T


def camera_frame_error(estimate: Any, truth: Any, truth_rotations: np.ndarray) -> float:
    """e3D between the shapes as their cameras see them, R_f S_f, after one orthogonal alignment (or mirror).

    The mocap literature's protocol: the object frame of an estimate may turn from frame to frame together with its
    cameras, which no orthographic data can forbid; in the camera frame that freedom is gone.

    Parameters
    ----------
    estimate
        Object with ``.shapes`` (F, P, 3) and ``.rotations`` (F, 3, 3).
    truth
        Shapes (F, P, 3) in the object frame.
    truth_rotations
        (F, 3, 3), camera from object.
    """
    pair = _pair(estimate, truth, None)
    cameras = np.asarray(estimate.rotations), np.asarray(truth_rotations)
    return _mean(_frame_errors(_SeenPair(pair.est, pair.true, pair.valid, pair.scored, cameras), "global"))


def mocap_error(estimate: Any, truth: Any) -> float:
    """The sparse mocap literature's error: mean point distance over the mean row deviation of the truth.

    One global orthogonal alignment (reflection allowed), then the mean over frames and points of the distance,
    divided by the mean over frames of (std of x + std of y + std of z) / 3. Never mix it with e3D in one table.
    Source: Akhter et al. 2008; Gotardo and Martinez 2011.
    """
    spreads, distances = [], []
    for _, moved, b in _aligned_frames(_pair(estimate, truth, None), "global"):
        spreads.append(np.std(b, axis=0).mean())
        distances.append(np.linalg.norm(moved - b, axis=1).mean())
    spread, distance = float(np.mean(spreads)), float(np.mean(distances))
    return distance / spread if spread > 0 else (0.0 if distance == 0 else float("inf"))


def rotation_error(estimate: Any, truth: Any) -> float:
    """Mean angle in degrees between camera rotations after the one alignment the data cannot fix.

    ``estimate`` and ``truth`` are (F, 3, 3) or (F, 2, 3), camera from object, or objects with ``.rotations``.
    The object frame is free up to one orthogonal matrix, and the mirror z → −z of the camera frame is not
    observable under orthography: both mirrors are tried and the better one counts.
    """
    rows = []
    for name, value in (("estimate", estimate), ("truth", truth)):
        array = np.asarray(getattr(value, "rotations", value), dtype=np.float64)
        if array.ndim != 3 or array.shape[1] not in (2, 3) or array.shape[2] != 3:
            raise InputError(f"{name}: shape (frames, 3, 3) or (frames, 2, 3) is needed, received {array.shape}")
        x, y = array[:, 0], array[:, 1]
        rows.append(np.stack([x, y, np.cross(x, y)], axis=1))
    est, true = rows
    if len(est) != len(true):
        raise InputError(f"estimate and truth must have as many frames, received {len(est)} and {len(true)}")
    best = np.inf
    flip = np.diag([1.0, 1.0, -1.0])
    for mirror in (np.eye(3), flip):
        candidate = mirror @ est @ mirror
        u, _, vt = np.linalg.svd(np.einsum("fij,fik->jk", candidate, true))
        fix = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        moved = candidate @ fix
        cosine = (np.einsum("fij,fij->f", moved, true) - 1.0) / 2.0
        best = min(best, float(np.degrees(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0))))))
    return best


def depth_calibration(
    estimate: Any, truth: Any, truth_rotations: np.ndarray | None = None, *, valid: np.ndarray | None = None
) -> dict[str, Any]:
    """How well ``depth_deviation`` tells the errors of the depths: the shares within 1 and 2 of it.

    Parameters
    ----------
    estimate
        A ``Reconstruction`` with ``depth_deviation``.
    truth
        Shapes (F, P, 3).
    truth_rotations
        (F, 3, 3), camera from object, or the identity in each frame where the truth is in the camera's frame.
        Without them the truth of each frame is first turned onto the estimate as its camera sees it, which takes
        a part of the error away: the shares come out larger.
    valid
        Optional (F, P) bool: the points of each frame that count.

    Both are compared in the frames of their own cameras, centred, because the image fixes its axes but not the
    object's. What orthographic tracks leave open is taken out once for the sequence: the mirror, and the unit, fitted
    to x and y alone.

    Returns
    -------
    ``entries`` (points scored, over all frames), ``within_1`` and ``within_2`` (shares from 0 to 1; 0.683 and 0.954
    for calibrated normal errors), ``error_rms`` and ``deviation_rms`` (in the truth's unit, equal where the
    deviations have the right size on the whole), and ``cameras`` ("true", or "aligned" without ``truth_rotations``).

    Raises
    ------
    InputError
        The estimate has no ``depth_deviation``, or nothing is left to score.
    """
    deviation = getattr(estimate, "depth_deviation", None)
    if deviation is None:
        raise InputError("estimate: a reconstruction with depth_deviation is needed, received one without")
    pair = _pair(estimate, truth, valid)
    if pair.valid is not None and not (pair.valid & pair.scored).any():
        raise InputError("valid: at least one point must count, received none")

    def frames() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for f, a, b in pair.frames():
            a = a @ estimate.rotations[f].T
            b = b @ _procrustes(b.T @ a) if truth_rotations is None else b @ truth_rotations[f].T
            yield a, b, np.asarray(deviation[f][pair.known(f)], dtype=np.float64)
            release(deviation)

    across = along = size = 0.0
    for a, b, _ in frames():
        across += float(np.sum(a[:, :2] * b[:, :2]))
        size += float(np.sum(a[:, :2] ** 2))
        along += float(a[:, 2] @ b[:, 2])
    unit = across / size if across > 0 else 1.0
    side = -1.0 if along < 0 else 1.0
    counts, squares = np.zeros(3), np.zeros(2)
    for a, b, sigma in frames():
        gap, sigma = np.abs(side * unit * a[:, 2] - b[:, 2]), unit * sigma
        counts += np.array([len(gap), np.count_nonzero(gap <= sigma), np.count_nonzero(gap <= 2 * sigma)])
        squares += np.array([gap @ gap, sigma @ sigma])
    error, expected = np.sqrt(squares / counts[0])
    return {
        "entries": int(counts[0]),
        "within_1": float(counts[1] / counts[0]),
        "within_2": float(counts[2] / counts[0]),
        "error_rms": float(error),
        "deviation_rms": float(expected),
        "cameras": "aligned" if truth_rotations is None else "true",
    }
