"""Numbers for one's own programs: a table as text (``.csv``), or arrays by name (``.npz``).

``.npz`` holds ``points`` (F, N, 3) and ``numbers`` (N,) of the points that were written, ``times`` (F,) in seconds,
the cameras, ``camera_orientations`` (F, 3, 3) world from camera with x right, y up, z backward, ``camera_positions``
(F, 3), ``view_size`` (F, 2) in the world's unit (or ``focal`` and ``view_size`` in pixels), and where there are such
``faces``, ``colours``, ``groups``, ``confidence``, ``depth_deviation``; ``about`` is a JSON text. The camera of a still
camera's export is the same in every frame.

``.csv``, long: a header ``frame,time,point,x,y,z`` (and ``group``, ``confidence``, ``depth_deviation``) and one row
per frame and point. Wide: a header and one row per frame, ``frame,time,x0,y0,z0,x1,…``, the numbers being those of
the points in the reconstruction. Numbers have all digits of their type.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import IO, Any

import numpy as np

from nrsfm.export.scene import Scene


def write_npz(scene: Scene, stream: IO[bytes], progress: Callable[[float], None]) -> None:
    """Write the arrays."""
    kind = scene.result.shapes.dtype
    points = np.empty((scene.n_frames, scene.n_points, 3), dtype=kind)
    for frame, shape in enumerate(scene.sequence()):
        points[frame] = shape
        progress((frame + 1) / scene.n_frames)
    arrays: dict[str, Any] = {"points": points, "numbers": scene.kept, "times": scene.times, **_cameras(scene)}
    if scene.faces is not None:
        arrays["faces"] = scene.faces
    if scene.colours is not None:
        arrays["colours"] = scene.colours
    if scene.groups is not None:
        arrays["groups"] = scene.groups
    for name in ("confidence", "depth_deviation"):
        if scene.has(name):
            arrays[name] = np.stack([scene.per_frame(name, frame) for frame in range(scene.n_frames)])
    np.savez(stream, about=np.array(json.dumps(scene.about())), **arrays)


def _cameras(scene: Scene) -> dict[str, np.ndarray]:
    cameras = scene.cameras
    moving = scene.options.frame == "object"
    frames = np.arange(scene.n_frames) if moving else np.full(scene.n_frames, scene.reference)
    positions = cameras.positions if moving else cameras.positions_at(cameras.mean_scale)
    size = np.array(scene.view)
    found = {"camera_orientations": cameras.orientations[frames], "camera_positions": positions[frames]}
    if cameras.focal is not None:
        return found | {"focal": np.array(cameras.focal), "view_size": np.tile(size, (len(frames), 1))}
    scales = cameras.scales if moving else np.full(len(frames), cameras.mean_scale)
    return found | {"view_size": cameras.unit * size / scales[:, None]}


def write_csv(scene: Scene, stream: IO[bytes], progress: Callable[[float], None]) -> None:
    """Write the table in the layout of the options."""
    number = "%.9g" if scene.result.shapes.dtype == np.float32 else "%.17g"
    (_write_wide if scene.options.layout == "wide" else _write_long)(scene, stream, number, progress)


def _write_long(scene: Scene, stream: IO[bytes], number: str, progress: Callable[[float], None]) -> None:
    names = [name for name in ("confidence", "depth_deviation") if scene.has(name)]
    groups = scene.groups
    header = ["frame", "time", "point", "x", "y", "z", *(["group"] if groups is not None else []), *names]
    stream.write((",".join(header) + "\n").encode("ascii"))
    # One template for all rows of a frame, with what never changes in it: the fastest way in plain Python.
    labels = [""] * scene.n_points if groups is None else [f",{label}" for label in groups.tolist()]
    ends = ",%.9g" * len(names)
    rows = [
        f"\0,{point},{number},{number},{number}{label}{ends}\n"
        for point, label in zip(scene.kept.tolist(), labels, strict=True)
    ]
    template = "".join(rows)
    for frame, time in enumerate(scene.times.tolist()):
        columns = [scene.points(frame).astype(scene.result.shapes.dtype).astype(np.float64)]
        columns += [scene.per_frame(name, frame).astype(np.float64)[:, None] for name in names]
        text = template.replace("\0", f"{frame},{time:.9g}") % tuple(np.hstack(columns).ravel().tolist())
        stream.write(text.encode("ascii"))
        progress((frame + 1) / scene.n_frames)


def _write_wide(scene: Scene, stream: IO[bytes], number: str, progress: Callable[[float], None]) -> None:
    names = [f"{axis}{point}" for point in scene.kept.tolist() for axis in "xyz"]
    stream.write((",".join(["frame", "time", *names]) + "\n").encode("ascii"))
    template = f",{number}" * (3 * scene.n_points)
    for frame, time in enumerate(scene.times.tolist()):
        numbers = scene.points(frame).astype(scene.result.shapes.dtype).ravel().tolist()
        stream.write((f"{frame},{time:.9g}" + template % tuple(numbers) + "\n").encode("ascii"))
        progress((frame + 1) / scene.n_frames)
