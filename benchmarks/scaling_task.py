"""The process in which one size is measured: peak memory of the first run, then seconds of more runs."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.peak import peak_bytes
from nrsfm import reconstruct


def main() -> None:
    """Read {"file": points as .npy, "method": ..., "rounds": n, "options": {}}; print times and peaks."""
    settings: dict[str, Any] = json.load(sys.stdin)
    small = np.random.default_rng(0).standard_normal((12, 60, 2))
    reconstruct(small, settings["method"], **settings["options"])  # loads what is loaded when first used
    baseline = peak_bytes()
    points = np.load(settings["file"])
    seconds, solving = [], []
    peak = 0
    for _ in range(settings["rounds"]):
        start = time.perf_counter()
        result = reconstruct(points, settings["method"], **settings["options"])
        seconds.append(time.perf_counter() - start)
        peak = peak or peak_bytes()
        found = result.diagnostics
        solving.append(found["seconds"][settings["method"]] / found["iterations"])
        del result
    answer = {
        "points": points.shape[1],
        "frames": points.shape[0],
        "dtype": str(points.dtype),
        "input_bytes": points.nbytes,
        "baseline_bytes": baseline,
        "peak_bytes": peak,
        "seconds": seconds,
        "iteration_seconds": solving,
        "iterations": found["iterations"],
        "virtual_points": found["compression"]["virtual_points"],
        "stages": found["seconds"],
    }
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
