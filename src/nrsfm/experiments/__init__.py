"""The experiments of the paper: each a table or figure that one command computes, draws and judges."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from nrsfm.errors import OptionError, suggest

if TYPE_CHECKING:
    from nrsfm.experiments.base import Experiment

_EXPERIMENTS = {
    "table": ("table", "Table", "every method on every sequence"),
    "noise": ("noise", "Noise", "error against the noise of the tracks"),
    "singular-values": ("singular_values", "SingularValues", "error against the dimension p of the subspaces"),
    "rank": ("rank", "Rank", "reprojection error and shape fit against K"),
    "ablation": ("ablation", "Ablation", "parts of both algorithms switched off"),
    "tau": ("tau", "Tau", "the energy τ that the projection keeps, and its dimension"),
    "subspaces": ("subspaces", "Subspaces", "the number of spatial and temporal subspaces"),
    "time": ("timing", "Timing", "seconds against frames and points"),
    "convergence": ("convergence", "Convergence", "energy and gap against iterations"),
    "gallery": ("gallery", "Gallery", "every sequence drawn: input, reconstruction, truth, subspaces"),
    "temporal-tearing": ("temporal_tearing", "TemporalTearing", "trajectories at the borders of temporal groups"),
    "camera-motion": ("camera_motion", "CameraMotion", "one deformation under eight camera paths"),
}


def experiment_names() -> list[str]:
    """Names that ``nrsfm experiment`` takes, in the order of the report."""
    return list(_EXPERIMENTS)


def about(name: str) -> str:
    """A few words on an experiment, without loading it."""
    return _EXPERIMENTS[name][2]


def get_experiment(name: str) -> Experiment:
    """The experiment of that name; raises ``OptionError`` with the nearest names for an unknown one."""
    if name not in _EXPERIMENTS:
        raise OptionError(
            f"experiment must be one of {', '.join(_EXPERIMENTS)}, received {name!r}{suggest(name, _EXPERIMENTS)}"
        )
    module, attribute, _ = _EXPERIMENTS[name]
    experiment: Experiment = getattr(importlib.import_module(f"nrsfm.experiments.{module}"), attribute)()
    return experiment
