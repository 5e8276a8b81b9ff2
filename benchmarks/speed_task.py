"""The process in which speed is measured: everything in turn, so that a slow moment hits all alike."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.store import data_folder
from nrsfm import datasets, reconstruct

_SVD_SHAPE = (297, 29_299)


def _svd_seconds(matrix: np.ndarray) -> float:
    start = time.perf_counter()
    np.linalg.svd(matrix, full_matrices=False)
    return time.perf_counter() - start


def main() -> None:
    """Read {"jobs": [[sequence, noise], ...], "methods": [...], "rounds": n, "svd": bool}; print the times."""
    settings: dict[str, Any] = json.load(sys.stdin)
    tracks = {
        (name, noise): datasets.load(name, data_folder(), noise=noise, truth=False).tracks.points
        for name, noise in settings["jobs"]
    }
    matrix = np.random.default_rng(0).standard_normal(_SVD_SHAPE)
    warm = next(iter(tracks.values()))[:, :500]
    svd: list[float] = []
    runs: dict[str, dict[str, Any]] = {}
    for method in settings["methods"]:  # loads what is loaded when first used
        reconstruct(warm, method)
    for _ in range(settings["rounds"]):
        if settings["svd"]:
            svd.append(_svd_seconds(matrix))
        for (name, noise), given in tracks.items():
            for method in settings["methods"]:
                start = time.perf_counter()
                result = reconstruct(given, method)
                seconds = time.perf_counter() - start
                run = runs.setdefault(f"{name} {noise:g} {method}", {"seconds": [], "stages": []})
                run["seconds"].append(seconds)
                run["stages"].append(result.diagnostics["seconds"])
                run |= {
                    "cells": result.diagnostics["compression"]["cells"],
                    "virtual_points": result.diagnostics["compression"]["virtual_points"],
                    "iterations": result.diagnostics["iterations"],
                }
                del result
    json.dump({"svd": svd, "runs": runs}, sys.stdout)


if __name__ == "__main__":
    main()
