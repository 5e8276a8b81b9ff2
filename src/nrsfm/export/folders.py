"""A sequence as a folder: one file per frame, and ``about.json`` with what such files cannot say.

Time base, unit, axes, cameras and the numbers of the points that were written are in ``about.json``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nrsfm.export.scene import Scene

ABOUT = "about.json"


def frame_names(frames: int, extension: str) -> list[str]:
    """``frame_0000.ply`` and so on, with as many digits as the last needs, four at least."""
    digits = max(4, len(str(frames - 1)))
    return [f"frame_{frame:0{digits}d}{extension}" for frame in range(frames)]


def write_about(scene: Scene, folder: Path) -> None:
    """Write ``about.json``: ``points.numbers`` is null where all points were written, in their order."""
    about = scene.about()
    about["points"]["numbers"] = scene.kept.tolist() if scene.left_out else None
    about["cameras"] = camera_table(scene)
    text = json.dumps(about, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / ABOUT).write_text(text + "\n", encoding="utf-8")


def camera_table(scene: Scene) -> dict[str, Any]:
    """The cameras as plain lists: world from camera (x right, y up, z backward), and what they see."""
    cameras = scene.cameras
    moving = scene.options.frame == "object"
    positions = cameras.positions if moving else cameras.positions_at(cameras.mean_scale)
    frames = range(scene.n_frames) if moving else [scene.reference]
    width, height = scene.view
    found: dict[str, Any] = {
        "kind": cameras.kind,
        "orientations": [cameras.orientations[f].tolist() for f in frames],
        "positions": [positions[f].tolist() for f in frames],
        "view_size": [width, height],
    }
    if cameras.focal is None:
        scales = cameras.scales if moving else [cameras.mean_scale]
        found["view_size_in_world"] = [[cameras.unit * side / float(s) for side in (width, height)] for s in scales]
    else:
        found["focal"] = list(cameras.focal)
    return found
