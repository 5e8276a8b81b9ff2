"""Errors of estimated tracks against true ones: end-point error in pixels, and visibility as a detection.

The end-point error is the distance between the estimated and the true position (Baker et al.: "A Database and
Evaluation Methodology for Optical Flow", IJCV 92, 2011), over the entries that are truly visible. Shares count every
truly visible entry, with an entry without a position as a miss.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from nrsfm.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class TrackScores:
    """How good tracks are.

    Attributes
    ----------
    mean, median
        End-point error in pixels over truly visible entries that have a position; NaN where there is none.
    per_frame
        (F,) mean of each frame; NaN for the reference and for frames without truly visible points.
    under_1, under_3
        Share of the truly visible entries whose error is below 1 and 3 pixels.
    missing
        Share of the truly visible entries without a finite position.
    precision, recall
        Of the entries called visible, the share that is; of those that are, the share called so. NaN for 0 / 0.
    hidden_recall
        Of the entries that are not visible, the share called so.
    entries
        Number of truly visible entries that were counted.
    """

    mean: float
    median: float
    per_frame: np.ndarray
    under_1: float
    under_3: float
    missing: float
    precision: float
    recall: float
    hidden_recall: float
    entries: int

    def __str__(self) -> str:
        return (
            f"end-point error mean {self.mean:.2f}, median {self.median:.2f} px; under 1 px {100 * self.under_1:.1f}%, "
            f"under 3 px {100 * self.under_3:.1f}%; visibility precision {100 * self.precision:.1f}%, "
            f"recall {100 * self.recall:.1f}%"
        )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def score_tracks(
    tracks: np.ndarray,
    visible: np.ndarray | None,
    true_tracks: np.ndarray,
    true_visible: np.ndarray,
    *,
    reference: int | None = None,
) -> TrackScores:
    """Compare tracks (F, N, 2) and their visibility (F, N) bool with the truth.

    Parameters
    ----------
    tracks, visible
        The estimate; ``visible`` may be ``None`` (all are called visible), and positions may be NaN.
    true_tracks, true_visible
        The truth, of the same shapes.
    reference
        A frame to leave out: where the points were chosen there is no error to measure.

    Raises
    ------
    InputError
        The shapes differ, or nothing is left to count.
    """
    if true_tracks.ndim != 3 or true_tracks.shape[2] != 2:
        raise InputError(f"true_tracks: shape (frames, points, 2) is needed, received {true_tracks.shape}")
    sizes = true_tracks.shape[:2]
    if tracks.shape != true_tracks.shape:
        raise InputError(f"tracks: shape {true_tracks.shape} is needed, as the truth has, received {tracks.shape}")
    for what, flags in (("visible", visible), ("true_visible", true_visible)):
        if flags is not None and (flags.shape != sizes or flags.dtype != np.bool_):
            raise InputError(f"{what}: bool of shape {sizes} is needed, received {flags.dtype} {flags.shape}")
    if reference is not None and not 0 <= reference < sizes[0]:
        raise InputError(f"reference must be from 0 to {sizes[0] - 1}, received {reference}")
    errors: list[np.ndarray] = []
    per_frame = np.full(sizes[0], np.nan)
    counts = np.zeros(5, dtype=np.int64)  # both visible, called visible, truly visible, both hidden, all
    for f in range(sizes[0]):
        if f == reference:
            continue
        true = true_visible[f]
        called = np.ones_like(true) if visible is None else visible[f]
        away = tracks[f][true].astype(np.float64) - true_tracks[f][true]
        distance = np.hypot(away[:, 0], away[:, 1])
        errors.append(distance)
        known = distance[np.isfinite(distance)]
        if len(known):
            per_frame[f] = known.mean()
        counts += [int(np.count_nonzero(n)) for n in (true & called, called, true, ~(true | called), true | ~true)]
    both, called_visible, entries, both_hidden, total = (int(n) for n in counts)
    if not entries:
        raise InputError("true_visible: at least one visible entry is needed, received none")
    distances = np.concatenate(errors)
    known = distances[np.isfinite(distances)]
    return TrackScores(
        mean=float(known.mean()) if len(known) else float("nan"),
        median=float(np.median(known)) if len(known) else float("nan"),
        per_frame=per_frame,
        under_1=float(np.count_nonzero(known < 1)) / entries,
        under_3=float(np.count_nonzero(known < 3)) / entries,
        missing=1 - len(known) / entries,
        precision=_ratio(both, called_visible),
        recall=both / entries,
        hidden_recall=_ratio(both_hidden, total - entries),
        entries=entries,
    )
