"""Out: a reconstruction as files that other programs open.

:func:`write` is the way in; ``docs/export.md`` says what each format holds and how it looks in Blender.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import InputError, OptionError
from nrsfm.export.colours import SOURCES, image_array, point_colours
from nrsfm.export.options import FORMATS, ExportOptions, find_format
from nrsfm.export.surfaces import find_surface
from nrsfm.files.atomic import atomic_file, atomic_folder
from nrsfm.progress import Report, silent
from nrsfm.reconstruction import Reconstruction

__all__ = ["FORMATS", "SOURCES", "Exported", "write"]

_REPLACEABLE = ("frame_*.ply", "frame_*.obj", "surface.mtl", "about.json")


@dataclasses.dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes
    ----------
    path, format
        Where and what.
    files, size
        How many files, and their bytes together.
    frames, points, left_out, faces
        Numbers of each; ``left_out`` points had no shape. ``faces`` is 0 for points.
    fps
        Frames a second.
    surface
        Where the faces come from, in words.
    unit
        Number of the file per unit of the reconstruction.
    metres
        Metres per number of the file; ``None`` where the format has no unit.
    camera
        ``orthographic`` or ``perspective``.
    view
        (width, height) of the camera's picture, image unit: its shape is that of a rendering.
    truncation
        glb: ``targets``, and ``rms`` and ``largest``, the distances of points from where they were, in the
        reconstruction's unit; ``relative_rms`` and ``relative_largest`` are in root mean square radii of the object.
        ``None`` for formats that keep every frame.
    warnings
        In plain words.
    """

    path: str
    format: str
    files: int
    size: int
    frames: int
    points: int
    left_out: int
    faces: int
    fps: float
    surface: str
    unit: float
    metres: float | None
    camera: str
    view: tuple[float, float]
    truncation: dict[str, Any] | None = None
    warnings: tuple[str, ...] = ()


def write(
    result: Reconstruction,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - the word that callers look for
    faces: Any = None,
    colours: Any = None,
    image: Any = None,
    mask: Any = None,
    fps: float = 25.0,
    frame: str = "object",
    axes: str = "y-up",
    reference: int | None = None,
    scale: float | None = None,
    image_size: tuple[float, float] | None = None,
    tolerance: float = 1e-3,
    criterion: str = "rms",
    targets: int | None = None,
    layout: str = "long",
    overwrite: bool = False,
    progress: Report = silent,
) -> Exported:
    """Write a reconstruction for other programs, whole or not at all.

    Parameters
    ----------
    result
        What to write. Points that were not reconstructed are left out; the numbers of those that were written are
        in the file.
    path
        A file, or for ``ply`` and ``obj`` a folder.
    format
        ``ply``, ``obj``, ``glb``, ``usd``, ``npz`` or ``csv``; may be left out where the extension says it.
    faces
        ``None``: points. (T, 3) or (T, 4) numbers of points; ``"grid:ROWSxCOLS"``; ``"auto"``, triangles between
        neighbours (see :mod:`nrsfm.export.surfaces`); or a file with faces. Quads are written as triangles.
    colours
        ``"image"``, ``"groups"``, ``"confidence"``, ``"depth"``, ``"#rrggbb"``, (P, 3) uint8 sRGB, or ``None``, which
        means the image where one is given.
    image
        Picture of the reference frame: a file, or (H, W, 3) uint8. Whole coordinates are centres of pixels.
    mask
        Picture of the object in the reference frame, not 0 where it is: a file, or (H, W). For ``faces="auto"``.
    fps
        Frames a second, the time base of the animation.
    frame
        ``"object"``: the camera moves around the object. ``"camera"``: the camera of the reference frame stands still,
        the object moves before it, and grows where the image's scale does.
    axes
        ``"y-up"``, ``"z-up"`` or ``"opencv"`` (see :mod:`nrsfm.export.axes`).
    reference
        The frame whose image shows the object upright: its camera looks along the world's axis. 0 if not given; then
        ``faces="auto"`` chooses the frame to triangulate by itself.
    scale
        Numbers of the file per unit of the reconstruction. Metres, for ``glb`` and ``usd``, where by default the
        largest side of the object's box in the reference frame becomes one metre; 1 otherwise.
    image_size
        (width, height), pixels: what the cameras see. By default that of the image or mask, else the box around all
        points and a tenth on each side.
    tolerance, criterion
        ``glb``: as few morph targets as leave less than this of the object's root mean square radius, as
        ``"rms"`` over points and frames or as ``"max"``.
    targets
        ``glb``: this many instead.
    layout
        ``csv``: ``"long"`` (a row per frame and point) or ``"wide"`` (a row per frame).
    overwrite
        Replace an output of that name. A folder that holds anything else is never replaced.
    progress
        Gets ``(stage, fraction)``.

    Raises
    ------
    OptionError, InputError
        An option, the faces, or what the colours need is wrong; one line says what.
    FileError
        A file cannot be read, or the output cannot be written.
    """
    if not isinstance(result, Reconstruction):
        raise InputError(f"result: a Reconstruction is needed, received {type(result).__name__}")
    form = find_format(format, path)
    picture = None if image is None else image_array(image)
    inside = None if mask is None else np.asarray(image_array(mask).any(axis=2))
    if picture is not None and inside is not None and picture.shape[:2] != inside.shape:
        raise InputError(
            f"mask: the image's size is needed, {picture.shape[1]} × {picture.shape[0]}, "
            f"received {inside.shape[1]} × {inside.shape[0]}"
        )
    if image_size is None:
        seen = picture if picture is not None else inside
        image_size = None if seen is None else (seen.shape[1], seen.shape[0])
    options = ExportOptions(
        format=form.name,
        fps=fps,
        frame=frame,
        axes=axes,
        reference=0 if reference is None else reference,
        scale=scale,
        image_size=image_size,
        tolerance=tolerance,
        criterion=criterion,
        targets=targets,
        layout=layout,
    )
    if options.reference >= result.n_frames:
        raise OptionError(
            f"option 'reference' must be a frame from 0 to {result.n_frames - 1}, received {options.reference}"
        )
    if colours is None and picture is not None:
        colours = "image"
    coloured = point_colours(colours, result, options.reference, picture)
    if form.extensions:
        with atomic_file(path, overwrite=overwrite) as stream:
            return _written(result, options, faces, reference, inside, coloured, path, stream, progress)
    with atomic_folder(path, overwrite=overwrite, replaceable=_REPLACEABLE) as folder:
        return _written(result, options, faces, reference, inside, coloured, path, folder, progress)


def _written(
    result: Reconstruction,
    options: ExportOptions,
    faces: Any,
    reference: int | None,
    mask: np.ndarray | None,
    colours: np.ndarray | None,
    path: str | os.PathLike[str],
    target: Any,
    report: Report,
) -> Exported:
    """Write into an open file, or into an existing folder."""
    from nrsfm.export.scene import make_scene

    report("surface", None)
    surface = find_surface(faces, result, reference=reference, mask=mask)
    scene = make_scene(result, options, surface, colours)
    progress: Callable[[float], None] = lambda fraction: report("writing", fraction)  # noqa: E731
    cut = None
    if options.format == "ply":
        from nrsfm.export.ply import write_ply

        write_ply(scene, target, progress)
    elif options.format == "obj":
        from nrsfm.export.obj import write_obj

        write_obj(scene, target, progress)
    elif options.format == "glb":
        from nrsfm.export.gltf import write_glb

        cut = write_glb(scene, target, progress)
    elif options.format == "usd":
        from nrsfm.export.usd import write_usd

        write_usd(scene, target, Path(path).suffix.lower(), progress)
    else:
        from nrsfm.export import tables

        (tables.write_npz if options.format == "npz" else tables.write_csv)(scene, target, progress)
    files = sorted(target.iterdir()) if isinstance(target, Path) else [Path(target.name)]
    if not isinstance(target, Path):
        target.flush()
    return Exported(
        path=os.fspath(path),
        format=options.format,
        files=len(files),
        size=sum(file.stat().st_size for file in files),
        frames=scene.n_frames,
        points=scene.n_points,
        left_out=scene.left_out,
        faces=0 if scene.faces is None else len(scene.faces),
        fps=float(options.fps),
        surface=scene.surface,
        unit=scene.unit,
        metres=scene.metres,
        camera=scene.cameras.kind,
        view=scene.view,
        truncation=cut,
        warnings=scene.warnings,
    )
