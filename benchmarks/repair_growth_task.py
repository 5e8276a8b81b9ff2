"""The process in which one size of damaged tracks is timed."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.store import data_folder
from benchmarks.tracks import Data, damaged
from nrsfm import datasets, reconstruct

_STAGES = ("repair", "resection")


def main() -> None:
    """Read {"sequence", "points", "noise", "damage", "method", "rounds"}; print the seconds of stages, by round."""
    settings: dict[str, Any] = json.load(sys.stdin)
    name, points, noise = settings["sequence"], settings["points"], settings["noise"]
    whole = datasets.load(name, data_folder(), points=points, noise=noise)
    tracks, _ = damaged(whole, whole, None, Data(name, noise, damage=settings["damage"]))
    reconstruct(np.random.default_rng(0).standard_normal((12, 60, 2)), settings["method"])  # loads what it needs
    rounds = []
    for _ in range(settings["rounds"]):
        start = time.perf_counter()
        result = reconstruct(tracks, settings["method"])
        seconds = result.diagnostics["seconds"]
        rounds.append({"whole": time.perf_counter() - start} | {name: seconds.get(name, 0.0) for name in _STAGES})
        del result
    json.dump({"points": tracks.n_points, "frames": tracks.n_frames, "rounds": rounds}, sys.stdout)


if __name__ == "__main__":
    main()
