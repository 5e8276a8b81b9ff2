"""The scores of a reconstruction against the truth, as one dictionary and as lines to read."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.errors import InputError

if TYPE_CHECKING:
    from nrsfm.reconstruction import Reconstruction

FRAMES_OF_TRUTH = ("object", "camera")


@dataclasses.dataclass(frozen=True)
class Truth:
    """What is known of the sequence: shapes (F, P, 3), which points count (F, P), cameras (F, 3, 3).

    ``frame`` says whether the shapes are in the object's frame or already in the camera's of each frame.
    """

    shapes: np.ndarray
    valid: np.ndarray | None = None
    rotations: np.ndarray | None = None
    frame: str = "object"

    def require_size(self, frames: int, points: int, name: str) -> None:
        """Raise ``InputError`` unless the truth has this many frames and points."""
        if self.shapes.shape[:2] != (frames, points):
            received = "{} frames of {} points".format(*self.shapes.shape[:2])
            raise InputError(f"truth: {name} has {frames} frames of {points} points, the truth has {received}")


def scores(result: Reconstruction, truth: Truth) -> dict[str, Any]:
    """Return every score that the truth allows; those that it does not allow are ``None``."""
    from nrsfm.metrics import ALIGNMENTS, depth_calibration, mocap_error, rotation_error, shape_error

    truth.require_size(result.n_frames, result.n_points, "the reconstruction")
    seen, cameras = result, truth.rotations
    if truth.frame == "camera":
        still = np.tile(np.eye(3), (result.n_frames, 1, 1))
        seen, cameras = dataclasses.replace(result, shapes=result.camera_shapes(), rotations=still), still
    counted = result.reconstructed if truth.valid is None else truth.valid & result.reconstructed
    entries = int(np.count_nonzero(counted)) * (result.n_frames if truth.valid is None else 1)
    return {
        "frames": result.n_frames,
        "points": result.n_points,
        "scored_points": int(np.count_nonzero(counted if truth.valid is None else counted.any(axis=0))),
        "scored_entries": entries,
        "truth_frame": truth.frame,
        "shape_error": {name: shape_error(seen, truth.shapes, name, valid=truth.valid) for name in ALIGNMENTS},
        # The mocap literature defines its error for complete truths only.
        "mocap_error": mocap_error(seen, truth.shapes) if truth.valid is None else None,
        "rotation_error_degrees": (
            None if truth.rotations is None else rotation_error(result.rotations, truth.rotations)
        ),
        "depth_calibration": (
            None
            if result.depth_deviation is None or not entries
            else depth_calibration(seen, truth.shapes, cameras, valid=truth.valid)
        ),
    }


def score_lines(values: dict[str, Any], skip: Collection[str] = ()) -> list[tuple[str, str]]:
    """Return (name, text) for each score that is there; ``skip`` names alignments to leave out."""
    errors = {name: error for name, error in values["shape_error"].items() if name not in skip}
    lines = [(f"3D error e3D, align {name}", f"{error:.4f}") for name, error in errors.items()]
    if values["mocap_error"] is not None:
        lines.append(("mocap error, align global", f"{values['mocap_error']:.4f}"))
    if values["rotation_error_degrees"] is not None:
        lines.append(("rotation error", f"{values['rotation_error_degrees']:.2f} degrees"))
    found = values["depth_calibration"]
    if found is not None:
        within = f"{100 * found['within_1']:.1f} % and {100 * found['within_2']:.1f} %"
        lines.append(("depth within 1 and 2 deviations", f"{within} (68.3 % and 95.4 % of normal errors)"))
    entries = values["frames"] * values["points"]
    if values["scored_entries"] < entries:
        lines.append(
            (
                "scored",
                f"{values['scored_points']} of {values['points']} points, {values['scored_entries']} of {entries} "
                "entries",
            )
        )
    return lines
