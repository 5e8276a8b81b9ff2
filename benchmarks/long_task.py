"""The process in which one sequence of thousands of frames is measured: seconds, peak memory, error, what was cut."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.peak import peak_bytes
from benchmarks.store import data_folder
from nrsfm import datasets, reconstruct, shape_error
from nrsfm.manifolds.rotations import from_vectors

TAKE, FRAMES, POINTS = "ict-take3", 4030, 6706
PIECE, PIECES = 99, 10
_PERIOD = 345.0  # frames: the turn of the shorter takes
_ROLL, _PITCH, _YAW = 6.0, 18.0, 45.0  # degrees


def cameras(frames: int) -> np.ndarray:
    """A head that turns to and fro, tilts and nods, (F, 3, 3)."""
    t = 2 * np.pi * np.arange(frames) / _PERIOD
    roll, pitch = _ROLL * np.sin(1.7 * t + 1.0), _PITCH * np.sin(4.3 * t + 0.4)
    yaw = _YAW * np.sin(3.0 * t)
    axes = np.eye(3)
    z, x, y = (from_vectors(np.deg2rad(a)[:, None] * axes[i]) for i, a in ((2, roll), (0, pitch), (1, yaw)))
    return np.asarray(z @ x @ y)


def main() -> None:
    """Read {"frames", "noise", "method"}; print what was measured. Frames 0: pieces of 99 frames, one by one."""
    settings: dict[str, Any] = json.load(sys.stdin)
    take = datasets.load(TAKE, data_folder(), rotations=cameras(FRAMES), noise=settings["noise"], dtype="float32")
    points, truth = take.tracks.points, take.shapes
    frames = settings["frames"]
    starts = [0] if frames else np.linspace(0, FRAMES - PIECE, PIECES).astype(int).tolist()
    length = frames or PIECE
    loaded = peak_bytes()
    rows = []
    for start in starts:
        part = slice(start, start + length)
        begin = time.perf_counter()
        result = reconstruct(points[part], settings["method"])
        seconds = time.perf_counter() - begin
        row = {"start": start, "seconds": seconds, "peak_bytes": peak_bytes(), "loaded_bytes": loaded}
        row |= {align: shape_error(result.shapes, truth[part], align=align) for align in ("per-frame", "global")}
        found = result.diagnostics
        row |= {"stages": found["seconds"], "discarded": found["compression"]["discarded"]}
        row |= {name: found["chosen"].get(name) for name in ("directions", "cut", "key_frames")}
        rows.append(row | {"virtual_points": found["compression"]["virtual_points"]})
    json.dump({"rows": rows}, sys.stdout)


if __name__ == "__main__":
    main()
