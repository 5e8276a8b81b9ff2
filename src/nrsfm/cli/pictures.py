"""The pictures of an output folder: which there are, and what each is drawn from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.progress import Report

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from nrsfm.cli.inputs import Inputs
    from nrsfm.reconstruction import Reconstruction
    from nrsfm.viewing import SceneOptions

# Where a scale per frame takes away this share of the error, truth and tracks are in different units.
_OTHER_UNIT = 0.7


def draw(folder: Path, inputs: Inputs, result: Reconstruction, found: dict[str, Any] | None, report: Report) -> None:
    """Write every picture that the data allow; ``found`` are the scores, if there is a truth."""
    from nrsfm import viewing

    shapes, scene = _truth(inputs, found)
    unit = inputs.unit
    figures: dict[str, Callable[[], Figure]] = {
        "overview": lambda: viewing.overview_figure(result, inputs.tracks, shapes, unit=unit, **scene),
        "tracks": lambda: viewing.tracks_figure(inputs.tracks, result),
        "shapes": lambda: viewing.shapes_figure(result, shapes, **scene),
    }
    if shapes is not None:
        figures["error"] = lambda: viewing.error_figure(result, shapes, unit=unit, **scene)
    if result.depth_deviation is not None:
        figures["uncertainty"] = lambda: viewing.uncertainty_figure(result, unit=unit, **_plain(scene))
    if result.groups is not None:
        figures["groups"] = lambda: viewing.groups_figure(result, **_plain(scene))
    if result.diagnostics.get("history"):
        figures["convergence"] = lambda: viewing.convergence_figure(result)
    for number, (name, make) in enumerate(figures.items()):
        report("drawing", number / len(figures))
        viewing.save_figure(make(), folder / f"{name}.png")


def _truth(inputs: Inputs, found: dict[str, Any] | None) -> tuple[np.ndarray | None, SceneOptions]:
    """The true shapes, if there are any, and what all pictures are told of the scene."""
    scene: SceneOptions = {"faces": inputs.faces, "edges": inputs.edges}
    truth = inputs.truth
    if truth is None or found is None:
        return None, scene
    scene["valid"] = truth.valid
    scene["truth_rotations"] = truth.rotations
    if truth.frame == "camera":  # each true shape is already as its camera sees it
        scene["truth_rotations"] = np.tile(np.eye(3), (len(truth.shapes), 1, 1))
    errors = found["shape_error"]
    scene["align"] = "similarity" if errors["similarity"] < _OTHER_UNIT * errors["per-frame"] else "per-frame"
    return truth.shapes, scene


def _plain(scene: SceneOptions) -> SceneOptions:
    """What concerns the reconstruction alone."""
    return {"faces": scene["faces"], "edges": scene["edges"]}
