"""One affine reconstruction: complete tracks, seen by an orthographic or weakly perspective camera, to shapes.

measure → cameras → cells → compress → method → gauge → expand → deviation → mirror. Each stage is timed here and named
to the caller's progress function; nothing below this file times, draws or aligns anything.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from nrsfm.cameras import (
    LEAST_TURN,
    CameraEstimate,
    CameraOptions,
    camera_turn,
    choose_mirror,
    estimate_cameras,
    mirrored,
)
from nrsfm.checkpoints import Checkpoint
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
from nrsfm.gauge import GaugeOptions, fix_gauge
from nrsfm.manifolds.rotations import whole_rotations
from nrsfm.methods.base import Method, Problem, Solution
from nrsfm.numerics.arrays import on_host
from nrsfm.numerics.noise import shrink_singular_values
from nrsfm.numerics.threads import single_thread
from nrsfm.options import option
from nrsfm.progress import Report
from nrsfm.reconstruction import Reconstruction
from nrsfm.streaming.on_device import OnDevice
from nrsfm.streaming.runners import Threads
from nrsfm.streaming.stream import Stream
from nrsfm.uncertainty import UncertaintyOptions, depth_deviation, deviation_model

_MIRROR_POINTS = 5_000  # at most about so many points tell which way the shape bulges
_THIN = 1e-5  # points this much narrower than long lie on a line
_COORDINATES = 10  # leading track coordinates in which cells and neighbours are found
_LEADING = 96  # singular vectors of a long sequence: cameras and cells are found from fewer


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
    memory: str | None = option(
        None,
        "Memory that the whole process may take, such as 4GB. Default: no limit, and blocks of half a gigabyte of "
        "tracks that stay in their file.",
    )
    shapes_file: str | None = option(
        None,
        "File that the shapes are written to, block by block: .npy, .npz, .h5 or .zarr. The result is then a map of "
        "the file (of .zarr it is read). Default: memory.",
    )
    checkpoint: str | None = option(
        None,
        "Folder in which finished stages are kept: an interrupted run that is started again goes on after the last of "
        "them. Default: nothing is kept.",
    )
    cluster: str | None = option(
        None,
        "Workers that do the passes over the points: the address of a dask scheduler, such as tcp://host:8786; in "
        "Python also a dask.distributed Client or a concurrent.futures.Executor. Default: the threads of this process.",
    )
    ordered: bool = option(
        True, "The frames follow one another in time. Off refuses methods that need it (see nrsfm methods)."
    )


class Stages:
    """Names, times and reports the stages of one run; the time of a stage inside another counts for itself alone.

    ``kept`` gives the result of a stage that may be in the run's checkpoint.
    """

    def __init__(self, report: Report, checkpoint: Checkpoint | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self.kept = (checkpoint or Checkpoint()).kept
        self._report = report
        self._inner = [0.0]  # seconds of the stages inside each open one
        self._open: list[str] = []

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[Callable[[float], None]]:
        """A stage of that name; yields the function that is told its fraction."""
        self._report(name, None)
        start = time.perf_counter()
        self._inner.append(0.0)
        self._open.append(name)
        yield lambda fraction: self._report(name, fraction)
        self._open.pop()
        if self._open:  # the stage around it goes on: what is measured from here is its own
            self._report(self._open[-1], None)
        whole, inner = time.perf_counter() - start, self._inner.pop()
        self._inner[-1] += whole
        self.seconds[name] = self.seconds.get(name, 0.0) + whole - inner


@dataclass(frozen=True)
class Settings:
    """The options of every stage of an affine reconstruction, and its seed."""

    pipeline: PipelineOptions
    camera: CameraOptions
    gauge: GaugeOptions
    uncertainty: UncertaintyOptions
    method: Any
    seed: int


def reconstruct_affine(
    points: np.ndarray | Stream, method: Method, known: np.ndarray | None, settings: Settings, stages: Stages
) -> Reconstruction:
    """Shapes and cameras of complete tracks (F, P, 2) under known cameras (F, 3, 3) or estimated ones.

    A stream gives the same as its points in memory would, up to the sample that the cells and the noise are learnt on.
    """
    pipeline = settings.pipeline
    rng = np.random.default_rng(settings.seed)
    with stages("reading tracks") as monitor:
        measured = points.measure(settings.seed, monitor) if isinstance(points, Stream) else measure(points)
        with single_thread():
            values, vectors = spectrum(measured, leading=max(_LEADING, 3 * (settings.camera.camera_rank or 0)))
        coordinates = track_coordinates(measured, vectors[:, :_COORDINATES])
        noise = _noise_level(measured, values, coordinates, pipeline, rng)
    denoise = method.denoise if pipeline.denoise is None else pipeline.denoise
    with stages("cameras") as monitor:
        seen = (measured, values, vectors, known, noise, settings.camera, settings.seed, monitor)
        cameras = stages.kept("cameras", partial(_cameras, *seen))
    # The cells' eigenproblems are small: one thread each, several at a time.
    several = Threads()
    with stages("compression") as monitor, single_thread():
        if method.needs.every_point:
            compressed = uncompressed(measured)
        else:
            level, cells = noise if denoise else 0.0, method.cells(settings.method, measured.count, measured.frames)
            about = (points, measured, coordinates, cells, level, pipeline.tolerance, rng, several, monitor)
            compressed = stages.kept("compression", partial(_compressed, *about), rng=rng, held=(measured,))
            del about
        del coordinates  # as large as a tenth of short tracks, and not needed again
    with stages(method.name) as monitor, single_thread():
        problem = Problem(
            compressed.factors / cameras.scales[:, None, None],
            compressed.offsets,
            compressed.sizes,
            np.ascontiguousarray(cameras.rotations[:, :2]),
            noise,
            cameras_known=known is not None,
            residual=compressed.residual,
            ordered=pipeline.ordered,
        )
        solve = partial(_solved, points, method, problem, settings.method, rng, monitor)
        solution = stages.kept(method.name, solve, rng=rng)
    warnings = [*_on_lines(measured), *cameras.warnings, *solution.warnings]
    reference = cameras.rotations
    cameras = _moved_by_the_method(cameras, solution)
    gauge: dict[str, Any] = {"chosen": "cameras"}
    if known is None:
        with stages("object frame"), single_thread():
            solution.shapes, rotations, gauge = fix_gauge(
                solution.shapes,
                cameras.rotations,
                settings.gauge,
                reference=reference,
                even=cameras.path == "orbit",
                ordered=pipeline.ordered,
            )
            cameras = replace(cameras, rotations=rotations, turn=camera_turn(rotations))
    rotations, mirror = cameras.rotations, None
    if known is None:
        with stages("mirror"):
            rotations, mirror = _mirror(
                cameras.rotations, compressed, solution.shapes, settings.camera.mirror, warnings
            )
            cameras = replace(cameras, rotations=rotations)
    elif settings.camera.mirror:
        warnings.append("mirror is ignored: known cameras leave one solution")
    shapes, deviation, uncertain = _expanded(points, compressed, solution.shapes, cameras, noise, settings, stages)
    groups = None if solution.groups is None else solution.groups[compressed.labels]
    return Reconstruction(
        shapes=shapes,
        rotations=rotations,
        translations=measured.translations,
        scales=cameras.scales,
        groups=groups,
        depth_deviation=deviation,
        diagnostics={
            "iterations": solution.iterations,
            "stop_reason": solution.stop_reason,
            "history": solution.history,
            "seconds": stages.seconds,
            "noise": noise * measured.unit,
            "compression": _compression_report(compressed),
            "cameras": {"known": True} if mirror is None else _camera_report(cameras, mirror),
            "gauge": gauge,
            "uncertainty": uncertain,
            "chosen": solution.chosen,
            "warnings": warnings,
        },
        method=method.name,
        options={"denoise": denoise},
    )


def _compressed(
    points: np.ndarray | Stream,
    measured: Measurements,
    coordinates: np.ndarray,
    cells: int,
    noise: float,
    tolerance: float,
    rng: np.random.Generator,
    several: Threads,
    monitor: Callable[[float], None],
) -> CompressedTracks:
    """Points to cells, and each cell to its virtual points."""
    if isinstance(points, Stream):
        return points.compress(measured, noise=noise, tolerance=tolerance, told=monitor)
    labels = kmeans(coordinates, cells, rng)
    return compress(measured, labels, noise=noise, tolerance=tolerance, apply=several.map)


def _solved(
    points: np.ndarray | Stream,
    method: Method,
    problem: Problem,
    options: Any,
    rng: np.random.Generator,
    monitor: Callable[[float], None],
) -> Solution:
    """The method's solution, on the host; found where the points are if the method can be there."""
    if isinstance(points, OnDevice) and getattr(method, "on_device", False):
        problem = problem.beside(points.points)
    solution = method.solve(problem, options, rng, monitor)
    solution.shapes = on_host(solution.shapes)
    return solution


def _expanded(
    points: np.ndarray | Stream,
    compressed: CompressedTracks,
    shapes: np.ndarray,
    cameras: CameraEstimate,
    noise: float,
    settings: Settings,
    stages: Stages,
) -> tuple[np.ndarray, np.ndarray | None, dict[str, Any] | None]:
    """Shapes (F, 3, N) of the virtual points to those of all points; their depths' deviations, and what these say."""
    dtype = np.dtype(settings.pipeline.precision)
    wanted = settings.uncertainty.deviation
    rng = np.random.default_rng([settings.seed, 1])  # its own: switching deviations off must change nothing else
    about = (shapes, compressed, cameras.rotations, cameras.scales, noise, rng)
    if isinstance(points, Stream):
        model, report = None, None
        if wanted:
            with stages("deviation"), single_thread():
                model, report = deviation_model(*about)
        with stages("expansion") as monitor:
            found = points.expand(compressed, shapes, dtype, model, monitor)
        return found["shapes"], found.get("depth_deviation"), report
    with stages("expansion"):
        out = compressed.expand(shapes, dtype)
    if not wanted:
        return out, None, None
    with stages("deviation"):
        deviation, report = depth_deviation(*about)
    return out, deviation, report


def _moved_by_the_method(cameras: CameraEstimate, solution: Solution) -> CameraEstimate:
    """The cameras after a method that estimates cameras and shapes together."""
    if solution.rotations is not None:
        rotations = whole_rotations(solution.rotations)
        cameras = replace(cameras, rotations=rotations, turn=camera_turn(rotations))
    if solution.scales is not None:
        cameras = replace(cameras, scales=cameras.scales * solution.scales)
    return cameras


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
    rotations: np.ndarray, compressed: CompressedTracks, shapes: np.ndarray, other: bool, warnings: list[str]
) -> tuple[np.ndarray, dict[str, Any]]:
    """Put rotations and shapes (F, 3, N), in place, into the conventional one of the two mirror images, or the other.

    Judged on some of the real points.
    """
    report = choose_mirror(rotations, compressed.some(shapes, _MIRROR_POINTS), mirror=other)
    if not report["decided"]:
        warnings.append(
            "which of the two mirror images is shown is arbitrary: orthographic tracks cannot tell, and the shape "
            "bulges neither way (option mirror gives the other one)"
        )
    if report["flip"]:
        shapes[:, 2] *= -1
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
