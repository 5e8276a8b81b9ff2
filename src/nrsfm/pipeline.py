"""The one path from tracks to a reconstruction.

tracks → measure → cameras → cells → compress → method → expand → reconstruction. Each stage is timed here and named to
the caller's progress function; nothing below this file times, draws or aligns anything.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from nrsfm.cameras import (
    LEAST_TURN,
    CameraEstimate,
    CameraOptions,
    camera_turn,
    cameras_from_known,
    choose_mirror,
    estimate_cameras,
    mirrored,
)
from nrsfm.clustering import kmeans
from nrsfm.compression import (
    CompressedTracks,
    Measurements,
    compress,
    estimate_noise,
    measure,
    spectrum,
    track_coordinates,
    uncompressed,
)
from nrsfm.errors import InputError
from nrsfm.methods import get_method
from nrsfm.methods.base import Method, Problem, Solution
from nrsfm.numerics.noise import shrink_singular_values
from nrsfm.numerics.threads import single_thread
from nrsfm.options import option, split_options
from nrsfm.progress import Report, TerminalProgress, silent
from nrsfm.reconstruction import Reconstruction
from nrsfm.tracks import Tracks

logger = logging.getLogger(__name__)

_MIRROR_POINTS = 5_000  # at most about so many points tell which way the shape bulges
_THIN = 1e-5  # points this much narrower than long lie on a line
_COORDINATES = 10  # leading track coordinates in which cells and neighbours are found


@dataclass(frozen=True)
class PipelineOptions:
    """What every method shares: compression, noise and the precision of the result."""

    tolerance: float = option(
        1e-4,
        "Directions that the compression may cut in each cell: at most this root mean square per coordinate, in "
        "units of the tracks' own. The default is a hundredth of a pixel on an object 100 pixels in size; 0 is exact.",
        minimum=0,
        maximum=0.1,
    )
    denoise: bool | None = option(
        None,
        "Shrink the singular values of every cell optimally for the noise level while compressing. Default: on for "
        "bmm, grassmann and geometry-aware; off for the other methods, which then are as published.",
    )
    noise_level: float | None = option(
        None,
        "Standard deviation of the tracks' noise, in their unit. Default: estimated from the tracks.",
        minimum=0,
    )
    precision: str = option("float32", "Type of the returned shapes.", choices=("float32", "float64"))
    ordered: bool = option(
        True, "The frames follow one another in time. Off refuses methods that need it (see nrsfm methods)."
    )


class _Stages:
    """Names, times and reports the stages of one run."""

    def __init__(self, report: Report) -> None:
        self.seconds: dict[str, float] = {}
        self._report = report

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[Callable[[float], None]]:
        self._report(name, None)
        start = time.perf_counter()
        yield lambda fraction: self._report(name, fraction)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def reconstruct(
    tracks: Tracks | np.ndarray,
    method: str = "geometry-aware",
    rotations: np.ndarray | None = None,
    seed: int = 0,
    progress: bool | Report = False,
    **options: Any,
) -> Reconstruction:
    """Recover the 3D shape of every frame from 2D point tracks.

    Parameters
    ----------
    tracks
        ``Tracks``, or an array of points (F, P, 2), at least 3 frames and 4 points, complete.
    method
        One of ``nrsfm.method_names()``.
    rotations
        Known cameras (F, 3, 3) or (F, 2, 3), camera from object; estimated when not given.
    seed
        Seeds every random choice: same input, options, seed and thread count give the same output.
    progress
        ``True`` draws a line on a terminal's stderr; a function is called as ``progress(stage, fraction)``.
    **options
        Options of the pipeline (``PipelineOptions``), of the cameras (``CameraOptions``) and of the method
        (``nrsfm methods``).

    Returns
    -------
    Reconstruction
        ``points[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T + translations[f]``, in the tracks' unit.

    Raises
    ------
    InputError
        Tracks, rotations or options break a rule; the message names it and the value received.
    MissingEntriesError
        Some points were not seen in some frames.
    """
    tracks = tracks if isinstance(tracks, Tracks) else Tracks(tracks)
    tracks.require_complete()
    tracks.require_reconstructible()
    solver = get_method(method)
    pipeline, camera, own = split_options(
        (PipelineOptions, CameraOptions, solver.Options), options, f"method '{method}'"
    )
    _require(solver, tracks, pipeline)
    camera = _camera_options(camera, solver, own, ordered=pipeline.ordered)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number, at least 0, received {seed!r}")
    known = None if rotations is None else cameras_from_known(rotations, tracks.n_frames)
    if progress is True:
        with TerminalProgress() as line:
            return _run(tracks, solver, known, int(seed), line, pipeline, camera, own)
    if not callable(progress) and progress is not False:
        raise InputError(f"progress must be true, false or a function of (stage, fraction), received {progress!r}")
    report = progress if callable(progress) else silent
    return _run(tracks, solver, known, int(seed), report, pipeline, camera, own)


def _require(method: Method, tracks: Tracks, options: PipelineOptions) -> None:
    """Refuse tracks that do not have what the method declares to need."""
    needs = method.needs
    for least, count, what in (
        (needs.least_frames, tracks.n_frames, "frames"),
        (needs.least_points, tracks.n_points, "points"),
    ):
        if count < least:
            raise InputError(f"tracks: method '{method.name}' needs at least {least} {what}, received {count}")
    if needs.frame_order and not options.ordered:
        raise InputError(
            f"ordered: method '{method.name}' needs frames that follow one another in time, received "
            f"ordered={options.ordered}"
        )


def _run(
    tracks: Tracks,
    method: Method,
    known: np.ndarray | None,
    seed: int,
    report: Report,
    pipeline: PipelineOptions,
    camera: CameraOptions,
    own: Any,
) -> Reconstruction:
    stages = _Stages(report)
    rng = np.random.default_rng(seed)
    with stages("reading tracks"):
        measured = measure(tracks.points)
        with single_thread():
            values, vectors = spectrum(measured)
        coordinates = track_coordinates(measured, vectors[:, :_COORDINATES])
        noise = _noise_level(measured, values, coordinates, pipeline, rng)
    denoise = method.denoise if pipeline.denoise is None else pipeline.denoise
    with stages("cameras") as monitor:
        cameras = _cameras(measured, values, vectors, known, noise, camera, seed, monitor)
    # The cells' eigenproblems are small: threads would cost more than they give.
    with stages("compression"), single_thread():
        if method.needs.every_point:
            compressed = uncompressed(measured)
        else:
            labels = kmeans(coordinates, method.cells(own, measured.count, measured.frames), rng)
            compressed = compress(measured, labels, noise=noise if denoise else 0.0, tolerance=pipeline.tolerance)
        del coordinates  # as large as a tenth of short tracks, and not needed again
    with stages(method.name) as monitor, single_thread():
        problem = Problem(
            compressed.factors / cameras.scales[:, None, None],
            compressed.offsets,
            compressed.sizes,
            np.ascontiguousarray(cameras.rotations[:, :2]),
            noise,
            cameras_known=known is not None,
        )
        solution = method.solve(problem, own, rng, monitor)
    with stages("expansion"):
        shapes = compressed.expand(solution.shapes, np.dtype(pipeline.precision))
    cameras = _moved_by_the_method(cameras, solution)
    warnings = [*_on_lines(measured), *cameras.warnings, *solution.warnings]
    rotations, mirror = cameras.rotations, None
    if known is None:
        with stages("mirror"):
            rotations, mirror = _mirror(rotations, shapes, camera.mirror, warnings)
    elif camera.mirror:
        warnings.append("mirror is ignored: known cameras leave one solution")
    for text in warnings:
        logger.warning(text)
    groups = None if solution.groups is None else solution.groups[compressed.labels]
    return Reconstruction(
        shapes=shapes,
        rotations=rotations,
        translations=measured.translations,
        scales=cameras.scales,
        groups=groups,
        diagnostics={
            "iterations": solution.iterations,
            "stop_reason": solution.stop_reason,
            "history": solution.history,
            "seconds": stages.seconds,
            "noise": noise * measured.unit,
            "compression": _compression_report(compressed),
            "cameras": {"known": True} if mirror is None else _camera_report(cameras, mirror),
            "chosen": solution.chosen,
            "warnings": warnings,
        },
        method=method.name,
        options={"seed": seed, **_recorded(pipeline), **_recorded(camera), **_recorded(own)} | {"denoise": denoise},
    )


def _camera_options(options: CameraOptions, method: Method, own: Any, *, ordered: bool) -> CameraOptions:
    """The camera options with the method's own estimator, and its own K, where none is named."""
    name = options.camera_method or method.camera_method
    if not ordered:
        for wrong in {options.camera_path, name} & {"orbit", "smoothest"}:
            raise InputError(f"cameras: '{wrong}' needs frames that follow one another in time, received ordered=False")
        options = replace(options, camera_path="free")
    if method.needs.unscaled and options.scales == "auto":
        options = replace(options, scales="fixed")
    if name != method.camera_method:
        return options
    rank = options.camera_rank if options.camera_rank is not None else getattr(own, "rank", None)
    if method.camera_method in ("intersection", "grown", "rigid"):
        rank = options.camera_rank  # their K is a number of its own, or none
    return replace(options, camera_method=name, camera_rank=rank)


def _moved_by_the_method(cameras: CameraEstimate, solution: Solution) -> CameraEstimate:
    """The cameras after a method that estimates cameras and shapes together."""
    if solution.rotations is not None:
        rows = solution.rotations
        rotations = np.concatenate([rows, np.cross(rows[:, :1], rows[:, 1:])], axis=1)
        cameras = replace(cameras, rotations=rotations, turn=camera_turn(rotations))
    if solution.scales is not None:
        cameras = replace(cameras, scales=cameras.scales * solution.scales)
    return cameras


def _recorded(options: Any) -> dict[str, Any]:
    """Options as plain values; an array is named by its shape and digest."""
    return {
        name: f"array {value.shape} sha256 {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]}"
        if isinstance(value, np.ndarray)
        else value
        for name, value in ((field.name, getattr(options, field.name)) for field in fields(options))
    }


def _on_lines(measured: Measurements) -> list[str]:
    """Warn of frames whose points lie on one line, or in one place: a coordinate that is constant, for example."""
    gram = measured.gram.reshape(measured.frames, 2, measured.frames, 2)
    blocks = np.einsum("fifj->fij", gram)
    least, largest = np.linalg.eigvalsh(blocks).T
    lines = np.flatnonzero(least <= _THIN**2 * np.maximum(largest, 1e-6 * measured.count))
    if not len(lines):
        return []
    return [
        f"in {len(lines)} of {measured.frames} frames (the first is frame {lines[0]}) all points lie on one line: "
        "these frames do not determine their own depth and camera"
    ]


def _noise_level(
    measured: Measurements,
    values: np.ndarray,
    coordinates: np.ndarray,
    options: PipelineOptions,
    rng: np.random.Generator,
) -> float:
    """Noise in units of the tracks' rms: as told, or estimated; 0 below the tolerance."""
    if options.noise_level is not None:
        level = options.noise_level / measured.unit
    else:
        level = estimate_noise(measured, values, coordinates, rng)
    # Noise that the compression may cut anyway is none: exact tracks stay exactly compressed.
    return level if level > options.tolerance else 0.0


def _cameras(
    measured: Measurements,
    values: np.ndarray,
    vectors: np.ndarray,
    known: np.ndarray | None,
    noise: float,
    options: CameraOptions,
    seed: int,
    monitor: Callable[[float], None],
) -> CameraEstimate:
    """Cameras from the global factor of W, whose singular values are shrunk for the noise."""
    if known is not None:
        turn = camera_turn(known)
        still = [f"the given cameras hardly turn: {turn:.1f} degrees in all; depth is poorly determined"]
        return CameraEstimate(known, np.ones(measured.frames), rank=0, warnings=still if turn < LEAST_TURN else [])
    # The published estimators take the leading directions as they are.
    level = noise if options.camera_method in ("intersection", "rigid") else 0.0
    shrunk = shrink_singular_values(values, (len(vectors), measured.count), level)
    kept = (shrunk > 0) & (values > 1e-7 * values[0])
    kept[:3] = True
    factor = vectors[:, kept] * np.where(shrunk > 0, shrunk, values)[kept]
    return estimate_cameras(
        factor,
        options,
        seed=seed,
        progress=lambda _, fraction: monitor(fraction or 0.0),
    )


def _compression_report(compressed: CompressedTracks) -> dict[str, Any]:
    ranks = np.diff(compressed.offsets)
    return {
        "points": compressed.measurements.count,
        "virtual_points": int(compressed.offsets[-1]),
        "cells": len(ranks),
        "ranks": ranks.tolist(),
        "sizes": compressed.sizes.tolist(),
        "discarded": compressed.discarded,
    }


def _mirror(
    rotations: np.ndarray, shapes: np.ndarray, other: bool, warnings: list[str]
) -> tuple[np.ndarray, dict[str, Any]]:
    """Put rotations and shapes (in place) into the conventional one of the two mirror images, or the other one."""
    report = choose_mirror(rotations, shapes[:, :: max(1, shapes.shape[1] // _MIRROR_POINTS)], mirror=other)
    if not report["decided"]:
        warnings.append(
            "which of the two mirror images is shown is arbitrary: orthographic tracks cannot tell, and the shape "
            "bulges neither way (option mirror gives the other one)"
        )
    if report["flip"]:
        shapes[..., 2] *= -1
        rotations = mirrored(rotations)
    return rotations, report


def _camera_report(cameras: CameraEstimate, mirror: dict[str, Any]) -> dict[str, Any]:
    return {
        "known": False,
        "method": cameras.method,
        "rank": cameras.rank,
        "path": cameras.path,
        "turn": cameras.turn,
        "candidates": cameras.candidates,
        "mirror": mirror,
    }
