"""USD (.usdc binary, .usda text): every frame's points as time samples, and a camera.

``/World/surface`` is a Mesh, or Points without faces, with ``points`` and ``extent`` at every frame; ``displayColor``
(linear light), ``primvars:point`` (numbers in the reconstruction, where some were left out), ``primvars:group`` and
``primvars:confidence`` (at every frame). ``/World/camera`` has its position and turn at every frame and, where the
scales of the image differ, apertures: an orthographic camera's view is 0.1 · aperture units. Time codes are frames
from 0.
The numbers are those of the reconstruction; ``metersPerUnit`` says how large they are.

A still camera's export moves ``/World/surface`` instead, by the same operations.

Source: the schemas UsdGeom and the library usd-core of the Alliance for OpenUSD.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.export.colours import linear
from nrsfm.export.gltf import quaternions
from nrsfm.export.scene import Scene

_TENTHS = 10.0  # apertures and focal length are in tenths of a unit
_FOCAL = 50.0  # of a perspective camera, in those: only its ratio to the apertures counts


def write_usd(scene: Scene, stream: IO[bytes], suffix: str, progress: Callable[[float], None]) -> None:
    """Write the stage into an open file, in the format of ``suffix``: text for ``.usda``, else binary."""
    try:
        from pxr import Sdf, Tf, Usd, UsdGeom
    except ImportError as error:
        raise InputError("format usd needs the library usd-core (the extra 'export')") from error
    layer = Sdf.Layer.CreateAnonymous(suffix if suffix == ".usda" else ".usdc")
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y if scene.options.axes == "y-up" else UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, float(scene.metres or 1.0))
    stage.SetTimeCodesPerSecond(float(scene.options.fps))
    stage.SetFramesPerSecond(float(scene.options.fps))
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(scene.n_frames - 1)
    root = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(root)
    layer.customLayerData = {"nrsfm": _plain(scene.about())}
    surface = _surface(scene, stage, progress)
    camera = _camera(scene, stage)
    if scene.options.frame == "object":
        _move(camera, scene.cameras.positions, scene.cameras.orientations, None)
    else:
        turns, shifts, growth = scene.cameras.still(scene.reference)
        _move(surface, shifts, turns, growth if scene.cameras.grows else None)
        still = slice(scene.reference, scene.reference + 1)
        positions = scene.cameras.positions_at(scene.cameras.mean_scale)
        _move(camera, positions[still], scene.cameras.orientations[still], None)
    # The library takes names only; it gets one that nobody else uses, where there is room for the output.
    with tempfile.TemporaryDirectory(prefix=".nrsfm-", suffix=".tmp", dir=Path(stream.name).parent) as folder:
        aside = Path(folder) / f"stage{suffix}"
        try:
            written = layer.Export(str(aside))
        except Tf.ErrorException as error:
            raise InputError(f"usd: the stage could not be written: {' '.join(str(error).split())[:200]}") from error
        if not written:
            raise InputError("usd: the stage could not be written")
        with aside.open("rb") as source:
            shutil.copyfileobj(source, stream, 1 << 20)


def _surface(scene: Scene, stage: Any, progress: Callable[[float], None]) -> Any:
    from pxr import Sdf, UsdGeom, Vt

    prim: Any
    if scene.faces is None:
        prim = UsdGeom.Points.Define(stage, "/World/surface")
        prim.CreateWidthsAttr(Vt.FloatArray([_width(scene)]))
        prim.SetWidthsInterpolation(UsdGeom.Tokens.constant)
        prim.CreateIdsAttr(Vt.Int64Array.FromNumpy(scene.kept.astype(np.int64)))
    else:
        prim = UsdGeom.Mesh.Define(stage, "/World/surface")
        prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(scene.faces), 3, dtype=np.int32)))
        prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(scene.faces.ravel())))
        prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        prim.CreateDoubleSidedAttr(True)
    variables = UsdGeom.PrimvarsAPI(prim)
    if scene.colours is not None:
        colour = variables.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex)
        colour.Set(Vt.Vec3fArray.FromNumpy(linear(scene.colours)))
    if scene.left_out:
        number = variables.CreatePrimvar("point", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex)
        number.Set(Vt.IntArray.FromNumpy(scene.kept.astype(np.int32)))
    if scene.groups is not None:
        group = variables.CreatePrimvar("group", Sdf.ValueTypeNames.IntArray, UsdGeom.Tokens.vertex)
        group.Set(Vt.IntArray.FromNumpy(scene.groups))
    confidence = None
    if scene.has("confidence"):
        confidence = variables.CreatePrimvar("confidence", Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex)
    points, extent = prim.CreatePointsAttr(), prim.CreateExtentAttr()
    for frame in range(scene.n_frames):
        shape = scene.still_points(frame).astype(np.float32)
        points.Set(Vt.Vec3fArray.FromNumpy(shape), frame)
        extent.Set(Vt.Vec3fArray.FromNumpy(np.stack([shape.min(axis=0), shape.max(axis=0)])), frame)
        if confidence is not None:
            confidence.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(scene.per_frame("confidence", frame))), frame)
        progress(0.9 * (frame + 1) / scene.n_frames)
    return prim


def _width(scene: Scene) -> float:
    """Diameter of drawn points: about their spacing, were they spread over a disc of the object's size."""
    shape = scene.still_points(scene.reference)
    radius = float(np.sqrt(np.mean(np.sum((shape - shape.mean(axis=0)) ** 2, axis=1))))
    return 2.0 * radius / float(np.sqrt(scene.n_points)) or 1.0


def _camera(scene: Scene, stage: Any) -> Any:
    from pxr import Gf, UsdGeom

    cameras = scene.cameras
    prim = UsdGeom.Camera.Define(stage, "/World/camera")
    prim.CreateClippingRangeAttr(Gf.Vec2f(cameras.near, cameras.far))
    left, right, top, bottom = cameras.window
    if cameras.focal is not None:
        fx, fy = cameras.focal
        prim.CreateProjectionAttr(UsdGeom.Tokens.perspective)
        prim.CreateFocalLengthAttr(_FOCAL)
        prim.CreateHorizontalApertureAttr(_FOCAL * (right - left) / fx)
        prim.CreateVerticalApertureAttr(_FOCAL * (bottom - top) / fy)
        x, y = (float(value) for value in cameras.centre)
        prim.CreateHorizontalApertureOffsetAttr(_FOCAL * ((left + right) / 2 - x) / fx)
        prim.CreateVerticalApertureOffsetAttr(_FOCAL * (y - (top + bottom) / 2) / fy)
        return prim
    prim.CreateProjectionAttr(UsdGeom.Tokens.orthographic)
    moving = cameras.grows and scene.options.frame == "object"
    scales = cameras.scales if moving else np.array([cameras.mean_scale])
    across, down = prim.CreateHorizontalApertureAttr(), prim.CreateVerticalApertureAttr()
    for frame, scale in enumerate(scales.tolist()):
        time = (frame,) if moving else ()
        across.Set(_TENTHS * cameras.unit * (right - left) / scale, *time)
        down.Set(_TENTHS * cameras.unit * (bottom - top) / scale, *time)
    return prim


def _move(prim: Any, positions: np.ndarray, turns: np.ndarray, growth: np.ndarray | None) -> None:
    """Position, turn and growth as time samples, or as one value where there is one."""
    from pxr import Gf, UsdGeom

    move = UsdGeom.Xformable(prim)
    translate = move.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
    orient = move.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
    size = None if growth is None else move.AddScaleOp(UsdGeom.XformOp.PrecisionDouble)
    for frame, (position, turn) in enumerate(zip(positions.tolist(), quaternions(turns).tolist(), strict=True)):
        time = (frame,) if len(positions) > 1 else ()
        translate.Set(Gf.Vec3d(*position), *time)
        orient.Set(Gf.Quatd(turn[3], *turn[:3]), *time)
        if size is not None and growth is not None:
            size.Set(Gf.Vec3d(*[float(growth[frame])] * 3), *time)


def _plain(value: Any) -> Any:
    """What USD has words for: dictionaries of numbers and texts, and arrays of numbers."""
    from pxr import Vt

    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return Vt.DoubleArray(value) if isinstance(value, list) else value
