"""The process in which the literature's reference points are run and timed, one after the other."""

from __future__ import annotations

import json
import logging
import sys
import time
from typing import Any

import numpy as np

from benchmarks.store import data_folder
from nrsfm import datasets, reconstruct
from nrsfm.metrics import camera_frame_error, shape_error


def _one_sign(result: Any, sequence: Any) -> float:
    """e3D of R_f S_f against the truth, nothing aligned but one sign of z for the whole sequence."""
    seen = np.einsum("fij,fpj->fpi", result.rotations, result.shapes.astype(np.float64))
    true = np.einsum("fij,fpj->fpi", sequence.rotations, sequence.shapes)
    return min(shape_error(seen * np.array([1.0, 1.0, sign]), true, "none") for sign in (1.0, -1.0))


def main() -> None:
    """Read {"runs": [[method, sequence, options], ...]}; print error and seconds of each."""
    runs = json.load(sys.stdin)["runs"]
    logging.getLogger("nrsfm").setLevel(logging.ERROR)  # the warnings are not what is measured
    sequences = {name: datasets.load(name, data_folder()) for name in {run[1] for run in runs}}
    for method, name, options in runs:  # loads what is loaded when first used
        reconstruct(sequences[name].tracks.points[:40], method, **options)
    found = []
    for method, name, options in runs:
        sequence = sequences[name]
        start = time.perf_counter()
        result = reconstruct(sequence.tracks, method, **options)
        seconds = time.perf_counter() - start
        found.append(
            {
                "seconds": seconds,
                "one_sign": _one_sign(result, sequence),
                "one_alignment": camera_frame_error(result, sequence.shapes, sequence.rotations),
                "chosen": result.diagnostics["chosen"].get("rank"),
            }
        )
    json.dump(found, sys.stdout, default=float)


if __name__ == "__main__":
    main()
