"""``track``: from frames to dense tracks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from nrsfm.errors import InputError, OptionError, suggest
from nrsfm.numerics.threads import single_thread
from nrsfm.options import split_options
from nrsfm.progress import Report, silent
from nrsfm.tracking import chaining, photometric, subspace
from nrsfm.tracking.deviation import EXACT, Deviations
from nrsfm.tracking.extrapolation import extrapolate, matches
from nrsfm.tracking.matching import SMOOTH, Template, despeckled, evened, noise_level, smoothing
from nrsfm.tracking.options import METHODS, TrackingOptions
from nrsfm.tracking.result import Layout, TrackingDiagnostics, TrackingResult
from nrsfm.tracking.revisiting import revisit
from nrsfm.tracking.scale import Sampler, Scale
from nrsfm.tracking.visibility import judge, threshold
from nrsfm.tracks import Tracks
from nrsfm.video.libraries import import_cv2

_SMALLEST = 16  # pixels in each direction


def track(
    frames: Any,
    mask: np.ndarray | None = None,
    reference: int | str = "auto",
    method: str = "subspace",
    step: int = 1,
    progress: Report = silent,
    **options: Any,
) -> TrackingResult:
    """Track every ``step``-th pixel of the object from the reference frame through all frames.

    Parameters
    ----------
    frames
        (F, H, W) or (F, H, W, 3) array, uint8 or floating in [0, 1], or :class:`nrsfm.video.Frames`.
    mask
        Where the object is: bool (H, W) for the reference frame, or (F, H, W) for every frame; ``None`` is the
        whole image. Masks of every frame also tell where a point cannot be visible.
    reference
        Number of the reference frame, or ``"auto"``: the frame that most resembles the others, among those that
        show most of the object where masks tell.
    method
        One of :data:`~nrsfm.tracking.options.METHODS`.
    step
        Pixels between neighbouring points.
    progress
        Called with the stage and the part of it that is done.
    options
        Fields of :class:`~nrsfm.tracking.options.TrackingOptions`.

    Raises
    ------
    InputError
        The frames or the mask have another shape or type, or are too few or empty.
    OptionError
        A method or option is unknown or out of range.
    """
    (chosen,) = split_options((TrackingOptions,), options, "tracking")
    if method not in METHODS:
        raise OptionError(
            f"method must be one of {', '.join(METHODS)}, received {method!r}{suggest(str(method), METHODS)}"
        )
    if isinstance(step, bool) or not isinstance(step, int | np.integer) or step < 1:
        raise OptionError(f"step must be a whole number of at least 1, received {step!r}")
    seconds: dict[str, float] = {}
    with _one_thread(), single_thread():
        with _timed(seconds, "images"):
            count, height, width = _size(frames)
            masks = _masks(mask, (count, height, width))
            number = _reference(frames, count, masks, reference)
            own = masks if masks is not None and masks.ndim == 2 else None if masks is None else masks[number]
            own = np.ones((height, width), dtype=bool) if own is None else own
            if not own[::step, ::step].any():
                raise InputError(f"mask: at least one point of the grid is needed in frame {number}, received none")
            fitted = method == "subspace" and count > 2 and chosen.fine > 0
            scale = Scale(own, 0.0 if method == "naive" else chosen.object_size)
            images = np.empty((count, *scale.shape), dtype=np.uint8)
            finer = np.empty_like(images) if fitted else images
            for f in range(count):
                image = _grey(frames, f)
                noise = 0.0
                if method != "naive":
                    image = despeckled(image)
                    image = scale.enlarged(image)
                    noise = noise_level(image)
                images[f] = evened(image, chosen.normalisation, smoothing(SMOOTH, noise))
                if fitted:
                    finer[f] = evened(image, photometric.FINE_BAND[0], smoothing(photometric.FINE_BAND[1], noise))
                progress("reading frames", (f + 1) / count)
        inside = scale.enlarged_mask(own)
        template = Template(images, inside, number, chosen)
        with _timed(seconds, "chaining"):
            chain = chaining.naive if method == "naive" else chaining.corrected
            counter = _counter(progress, "pairwise flow", (1 if method == "subspace" else 2) * (count - 1))
            flows, trusts = chain(template, counter)
            second = None
            if method != "subspace":
                other = chaining.corrected if method == "naive" else chaining.naive
                second, _ = other(template, counter)
        rank, residual = 0, float("nan")
        if method == "subspace" and count > 2:
            with _timed(seconds, "revisiting"):
                counter = _counter(progress, "finding again", chosen.sweeps * count)
                flows, trusts = revisit(template, flows, trusts, chosen.sweeps, counter)
            with _timed(seconds, "subspace"):
                counter = _counter(progress, "subspace flow", chosen.rounds * count)
                flows, trusts, found = subspace.refine(template, flows, trusts, counter)
                rank, residual = found.basis.shape[1] - 1, found.residual
            if chosen.extrapolate:
                with _timed(seconds, "extrapolation"):
                    counter = _counter(progress, "lost regions", matches(count))
                    flows = extrapolate(template, flows, counter)
        if fitted:
            second = flows.copy()
            with _timed(seconds, "photometric fit"):
                counter = _counter(progress, "photometric fit", chosen.fine * count)
                fine = Template(finer, inside, number, chosen, photometric.FINE_WINDOW)
                found = photometric.fit(template, fine, flows, counter)
                rank, residual = found.basis.shape[1] - 1, found.residual
        with _timed(seconds, "visibility"):
            every = masks if masks is not None and masks.ndim == 3 else None
            y, x = np.nonzero(own[::step, ::step])
            pixels = step * np.stack([x, y], axis=1).astype(np.int32)
            tracks, confidence, deviation, scores = _collect(template, scale, pixels, flows, second, fitted, every)
    layout = Layout(pixels, int(step), _colour(frames, number)[pixels[:, 1], pixels[:, 0]], (width, height))
    shown = tracks.visible.mean(axis=1) if tracks.visible is not None else np.ones(count)
    diagnostics = TrackingDiagnostics(
        method, number, scores[0], scores[1], shown, rank, residual / scale.factor, scale.factor, seconds, chosen
    )
    return TrackingResult(tracks, confidence, deviation, layout, diagnostics)


def _collect(
    template: Template,
    scale: Scale,
    pixels: np.ndarray,
    flows: np.ndarray,
    second: np.ndarray | None,
    fitted: bool,
    masks: np.ndarray | None,
) -> tuple[Tracks, np.ndarray, np.ndarray, np.ndarray]:
    """Tracks, confidence (F, P) and deviation (F, P) of the pixels (P, 2), likeness and error of each frame (2, F).

    ``second`` (F, h, w, 2) is another estimate of the flows, ``fitted`` whether they come from the photometric fit.
    """
    sampled = Sampler(scale, pixels, (template.left, template.top))
    count = len(flows)
    points = np.empty((count, len(pixels), 2), dtype=np.float32)
    visible = np.empty(points.shape[:2], dtype=bool)
    confidence = np.empty(points.shape[:2], dtype=np.float32)
    deviation = np.full(points.shape[:2], np.inf, dtype=np.float32)
    deviations = Deviations(template, scale.factor)
    scores = np.full((2, count), np.nan)
    least = threshold(template, flows)
    for f in range(count):
        flow = flows[f]
        points[f] = pixels + sampled(flow) / scale.factors
        if f == template.reference:
            visible[f], confidence[f], deviation[f], scores[:, f] = True, 1.0, EXACT, (1.0, 0.0)
            continue
        warped = template.sample(template.frames[f], flow)
        likeness = template.likeness(warped)
        seen, sure = judge(template, likeness, flow, None if masks is None else scale.enlarged_mask(masks[f]), least)
        visible[f], confidence[f] = sampled(seen), sampled(sure)
        if visible[f].any():
            variance = deviations.window(warped)
            if second is not None:
                variance += deviations.disagreement(flow - second[f])
            if not fitted:
                variance += deviations.disagreement(deviations.remainder(warped))
            deviation[f] = np.where(visible[f], np.sqrt(sampled(variance)) / scale.factor, np.inf)
            scores[0, f] = sampled(likeness)[visible[f]].mean()
            away = np.abs(warped.astype(np.float32) - template.image)
            scores[1, f] = sampled(away)[visible[f]].mean()
    return Tracks(points, visible), confidence, deviation, scores


def _size(frames: Any) -> tuple[int, int, int]:
    shape = tuple(int(n) for n in frames.shape)
    if isinstance(frames, np.ndarray):
        if frames.ndim not in (3, 4) or (frames.ndim == 4 and frames.shape[3] != 3):
            raise InputError(f"frames: shape (F, H, W) or (F, H, W, 3) is needed, received {frames.shape}")
        if frames.dtype != np.uint8 and frames.dtype.kind != "f":
            raise InputError(f"frames: uint8 or floating numbers in [0, 1] are needed, received {frames.dtype}")
    count, height, width = shape[:3]
    if count < 2:
        raise InputError(f"frames: at least 2 are needed, received {count}")
    if min(height, width) < _SMALLEST:
        raise InputError(
            f"frames: at least {_SMALLEST} pixels in each direction are needed, received {width} x {height}"
        )
    return count, height, width


def _image(frames: Any, f: int) -> np.ndarray:
    """One frame as float32 in [0, 255]."""
    image = np.asarray(frames[f])
    if image.dtype == np.uint8:
        return image.astype(np.float32)
    if not np.isfinite(image).all():
        raise InputError(f"frames: finite numbers are needed, received NaN or infinity in frame {f}")
    return (np.clip(image, 0, 1) * 255).astype(np.float32)


def _grey(frames: Any, f: int) -> np.ndarray:
    image = _image(frames, f)
    return image if image.ndim == 2 else image @ np.array([0.299, 0.587, 0.114], dtype=np.float32)


def _colour(frames: Any, f: int) -> np.ndarray:
    image = np.round(_image(frames, f)).astype(np.uint8)
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image


def _masks(mask: np.ndarray | None, shape: tuple[int, int, int]) -> np.ndarray | None:
    if mask is None:
        return None
    mask = np.asarray(mask)
    if mask.dtype != np.bool_ or mask.shape not in (shape, shape[1:]):
        raise InputError(f"mask: bool of shape {shape[1:]} or {shape} is needed, received {mask.dtype} {mask.shape}")
    return mask


def _reference(frames: Any, count: int, masks: np.ndarray | None, reference: int | str) -> int:
    if isinstance(reference, str):
        if reference != "auto":
            raise OptionError(f"reference must be a frame number or 'auto', received {reference!r}")
        if masks is not None and masks.ndim == 2:
            return 0  # one mask belongs to one frame, by default the first
        return _medoid(frames, count, masks)
    if isinstance(reference, bool) or not 0 <= reference < count:
        raise OptionError(f"reference must be from 0 to {count - 1}, received {reference!r}")
    return int(reference)


def _medoid(frames: Any, count: int, masks: np.ndarray | None) -> int:
    """The frame most like the others, among those that show nearly the most of the object."""
    cv2 = import_cv2()

    if not isinstance(frames, np.ndarray):
        from nrsfm.video import reference_frame

        return reference_frame(frames, masks)
    candidates = np.arange(count)
    if masks is not None:
        sizes = masks.reshape(count, -1).sum(axis=1)
        candidates = np.flatnonzero(sizes >= 0.95 * sizes.max())
    small = np.stack(
        [cv2.resize(_grey(frames, f), (24, 24), interpolation=cv2.INTER_AREA).ravel() for f in range(count)]
    )
    small -= small.mean(axis=1, keepdims=True)
    small /= np.linalg.norm(small, axis=1, keepdims=True) + 1e-6
    return int(candidates[np.argmax(np.median(small[candidates] @ small.T, axis=1))])


def _counter(progress: Report, stage: str, total: int) -> Any:
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        progress(stage, done / max(total, 1))

    return advance


@contextlib.contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV on as many threads as it was allowed before, at most 2: results do not depend on it, and no more helps."""
    cv2 = import_cv2()

    before = cv2.getNumThreads()
    cv2.setNumThreads(min(before, 2))
    try:
        yield
    finally:
        cv2.setNumThreads(before)
