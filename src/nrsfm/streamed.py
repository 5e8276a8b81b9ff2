"""The path of tracks that are too large to be looked at as a whole: complete, read in blocks, shapes to a file.

What the ordinary path asks of every point (are there outliers, is there perspective) is asked of a sample. Where the
answer is yes and the points fit into memory, the ordinary path is taken after all; else a warning says so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.affine import PipelineOptions, Settings, Stages, reconstruct_affine
from nrsfm.devices import is_on_device, namespace, to_device, to_host
from nrsfm.errors import InputError
from nrsfm.methods.base import Method
from nrsfm.perspective import PerspectiveOptions
from nrsfm.perspective.evidence import find_perspective
from nrsfm.reconstruction import Reconstruction
from nrsfm.repair import Repaired, RepairOptions, repair
from nrsfm.streaming.memory import resident
from nrsfm.streaming.on_device import OnDevice
from nrsfm.streaming.plan import bytes_of
from nrsfm.streaming.readers import is_mapped, release
from nrsfm.streaming.runners import Runner
from nrsfm.streaming.stored import StoredPoints
from nrsfm.streaming.stream import Stream
from nrsfm.streaming.targets import Target
from nrsfm.tracks import Tracks

LARGE = 20_000_000
"""Entries, frames times points, from which on tracks in memory are read in blocks too."""

_GRAMS = 2 * 2**30  # bytes that the Gram matrices of all cells may take
_FEWEST = 1_000  # points: fewer are no trouble in memory
_ASKED = 20_000  # points of the sample that are asked about outliers
_JUDGED = 2_000  # points of the sample that are asked about perspective
_COPIES = 12  # of tracks that the ordinary path may hold at once
_AT_EASE = 2**30  # bytes of tracks that are read into memory where no limit is set

Answer = tuple[Reconstruction, dict[str, Any], Repaired]


def may_stream(tracks: Tracks, method: Method, settings: Settings) -> bool:
    """Whether these tracks go through in blocks: complete, for a method on the compression, large or asked for.

    Long sequences, whose cells' Gram matrices are themselves large, are worked on as a whole.
    """
    options = settings.pipeline
    if why_whole(tracks, method, settings) is not None:
        return False
    asked = options.memory is not None or options.shapes_file is not None or options.cluster is not None
    return asked or tracks.unchecked or tracks.on_device or tracks.n_frames * tracks.n_points > LARGE


def why_whole(tracks: Tracks, method: Method, settings: Settings) -> str | None:
    """Why these tracks cannot go through in blocks, or ``None`` where they can."""
    frames, points = tracks.n_frames, tracks.n_points
    if not tracks.complete:
        return "the tracks have missing entries"
    if method.needs.every_point:
        return f"method '{method.name}' needs every point"
    if points < max(2 * frames, _FEWEST):
        return f"{points} points of {frames} frames are few"
    if method.cells(settings.method, points, frames) * (2 * frames) ** 2 * 8 > _GRAMS:
        return f"the cells' Gram matrices of {frames} frames are large"
    return None


def require_room(tracks: Tracks, options: PipelineOptions, why: str) -> None:
    """Raise ``InputError`` where tracks that must be in memory need more of it than is allowed."""
    if options.memory is None:
        return
    needed, allowed = _COPIES * tracks.points.nbytes + resident(), bytes_of(options.memory)
    if needed > allowed:
        raise InputError(
            f"memory: {why} are worked on as a whole, which takes about {needed / 1e9:.2g} GB for {tracks.n_frames} "
            f"frames of {tracks.n_points} points, received {options.memory}"
        )


def _fits(tracks: Tracks, options: PipelineOptions) -> bool:
    """Whether the ordinary path may be taken after all."""
    if options.memory is not None:
        return _COPIES * tracks.points.nbytes + resident() <= bytes_of(options.memory)
    points: Any = tracks.points
    return not (isinstance(points, StoredPoints) or is_mapped(points)) or points.nbytes <= _AT_EASE


def reconstruct_streamed(
    tracks: Tracks,
    method: Method,
    known: np.ndarray | None,
    settings: Settings,
    repairing: RepairOptions,
    perspective: PerspectiveOptions,
    stages: Stages,
    by_cells: Callable[[Reconstruction], Reconstruction],
    runner: Runner | None = None,
) -> Answer | None:
    """The reconstruction, the report on perspective and that on repair; ``None`` where the ordinary path is needed.

    ``by_cells``: the resection of noisy tracks, for what is in memory. ``runner``: who works on the points.
    """
    options = settings.pipeline
    room = None if options.memory is None else max((bytes_of(options.memory) - resident()) // 2, 32 * 2**20)
    target = Target(options.shapes_file)
    _require_small_output(target, tracks, options)
    cells = method.cells(settings.method, tracks.n_points, tracks.n_frames)
    stream = OnDevice(tracks.points, cells) if tracks.on_device else Stream(tracks.points, target, room, runner, cells)
    with stages("reading tracks") as monitor:
        measured = stream.measure(settings.seed, monitor, stages.kept)
    indices = np.arange(stream.count) if measured.indices is None else measured.indices
    asked = np.linspace(0, len(indices) - 1, min(_ASKED, len(indices))).astype(np.int64)
    warnings: list[str] = []
    with stages("repair") as monitor:
        looked = repair(
            Tracks(np.ascontiguousarray(measured.points[:, asked])),
            repairing,
            np.random.default_rng([settings.seed, 2]),
            monitor,
        )
    if looked.good is not None:
        if _fits(tracks, options):
            return None
        warnings.append(
            f"{looked.report['outlier_points']} of {len(asked)} points looked at hold outliers, which are not taken "
            "out of tracks that are read in blocks"
        )
    report: dict[str, Any] = {"undone": False, "reason": "off"}
    result = reconstruct_affine(stream, method, known, settings, stages)
    if perspective.perspective != "off":
        with stages("perspective"):
            judged = np.linspace(0, len(indices) - 1, min(_JUDGED, len(indices))).astype(np.int64)
            sample = _Sample(_picked(result.shapes, indices[judged]), result)
            finding = find_perspective(measured.points[:, judged], sample, perspective.intrinsics)
        report = {"undone": False, "strength": finding.strength, "gains": finding.gains, "reason": finding.reason}
        if finding.decided and finding.intrinsics is not None:
            if _fits(tracks, options) and options.shapes_file is None:
                return None
            report["reason"] = "tracks that are read in blocks keep it"
            warnings.append("the tracks show perspective, which is not undone in tracks that are read in blocks")
    if getattr(settings.method, "by_cells", False) and result.diagnostics["noise"] > 0:
        if target.path is None and isinstance(tracks.points, np.ndarray) and not is_mapped(tracks.points):
            result = by_cells(result)
        elif tracks.on_device:
            result = by_cells(result.on_host())
        else:
            warnings.append("noisy tracks that are read in blocks are not resected cell by cell")
    everyone = np.ones(stream.count, dtype=bool)
    outliers = looked.report["outliers"]
    return result, report, Repaired(looked.points, everyone, None, {"missing": 0, "outliers": outliers}, warnings)


class _Sample:
    """Some points of a reconstruction, as much of one as the question about perspective needs."""

    def __init__(self, shapes: np.ndarray, whole: Reconstruction) -> None:
        self.shapes, self.rotations, self.scales = shapes, whole.rotations, whole.scales
        self.translations, self.diagnostics = whole.translations, whole.diagnostics


def _picked(shapes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Some points (F, n, 3), frame by frame: touching all frames of a map at once would hold most of it in memory."""
    if is_on_device(shapes):
        return to_host(namespace(shapes).take(shapes, to_device(points, shapes), axis=1))
    out = np.empty((len(shapes), len(points), 3), dtype=shapes.dtype)
    for f, frame in enumerate(shapes):
        out[f] = frame[points]
        release(shapes)
    return out


def _require_small_output(target: Target, tracks: Tracks, options: PipelineOptions) -> None:
    """Refuse shapes in memory where these alone are more than is allowed."""
    if options.memory is None or not target.in_memory:
        return
    size = np.dtype(options.precision).itemsize
    needed = tracks.n_frames * tracks.n_points * (3 * size + 4) + resident()
    if needed > bytes_of(options.memory):
        raise InputError(
            f"memory: the shapes alone take {needed / 1e9:.2g} GB: name a file for them (shapes_file, .npy, .npz or "
            f".h5), received memory={options.memory}, shapes_file={options.shapes_file}"
        )
