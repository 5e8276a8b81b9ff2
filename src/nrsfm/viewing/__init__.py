"""Pictures of tracks, shapes, errors, uncertainty, groups and convergence, as matplotlib figures in one style.

Every function returns a ``matplotlib.figure.Figure`` that no global state knows about; :func:`save_figure`
writes it. matplotlib is imported when a figure is made, not before.
"""

from __future__ import annotations

from nrsfm.viewing.convergence import convergence_figure
from nrsfm.viewing.figures import error_figure, groups_figure, shapes_figure, uncertainty_figure
from nrsfm.viewing.overview import overview_figure
from nrsfm.viewing.scene import SceneOptions, choose_frames
from nrsfm.viewing.style import house_style, save_figure
from nrsfm.viewing.tracks import tracks_figure

__all__ = [
    "SceneOptions",
    "choose_frames",
    "convergence_figure",
    "error_figure",
    "groups_figure",
    "house_style",
    "overview_figure",
    "save_figure",
    "shapes_figure",
    "tracks_figure",
    "uncertainty_figure",
]
