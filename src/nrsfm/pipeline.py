"""The one path from tracks to a reconstruction.

tracks → repair → affine reconstruction (:mod:`nrsfm.affine`) → perspective undone, where there is evidence of it, and
reconstructed again → reconstruction of all points.
"""

from __future__ import annotations

import functools
import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from nrsfm.affine import PipelineOptions, Settings, Stages, reconstruct_affine
from nrsfm.cameras import CameraOptions, cameras_from_known
from nrsfm.checkpoints import checkpoint, content_of
from nrsfm.devices import is_on_device, to_device
from nrsfm.errors import InputError
from nrsfm.gauge import GaugeOptions
from nrsfm.methods import get_method
from nrsfm.methods.base import Method
from nrsfm.numerics.threads import single_thread
from nrsfm.options import split_options
from nrsfm.perspective import PerspectiveOptions, with_perspective
from nrsfm.progress import Report, TerminalProgress, silent
from nrsfm.reconstruction import Reconstruction
from nrsfm.repair import Repaired, RepairOptions, Resection, repair, resect, resect_by_cells, trusted_points
from nrsfm.streamed import may_stream, reconstruct_streamed, require_room, why_whole
from nrsfm.streaming.cluster import runner_of
from nrsfm.streaming.connecting import addressed
from nrsfm.streaming.targets import Target
from nrsfm.tracks import Tracks
from nrsfm.uncertainty import UncertaintyOptions

logger = logging.getLogger(__name__)

_PLAIN = "geometry-aware"  # bends least of perspective into the shapes
_EXACT_ROUNDS, _NOISY_ROUNDS = 2, 3  # of reconstruction and resection where tracks have holes
_ELSEWHERE = {"checkpoint", "cluster", "shapes_file"}  # options that say where the work is done or goes
_SECOND_OPINION = 1_000_000  # entries up to which it is asked first whether there is perspective

STAGE_OPTIONS: dict[str, type] = {
    "run": PipelineOptions,
    "repair": RepairOptions,
    "cameras": CameraOptions,
    "perspective": PerspectiveOptions,
    "object frame": GaugeOptions,
    "uncertainty": UncertaintyOptions,
}
"""The options that every method shares, one class per stage."""


@dataclass(frozen=True)
class _Run:
    """One checked request."""

    method: Method
    known: np.ndarray | None
    settings: Settings
    repair: RepairOptions
    perspective: PerspectiveOptions


def reconstruct(
    tracks: Tracks | np.ndarray,
    method: str = "auto",
    rotations: np.ndarray | None = None,
    seed: int = 0,
    progress: bool | Report = False,
    **options: Any,
) -> Reconstruction:
    """Recover the 3D shape of every frame from 2D point tracks.

    Parameters
    ----------
    tracks
        ``Tracks``, or an array of points (F, P, 2), also of PyTorch or CuPy: at least 3 frames and 4 points, any
        pattern of missing entries that ties the frames together.
    method
        One of ``nrsfm.method_names()``.
    rotations
        Known cameras (F, 3, 3) or (F, 2, 3), camera from object; estimated when not given.
    seed
        Seeds every random choice: same input, options, seed and thread count give the same output.
    progress
        ``True`` draws a line on a terminal's stderr; a function is called as ``progress(stage, fraction)``.
    **options
        Options of the stages (``PipelineOptions``, ``RepairOptions``, ``CameraOptions``, ``PerspectiveOptions``,
        ``GaugeOptions``, ``UncertaintyOptions``) and of the method (``nrsfm methods``).

    Returns
    -------
    Reconstruction
        ``points[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T + translations[f]``, in the tracks' unit. Points
        seen in too few frames have NaN for shapes.

    Raises
    ------
    InputError
        Tracks, rotations or options break a rule; the message names it and the value received.
    """
    tracks = tracks if isinstance(tracks, Tracks) else Tracks(tracks)
    tracks.require_reconstructible()
    if "cluster" in options:
        options["cluster"] = addressed(options["cluster"])
    solver = get_method(method)
    pipeline, repairing, camera, perspective, gauge, uncertainty, own = split_options(
        (*STAGE_OPTIONS.values(), solver.Options), options, f"method '{method}'"
    )
    _require(solver, tracks, pipeline)
    if tracks.on_device:
        _require_here(pipeline)
    camera = _camera_options(camera, solver, own, ordered=pipeline.ordered)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number, at least 0, received {seed!r}")
    known = None if rotations is None else cameras_from_known(rotations, tracks.n_frames)
    if known is not None and perspective.intrinsics is None:
        perspective = replace(perspective, perspective="off")  # given cameras are orthographic unless K says otherwise
    settings = Settings(pipeline, camera, gauge, uncertainty, own, int(seed))
    run = _Run(solver, known, settings, repairing, perspective)
    if progress is True:
        with TerminalProgress() as line:
            return _reconstruct(tracks, run, line)
    if not callable(progress) and progress is not False:
        raise InputError(f"progress must be true, false or a function of (stage, fraction), received {progress!r}")
    return _reconstruct(tracks, run, progress if callable(progress) else silent)


def _reconstruct(tracks: Tracks, run: _Run, report: Report) -> Reconstruction:
    with checkpoint(run.settings.pipeline.checkpoint, lambda: _identity(tracks, run)) as kept:
        result = _reconstruct_in_stages(tracks, run, Stages(report, kept))
    if kept.taken:
        result.diagnostics["taken_from_checkpoint"] = kept.taken
    return result


def _reconstruct_in_stages(tracks: Tracks, run: _Run, stages: Stages) -> Reconstruction:
    settings = run.settings
    answer = None
    if may_stream(tracks, run.method, settings):

        def by_cells(result: Reconstruction) -> Reconstruction:
            return _by_cells(tracks.in_memory().points, result, settings.seed, stages)

        with runner_of(settings.pipeline.cluster) as runner:
            answer = reconstruct_streamed(
                tracks, run.method, run.known, settings, run.repair, run.perspective, stages, by_cells, runner
            )
    result, perspective, repaired = _in_memory(tracks, run, stages) if answer is None else answer
    warnings = [*repaired.warnings, *result.diagnostics["warnings"]]
    if answer is None and settings.pipeline.cluster is not None:
        why = why_whole(tracks, run.method, settings) or "the tracks hold outliers or show perspective"
        warnings.append(f"cluster: {why}: this was worked on as a whole, by this process alone")
    if answer is None and tracks.on_device:
        why = why_whole(tracks, run.method, settings) or "the tracks hold outliers or show perspective"
        warnings.append(f"device: {why}: this was worked on by the host")
    evidence = perspective.get("mirror") or {}
    mirror = dict(result.diagnostics["cameras"].get("mirror") or {})
    if evidence.get("decided"):
        mirror = {"rule": evidence["by"], "decided": True, "strength": evidence["strength"]}
        warnings = [text for text in warnings if not text.startswith("which of the two mirror images")]
        if settings.camera.mirror and run.known is None:
            result = result.mirrored()
    for text in warnings:
        logger.warning(text)
    diagnostics = result.diagnostics | {
        "seconds": stages.seconds,
        "repair": repaired.report,
        "perspective": perspective,
        "warnings": warnings,
    }
    if mirror:
        diagnostics["mirror"] = mirror
    options = _all_options(run) | result.options
    for own, new in ((result.diagnostics, diagnostics), (result.options, options)):
        own.clear()  # in place: a new reconstruction would look through all shapes again
        own.update(new)
    result = _of_all_points(result, repaired)
    if answer is None and settings.pipeline.shapes_file is not None:
        return _to_file(result, settings.pipeline.shapes_file)
    return _back_to_device(result, tracks.points) if tracks.on_device else result


def _in_memory(tracks: Tracks, run: _Run, stages: Stages) -> tuple[Reconstruction, dict[str, Any], Repaired]:
    """Tracks that are looked at as a whole: repaired where they need it."""
    settings = run.settings
    require_room(tracks, settings.pipeline, f"tracks with gaps or outliers, and those of method '{run.method.name}',")
    tracks = tracks.in_memory()
    with stages("repair") as monitor:
        rng = np.random.default_rng([settings.seed, 2])
        work = functools.partial(repair, tracks, run.repair, rng, monitor)
        repaired = stages.kept("repair", work, held=(tracks.points, tracks.visible))
    if repaired.good is not None and not run.method.needs.every_point:
        return _with_holes(tracks, repaired, run, stages)
    points = _columns(repaired.points, repaired.kept)
    result, perspective = _seen_by_cameras(points, tracks.visible, run, stages)
    if getattr(settings.method, "by_cells", False) and not perspective["undone"]:
        result = _by_cells(points, result, settings.seed, stages)
    return result, perspective, repaired


def _back_to_device(result: Reconstruction, points: Any) -> Reconstruction:
    """The reconstruction with its shapes, and their deviations, where the points are."""
    if is_on_device(result.shapes):
        return result
    deviation = None if result.depth_deviation is None else to_device(result.depth_deviation, points)
    return replace(result, shapes=to_device(result.shapes, points), depth_deviation=deviation)


def _to_file(result: Reconstruction, path: str) -> Reconstruction:
    """The reconstruction with its shapes, and their deviations, in a file."""
    arrays = {"shapes": result.shapes}
    if result.depth_deviation is not None:
        arrays["depth_deviation"] = result.depth_deviation
    with Target(path) as target:
        writers = target.make({name: (array.shape, array.dtype) for name, array in arrays.items()})
        for name, array in arrays.items():
            writers[name].write(0, array)
        written = target.finish()
    return replace(result, shapes=written["shapes"], depth_deviation=written.get("depth_deviation"))


def _seen_by_cameras(
    points: np.ndarray, visible: np.ndarray | None, run: _Run, stages: Stages
) -> tuple[Reconstruction, dict[str, Any]]:
    """Complete points (F, P, 2), perspective undone where there is evidence of it; and the report of that."""
    settings = run.settings

    def solve(affine: np.ndarray) -> Reconstruction:
        return reconstruct_affine(affine, run.method, run.known, settings, stages)

    def plain() -> Reconstruction:
        method = get_method(_PLAIN)
        own = method.Options()
        camera = _camera_options(settings.camera, method, own, ordered=settings.pipeline.ordered)
        return reconstruct_affine(points, method, run.known, replace(settings, camera=camera, method=own), stages)

    second = plain if run.method.name == "auto" and points.shape[0] * points.shape[1] <= _SECOND_OPINION else None
    first = solve(points)
    with stages("perspective"):
        # The mean with the perspective model's shapes would come with its cameras: given ones stay as they are.
        final = "average" if run.known is None else "solve"
        return with_perspective(
            points, solve, run.perspective, visible=visible, first=first, second=second, final=final
        )


def _by_cells(points: np.ndarray, result: Reconstruction, seed: int, stages: Stages) -> Reconstruction:
    """Complete points (F, P, 2) resected cell by cell where there is noise: the last word is the tracks' own."""
    noise = result.diagnostics["noise"]
    if noise <= 0.0:
        return result
    rng, seen = np.random.default_rng([seed, 3]), np.ones(points.shape[:2], dtype=bool)
    with stages("resection") as advance, single_thread():
        work = functools.partial(resect_by_cells, result, result.shapes, points, seen, noise, rng, advance)
        return _as_resected(result, stages.kept("resection", work))


def _with_holes(
    tracks: Tracks, repaired: Repaired, run: _Run, stages: Stages
) -> tuple[Reconstruction, dict[str, Any], Repaired]:
    """Trusted points first; the others by resection from where they were seen, which also finds what was overlooked.

    Of exact tracks, resection is the answer: the least error in a few completed tracks would spoil the rest. Noisy ones
    are completed by what resection predicts and go through again together, twice: many noisy points are worth more than
    few. What comes out is resected, cell by cell: what was filled in had no noise and little truth. Resection is
    affine: where perspective is undone, completed tracks are taken as they are.
    """
    kept, good = repaired.kept, _given(repaired.good)
    trusted = trusted_points(repaired, len(good))
    points, overlooked = repaired.points, np.zeros_like(good)
    measured, seen = _columns(tracks.points, kept), good[:, kept]
    rng = np.random.default_rng([run.settings.seed, 3])
    told = run.settings.pipeline.noise_level is not None
    rounds = _NOISY_ROUNDS if repaired.noisy else _EXACT_ROUNDS
    for _ in range(rounds):
        result, perspective = _seen_by_cameras(_columns(points, trusted), good[:, trusted], run, stages)
        if perspective["undone"]:
            if not np.array_equal(trusted, kept):
                result, perspective = _seen_by_cameras(_columns(points, kept), good[:, kept], run, stages)
            return result, perspective, repaired
        noise = result.diagnostics["noise"]
        shapes = None if trusted is not kept else result.shapes
        with stages("resection") as advance, single_thread():
            about = (result, shapes, measured, seen, noise, repaired.noisy, rng, advance)
            found = stages.kept("resection", functools.partial(_resected, *about), rng=rng)
            if repaired.noisy and not told:  # what is filled in has no noise, what is wrong had much
                run = _told(run, found.noise)
        overlooked[:, kept] = found.wrong
        clean = trusted & ~overlooked.any(axis=0)
        if repaired.noisy:
            points, trusted = _predicted(points, result, found.shapes, overlooked | ~good, kept), kept
        elif np.array_equal(clean, trusted) or clean.sum() < max(4, trusted.sum() // 2):
            break
        else:
            trusted = clean
    result = _as_resected(result, found) if repaired.noisy else _joined(result, found, trusted[kept])
    number = int(np.count_nonzero(overlooked))
    report = repaired.report | {"outliers": repaired.report["outliers"] + number, "overlooked_at_first": number}
    confidence = np.where(overlooked, np.float32(0), _given(repaired.confidence))
    return result, perspective, replace(repaired, confidence=confidence, report=report)


def _resected(
    result: Reconstruction,
    shapes: np.ndarray | None,
    points: np.ndarray,
    seen: np.ndarray,
    noise: float,
    noisy: bool,
    rng: np.random.Generator,
    advance: Callable[[float], None],
) -> Resection:
    """Every point from where it was seen; noisy ones cell by cell. ``shapes``: of all points, where they are known."""
    if shapes is None:
        found = resect(result, points, seen, noise, advance)
        if not noisy:
            return found
        shapes = found.shapes
    return resect_by_cells(result, shapes, points, seen, noise, rng, advance)


def _told(run: _Run, noise: float) -> _Run:
    """The run with the noise level known."""
    pipeline = replace(run.settings.pipeline, noise_level=noise)
    return replace(run, settings=replace(run.settings, pipeline=pipeline))


def _predicted(
    points: np.ndarray, result: Reconstruction, shapes: np.ndarray, wrong: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """Points (F, P, 2) with the wrong entries put where the shapes (F, n, 3) of the kept points are seen."""
    out = np.array(points)
    for f in np.flatnonzero(wrong.any(axis=1)):
        seen = result.scales[f] * (shapes[f] @ result.rotations[f, :2].T) + result.translations[f]
        row = out[f, kept]
        out[f, kept] = np.where(wrong[f, kept, None], seen, row)
    return out


def _as_resected(result: Reconstruction, found: Resection) -> Reconstruction:
    """Every point by resection, what missing entries cost added to the deviations."""
    deviation = result.depth_deviation
    if deviation is not None:
        deviation = np.hypot(deviation, found.deviation)
    return replace(result, shapes=found.shapes, depth_deviation=deviation)


def _joined(result: Reconstruction, found: Resection, trusted: np.ndarray) -> Reconstruction:
    """All points: the trusted ones as they are, the others by resection."""
    shapes, deviation = found.shapes, None
    shapes[:, trusted] = result.shapes
    if result.depth_deviation is not None:
        deviation = found.deviation
        deviation[:, trusted] = result.depth_deviation
    groups = result.groups if result.groups is None else _nearest(result.groups, result.shapes, shapes)
    return replace(result, shapes=shapes, depth_deviation=deviation, groups=groups)


def _given(array: np.ndarray | None) -> np.ndarray:
    """An array that is there whenever tracks had holes."""
    assert array is not None  # noqa: S101 - of our own making, not a user's
    return array


def _columns(points: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Some of the points; the array itself where these are all."""
    return points if which.all() else np.ascontiguousarray(points[:, which])


def _nearest(groups: np.ndarray, shapes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Group of the point that is nearest in the mean shape."""
    from scipy.spatial import cKDTree

    tree = cKDTree(shapes.mean(axis=0, dtype=np.float64))
    return np.asarray(groups[tree.query(others.mean(axis=0, dtype=np.float64))[1]])


def _of_all_points(result: Reconstruction, repaired: Repaired) -> Reconstruction:
    """The reconstruction with a place for every point that came in: NaN where it was seen too rarely."""
    confidence = repaired.confidence
    if repaired.kept.all():
        return result if confidence is None else replace(result, confidence=confidence)
    frames, points = len(result.shapes), len(repaired.kept)

    def spread(array: np.ndarray) -> np.ndarray:
        out = np.full((frames, points, *array.shape[2:]), np.nan, dtype=array.dtype)
        out[:, repaired.kept] = array
        return out

    groups = result.groups
    if groups is not None:
        groups = np.full(points, -1, dtype=groups.dtype)
        groups[repaired.kept] = result.groups
    if confidence is not None:
        confidence = confidence * repaired.kept.astype(np.float32)
    return replace(
        result,
        shapes=spread(result.shapes),
        groups=groups,
        confidence=confidence,
        depth_deviation=None if result.depth_deviation is None else spread(result.depth_deviation),
    )


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


def _require_here(options: PipelineOptions) -> None:
    """Refuse options that are for files and memory of the host, where tracks are on a device."""
    for name in ("memory", "shapes_file", "cluster"):
        value = getattr(options, name)
        if value is not None:
            raise InputError(f"{name}: tracks on a device are worked on there, received {name}={value}")


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


def _all_options(run: _Run) -> dict[str, Any]:
    """Seed and options of every stage as plain values."""
    settings = run.settings
    recorded: dict[str, Any] = {"seed": settings.seed}
    stages = (settings.pipeline, run.repair, settings.camera, run.perspective, settings.gauge, settings.uncertainty)
    for options in (*stages, settings.method):
        recorded |= _recorded(options)
    recorded["cluster"] = None if settings.pipeline.cluster is None else str(settings.pipeline.cluster)
    return recorded


def _identity(tracks: Tracks, run: _Run) -> dict[str, Any]:
    """What a checkpoint must be of: version, method, tracks, cameras, and the options that the result depends on."""
    from nrsfm import __version__

    digests = {
        name: None if array is None else hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:16]
        for name, array in (("cameras", run.known), ("visible", None if tracks.complete else tracks.visible))
    }
    points = tracks.in_memory().points if tracks.on_device else tracks.points
    options = {f"option {name}": value for name, value in _all_options(run).items() if name not in _ELSEWHERE}
    return {"version": __version__, "method": run.method.name, "tracks": content_of(points)} | digests | options


def _recorded(options: Any) -> dict[str, Any]:
    """Options as plain values; an array is named by its shape and digest."""
    return {
        name: f"array {value.shape} sha256 {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]}"
        if isinstance(value, np.ndarray)
        else value
        for name, value in ((field.name, getattr(options, field.name)) for field in fields(options))
    }
