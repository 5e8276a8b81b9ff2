"""PLY: a folder with one binary file per frame (little endian, floats of 4 bytes).

Vertices have x, y, z, where there are colours red, green, blue (sRGB, 0 to 255), and where the reconstruction knows
them group, confidence (0 to 1, of that frame) and deviation (of the depth). ``point`` is the number of the point in
the reconstruction, there where some were left out. PLY has no axes, unit or time of its own: see ``about.json``.

Source: Turk, "The PLY Polygon File Format", Stanford, 1994.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nrsfm.export.folders import frame_names, write_about
from nrsfm.export.scene import Scene

_WORDS = {"<f4": "float", "u1": "uchar", "<i4": "int"}


def write_ply(scene: Scene, folder: Path, progress: Callable[[float], None]) -> None:
    """Write the sequence into an existing folder."""
    columns: list[tuple[str, str]] = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if scene.colours is not None:
        columns += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    if scene.left_out:
        columns.append(("point", "<i4"))
    if scene.groups is not None:
        columns.append(("group", "<i4"))
    for name, attribute in (("confidence", "confidence"), ("deviation", "depth_deviation")):
        if scene.has(attribute):
            columns.append((name, "<f4"))
    table = np.zeros(scene.n_points, dtype=columns)
    if scene.colours is not None:
        for k, name in enumerate(("red", "green", "blue")):
            table[name] = scene.colours[:, k]
    if scene.left_out:
        table["point"] = scene.kept
    if scene.groups is not None:
        table["group"] = scene.groups
    faces = _face_bytes(scene.faces)
    for frame, name in enumerate(frame_names(scene.n_frames, ".ply")):
        points = scene.points(frame)
        for k, axis in enumerate("xyz"):
            table[axis] = points[:, k]
        for column, attribute in (("confidence", "confidence"), ("deviation", "depth_deviation")):
            if scene.has(attribute):
                table[column] = scene.per_frame(attribute, frame)
        with (folder / name).open("xb") as stream:
            stream.write(_header(scene, columns, frame).encode("ascii"))
            table.tofile(stream)
            stream.write(faces)
        progress((frame + 1) / scene.n_frames)
    write_about(scene, folder)


def _header(scene: Scene, columns: list[tuple[str, str]], frame: int) -> str:
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {frame} of {scene.n_frames}, {scene.options.fps:.9g} frames a second; see about.json",
        f"element vertex {scene.n_points}",
        *(f"property {_WORDS[kind]} {name}" for name, kind in columns),
    ]
    if scene.faces is not None:
        lines += [f"element face {len(scene.faces)}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""])


def _face_bytes(faces: np.ndarray | None) -> bytes:
    if faces is None:
        return b""
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    rows["count"], rows["corners"] = 3, faces
    return rows.tobytes()
