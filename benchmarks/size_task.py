"""The process in which one reconstruction of any size is measured: peak memory, seconds by stage, references, error."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peak import peak_bytes
from benchmarks.size_data import Size, surface
from benchmarks.size_scores import errors_of
from nrsfm import reconstruct

_SVD_SHAPE = (297, 29_299)
_READ_BYTES = 1 << 24
_PIECE_BYTES = 2e9  # of a float64 W that is multiplied at once


def main() -> None:
    """Read {"size", "file", "mapped", "method", "options", "shapes_file", "rounds", "score"}; print what was measured.

    ``size`` are the fields of a ``Size`` whose tracks ``file`` holds. With ``mapped`` the tracks are a memory map of
    the file, which no round finds in the system's cache; otherwise they are read into memory first, untimed.
    ``shapes_file`` may be null: the shapes stay in memory.
    """
    settings: dict[str, Any] = json.load(sys.stdin)
    file, method, mapped = Path(settings["file"]), settings["method"], settings["mapped"]
    options = dict(settings["options"])
    small = np.random.default_rng(0).standard_normal((12, 60, 2))
    # Loads what is loaded when first used.
    reconstruct(small, method, **{k: v for k, v in options.items() if k != "spatial_cells"})
    if settings["shapes_file"] is not None:
        options["shapes_file"] = settings["shapes_file"]
    answer: dict[str, Any] = {"baseline_bytes": peak_bytes(), "seconds": [], "stages": [], "gram": [], "svd": []}
    matrix = np.random.default_rng(0).standard_normal(_SVD_SHAPE)
    points = None if mapped else np.load(file)
    result = None
    for number in range(settings["rounds"]):
        del result
        if mapped:
            _forget(file)
        start = time.perf_counter()
        result = reconstruct(np.load(file, mmap_mode="r") if points is None else points, method, **options)
        answer["seconds"].append(time.perf_counter() - start)
        if number == 0:
            answer["peak_bytes"] = peak_bytes()
            answer["flush"] = _flush(settings["shapes_file"])
        answer["stages"].append(result.diagnostics["seconds"])
        answer["gram"].append(_gram_seconds(np.load(file, mmap_mode="r")))
        answer["svd"].append(_seconds_of_svd(matrix))
    assert result is not None  # there is at least one round
    answer["read"] = _read_seconds(file)
    found = result.diagnostics
    answer |= {"iterations": found["iterations"], "warnings": found["warnings"]}
    answer |= {name: found["compression"][name] for name in ("virtual_points", "cells")}
    if settings["score"]:
        made = surface(Size(**settings["size"]))
        answer["errors"] = errors_of(result.shapes, made.truth, made.chunks())
    json.dump(answer, sys.stdout)


def _forget(file: Path) -> None:
    """Ask the system to drop a file from its cache, where it can be asked."""
    if not hasattr(os, "posix_fadvise"):
        return
    with file.open("rb") as stream:
        os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _flush(shapes_file: str | None) -> float:
    """Seconds until everything beside the file of shapes is on the disk."""
    if shapes_file is None:
        return 0.0
    start = time.perf_counter()
    for path in Path(shapes_file).parent.iterdir():
        with path.open("rb") as stream:
            os.fsync(stream.fileno())
    return time.perf_counter() - start


def _read_seconds(file: Path) -> float:
    """Seconds to read a file from the disk, once, in order."""
    _forget(file)
    buffer = bytearray(_READ_BYTES)
    start = time.perf_counter()
    with file.open("rb", buffering=0) as stream:
        while stream.readinto(buffer):
            pass
    return time.perf_counter() - start


def _gram_seconds(points: np.ndarray) -> float:
    """Seconds of W @ W.T in float64, W (2F, P) in memory; in pieces where it is large. Making W is not timed."""
    frames, count, _ = points.shape
    length = max(1, int(_PIECE_BYTES / (16 * frames)))
    seconds = 0.0
    for start in range(0, count, length):
        some = points[:, start : start + length]
        matrix = np.empty((frames, 2, some.shape[1]))
        np.copyto(matrix, some.transpose(0, 2, 1))
        matrix = matrix.reshape(2 * frames, -1)
        begin = time.perf_counter()
        _ = matrix @ matrix.T
        seconds += time.perf_counter() - begin
    return seconds


def _seconds_of_svd(matrix: np.ndarray) -> float:
    start = time.perf_counter()
    np.linalg.svd(matrix, full_matrices=False)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
