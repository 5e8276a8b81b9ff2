"""Animated glTF 2.0 in one file (.glb): blendshapes (:mod:`nrsfm.export.lowrank`), keyframed weights, a camera.

Nodes: ``surface`` with the mesh (triangles, or points), and ``camera``. One animation, linear between keyframes:
the weights of the morph targets; and the camera's position and turn, or, for a still camera, the surface's.

What glTF cannot say, and what is done about it:

- An orthographic camera's size cannot be animated, and the scale of a camera's node is ignored (3.10.2). Where the
  scales s_f of the image differ, the surface's node grows by k_f = s_f / s̄ and the camera keeps s̄: what it sees is the
  same.
- A camera's axis is the middle of its picture. Where perspective was undone with a principal point off the middle,
  the view is widened to be symmetric about it.
- Morph targets carry no normals: programs compute them from the moving surface.

Attributes ``COLOR_0`` (linear light, as the format wants), ``_POINT`` (number in the reconstruction, where some were
left out), ``_GROUP`` and ``_CONFIDENCE`` (mean over the frames); what was cut off is in ``asset.extras``.

Source: glTF 2.0 specification, The Khronos Group, 2021. The container is simple enough to be written here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import IO, Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.export.colours import linear
from nrsfm.export.lowrank import Blend, blendshapes
from nrsfm.export.scene import Scene

_BYTE, _SHORT, _INT, _FLOAT = 5121, 5123, 5125, 5126
_VERTICES, _INDICES = 34962, 34963
_POINTS, _TRIANGLES = 0, 4
_NO_RESTART = 65_535  # the largest index of each type restarts a primitive and names no vertex


def blend_of(scene: Scene) -> tuple[Blend, float]:
    """The blendshapes of a scene, in its world, and the object's size there: the root mean square radius."""
    shapes, kept = scene.result.shapes, scene.kept
    matrix = (scene.unit * scene.world).T

    def coordinates(part: slice) -> np.ndarray:
        low, high = part.start // 3, part.stop // 3
        block = shapes[:, low:high] if scene.left_out == 0 else shapes[:, kept[low:high]]
        return np.asarray((block.astype(np.float64) @ matrix).reshape(len(shapes), -1))

    size = _size(scene)
    options = scene.options
    blend = blendshapes(
        coordinates,
        scene.n_frames,
        3 * scene.n_points,
        tolerance=options.tolerance * size,
        criterion=options.criterion,
        targets=options.targets,
    )
    return blend, size


def _size(scene: Scene) -> float:
    points = scene.still_points(scene.reference)
    points -= points.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(points * points, axis=1)))) or 1.0


def write_glb(scene: Scene, stream: IO[bytes], progress: Callable[[float], None]) -> dict[str, Any]:
    """Write the file; return what was cut off: ``targets``, ``rms``, ``largest``, and both relative to the size."""
    blend, size = blend_of(scene)
    progress(0.7)
    cut = {
        "targets": len(blend.targets),
        "rms": blend.rms / scene.unit,
        "largest": blend.largest / scene.unit,
        "relative_rms": blend.rms / size,
        "relative_largest": blend.largest / size,
    }
    file = _Buffers()
    mesh = _mesh(scene, blend, file)
    nodes, cameras = _nodes(scene)
    tree: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": "nrsfm",
            "extras": {"nrsfm": scene.about() | {"truncation": cut, "grows": _grows(scene)}},
        },
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": nodes,
        "meshes": [mesh],
        "materials": [
            {
                "name": "surface",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9},
            }
        ],
        "cameras": cameras,
        "animations": [_animation(scene, blend, file)],
    }
    tree |= {"accessors": file.accessors, "bufferViews": file.views, "buffers": [{"byteLength": file.length}]}
    _write_container(tree, file, stream)
    return cut


class _Buffers:
    """The one binary buffer, with its views and accessors."""

    def __init__(self) -> None:
        self.parts: list[np.ndarray] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.length = 0

    def add(
        self,
        array: np.ndarray,
        kind: str,
        component: int = _FLOAT,
        *,
        target: int | None = None,
        bounds: bool = False,
        normalised: bool = False,
    ) -> int:
        """Add an array (n,) or (n, c), already of the component's type, and return its accessor's number."""
        array = np.ascontiguousarray(array)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.length, "byteLength": array.nbytes}
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if target is not None:
            view["target"] = target
        if normalised:
            accessor["normalized"] = True
        if bounds:
            accessor["min"] = np.atleast_1d(array.min(axis=0)).tolist()
            accessor["max"] = np.atleast_1d(array.max(axis=0)).tolist()
        self.views.append(view)
        self.accessors.append(accessor)
        self.parts.append(array)
        self.length += array.nbytes
        rest = -self.length % 4
        if rest:
            self.parts.append(np.zeros(rest, dtype=np.uint8))
            self.length += rest
        return len(self.accessors) - 1


def _mesh(scene: Scene, blend: Blend, file: _Buffers) -> dict[str, Any]:
    attributes = {"POSITION": file.add(blend.base.reshape(-1, 3), "VEC3", target=_VERTICES, bounds=True)}
    if scene.colours is not None:
        light = np.ones((scene.n_points, 4), dtype=np.float32)
        light[:, :3] = linear(scene.colours)
        levels = (light * 65535 + 0.5).astype("<u2")
        attributes["COLOR_0"] = file.add(levels, "VEC4", _SHORT, target=_VERTICES, normalised=True)
    own = {
        "_POINT": scene.kept if scene.left_out else None,
        "_GROUP": scene.groups,
        "_CONFIDENCE": None
        if scene.result.confidence is None
        else scene.result.confidence.mean(axis=0, dtype=np.float64)[scene.kept],
    }
    for name, values in own.items():
        if values is not None:  # whole numbers of four bytes are for indices alone
            attributes[name] = file.add(values.astype("<f4"), "SCALAR", target=_VERTICES)
    primitive: dict[str, Any] = {"attributes": attributes, "material": 0, "mode": _POINTS}
    if scene.faces is not None:
        short = scene.n_points <= _NO_RESTART
        indices = scene.faces.astype("<u2" if short else "<u4").ravel()
        primitive |= {
            "mode": _TRIANGLES,
            "indices": file.add(indices, "SCALAR", _SHORT if short else _INT, target=_INDICES, bounds=True),
        }
    mesh: dict[str, Any] = {"name": "surface", "primitives": [primitive]}
    if len(blend.targets):
        primitive["targets"] = [
            {"POSITION": file.add(target.reshape(-1, 3), "VEC3", target=_VERTICES, bounds=True)}
            for target in blend.targets
        ]
        # At rest, and in programs that do not animate, it shows the reference frame.
        mesh["weights"] = blend.weights[scene.reference].tolist()
        mesh["extras"] = {"targetNames": [f"mode {k}" for k in range(1, len(blend.targets) + 1)]}
    return mesh


def _grows(scene: Scene) -> bool:
    """Whether the surface's node grows and shrinks in place of the camera's view."""
    return scene.cameras.grows


def _nodes(scene: Scene) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The nodes as they are in the reference frame, and the camera."""
    cameras, reference = scene.cameras, scene.reference
    position = cameras.positions_at(cameras.mean_scale)[reference]
    surface: dict[str, Any] = {"name": "surface", "mesh": 0}
    if cameras.grows:
        surface["scale"] = [float(cameras.growth[reference])] * 3
    if scene.options.frame == "camera":
        _, shifts, _ = cameras.still(reference)
        surface["translation"] = shifts[reference].tolist()
    node = {"name": "camera", "camera": 0, "translation": position.tolist()}
    across, down = cameras.half_view
    if cameras.focal is None:
        to_world = scene.unit / cameras.mean_scale
        lens = {"xmag": across * to_world, "ymag": down * to_world, "znear": cameras.near, "zfar": cameras.far}
        return [surface, node], [{"name": "camera", "type": "orthographic", "orthographic": lens}]
    fx, fy = cameras.focal
    lens = {
        "yfov": 2 * math.atan(down / fy),
        "aspectRatio": (across / fx) / (down / fy),
        "znear": cameras.near,
        "zfar": cameras.far,
    }
    return [surface, node], [{"name": "camera", "type": "perspective", "perspective": lens}]


def _animation(scene: Scene, blend: Blend, file: _Buffers) -> dict[str, Any]:
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    times = file.add(scene.times.astype("<f4"), "SCALAR", bounds=True)

    def channel(node: int, path: str, values: np.ndarray, kind: str) -> None:
        output = file.add(values.astype("<f4"), kind)
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": times, "interpolation": "LINEAR", "output": output})

    if len(blend.targets):
        channel(0, "weights", blend.weights.reshape(-1), "SCALAR")
    cameras = scene.cameras
    if scene.options.frame == "object":
        channel(1, "translation", cameras.positions_at(cameras.mean_scale), "VEC3")
        channel(1, "rotation", quaternions(cameras.orientations), "VEC4")
    else:
        turns, shifts, _ = cameras.still(scene.reference)
        channel(0, "translation", shifts, "VEC3")
        channel(0, "rotation", quaternions(turns), "VEC4")
    if cameras.grows:
        channel(0, "scale", np.repeat(cameras.growth[:, None], 3, axis=1), "VEC3")
    return {"name": "sequence", "samplers": samplers, "channels": channels}


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions (F, 4) x, y, z, w of (F, 3, 3), each on the side of the one before: the short way between."""
    from scipy.spatial.transform import Rotation

    found = np.asarray(Rotation.from_matrix(rotations).as_quat())
    signs = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(signs)[:, None]
    return found


def _write_container(tree: dict[str, Any], file: _Buffers, stream: IO[bytes]) -> None:
    text = json.dumps(tree, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + file.length
    if total >= 2**32:
        raise InputError(
            f"glb: a file holds up to 4 GiB, and {total / 2**30:.1f} are needed; fewer targets or a larger tolerance, "
            "or usd"
        )
    for number in (0x46546C67, 2, total, len(text), 0x4E4F534A):
        stream.write(number.to_bytes(4, "little"))
    stream.write(text)
    for number in (file.length, 0x004E4942):
        stream.write(number.to_bytes(4, "little"))
    for part in file.parts:
        stream.write(part.data.cast("B") if part.nbytes else b"")
