"""How far a track may be off: a standard deviation in pixels for every point and frame.

Ours, of two parts that know of different errors.

*What the window knows.* Let G be the mean of g gᵀ over a window of the reference, g its gradient, and ρ² the mean
square of what the moved frame and the reference still differ by. Were this difference noise, n independent samples of
it in the window would leave the position uncertain by (ρ² / n) G⁻¹: the inverse of the matrix S of
:mod:`~nrsfm.tracking.photometric`, the posterior covariance under a flat prior. A fit has already removed what a motion
along strong gradients explains, so what is left moves the point along the weakest: its variance is ρ² / (n λ), λ the
smaller eigenvalue of G (the aperture problem; Shi, Tomasi: "Good Features to Track", CVPR 1994, choose points by λ).
Little texture, an edge, noise and a likeness that is low for whatever reason all raise it.

*What two estimates disagree on.* Where texture is alike in many places or light moves over the surface, a wrong place
can look right, and no residual tells. But there are two estimates of every track: by matching near a subspace and by
the photometric fit to finer texture, or by the naive and by the corrected chain. Their difference Δ has the variance
v₁ + v₂ − 2c per coordinate, c what their errors share. If both are equally good, and half of the error's variance is
shared (v₁ = v₂ = 2c), that is the error's variance itself. So the mean of |Δ|² / 2 over the window is taken. Without a
photometric fit the same is done with what direct matching between reference and frame still finds.

The parts are added. A position that nothing tells of has the deviation within which a match is believed at all. That
share of a half is assumed. Nothing is scaled to errors, but the two parts, the window of the mean and the floor of
the grey levels were chosen among others while looking at errors in six rendered videos.
"""

from __future__ import annotations

import numpy as np

from nrsfm.tracking import photometric
from nrsfm.tracking.matching import FLOOR, Template

EXACT = 0.05  # pixels: of positions in the reference frame, which are exact, so that weights stay finite
_FAR = 20.0  # pixels: deviation where the window says nothing
_GREY = 1.0  # grey levels squared: rounding
_FLAT = 1.0  # grey levels squared per pixel squared: gradients below are rounding


class Deviations:
    """What the reference's windows know, once for all frames.

    ``scale``: how many times the images were enlarged, which adds pixels but no independent ones.
    """

    def __init__(self, template: Template, scale: float = 1.0) -> None:
        self._template = template
        gx, gy = photometric.gradient(template.image.astype(np.float32))
        xx, xy, yy = (template.average(part) for part in (gx * gx, gx * gy, gy * gy))
        least = (xx + yy) / 2 - np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
        self._known = photometric.SAMPLES / scale**2 * np.maximum(least, 0) + _FLAT

    def window(self, warped: np.ndarray) -> np.ndarray:
        """Return the variance (h, w), pixels², that the window leaves to a frame seen through the flow, (h, w)."""
        template = self._template
        centred, variance = template.moments(warped.astype(np.float32))
        rest = template.centred - centred * np.sqrt((template.variance + FLOOR) / (variance + FLOOR))
        noise = template.average(rest * rest) + _GREY
        found: np.ndarray = 1 / (self._known / noise + 1 / _FAR**2)
        return found

    def disagreement(self, difference: np.ndarray) -> np.ndarray:
        """Return the variance (h, w), pixels², that the difference (h, w, 2) of two estimates tells of."""
        found: np.ndarray = self._template.average((difference**2).sum(axis=2)) / 2
        return found

    def remainder(self, warped: np.ndarray) -> np.ndarray:
        """Return the flow (h, w, 2) that direct matching still finds to a frame seen through the flow, (h, w)."""
        template = self._template
        inner = np.where(template.inside, warped, template.image)
        found: np.ndarray = template.flow.calc(template.image, inner, None)
        return found
