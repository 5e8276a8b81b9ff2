"""The process in which one size is measured: peak memory of the first run, then seconds of more runs."""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm import reconstruct


def _peak_bytes() -> int:
    """Most memory that this process ever held.

    Where the kernel tells, from VmHWM: ru_maxrss also counts what the parent held before this process began.
    """
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass  # not Linux
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def main() -> None:
    """Read {"file": points as .npy, "method": ..., "rounds": n, "options": {}}; print times and peaks."""
    settings: dict[str, Any] = json.load(sys.stdin)
    small = np.random.default_rng(0).standard_normal((12, 60, 2))
    reconstruct(small, settings["method"], **settings["options"])  # loads what is loaded when first used
    baseline = _peak_bytes()
    points = np.load(settings["file"])
    seconds, solving = [], []
    peak = 0
    for _ in range(settings["rounds"]):
        start = time.perf_counter()
        result = reconstruct(points, settings["method"], **settings["options"])
        seconds.append(time.perf_counter() - start)
        peak = peak or _peak_bytes()
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
