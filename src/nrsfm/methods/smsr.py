"""SMSR: tracks smoothed along time, then global low rank.

    minimise over Z   ‖Z − W‖²_F + s‖D Z‖²_F,   D: second differences of every trajectory over frames
    minimise over S   ½‖Z − RS‖²_F + γ‖S♯‖_*

Source: Ansari, Golyanik and Stricker, "Scalable dense monocular surface reconstruction", 3DV 2017 (arXiv 1710.06130):
constraints in trajectory space by smoothing the measurement matrix, cameras by thresholding and proximal gradient
(:mod:`nrsfm.cameras.proximal`), shapes by the multiplier method with the nuclear norm.

Departures. Only the abstract was at hand, so the filter is ours: the Whittaker smoother above (1923), with the strength
s of least estimated risk ‖W − Z‖² + 2σ²·2P·tr H for the noise level σ, H being the filter (Mallows' C_p, 1973; Stein
1981): none without noise. The penalty of the multiplier method starts as in ``bmm``. Cameras see the tracks unsmoothed.

On the exact compression: the filter is a multiplication from the left, alike for x and y, so smoothing W and then
compressing it is compressing W and then smoothing; the risk and the low-rank model use Gram matrices over points only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nrsfm.methods.base import LowRankOptions, Monitor, Needs, Problem, Solution, solve_global
from nrsfm.options import option

_STRENGTHS = np.concatenate([[0.0], np.logspace(-6, 8, 141)])


@dataclass(frozen=True)
class SmsrOptions(LowRankOptions):
    """Options of :class:`Smsr`: the smoothing, and those of the global low-rank model."""

    smoothing: float | None = option(
        None,
        "Strength of the smoothing of trajectories, in frames⁴: changes within about s^(1/4) frames are smoothed away. "
        "0 smooths nothing. Default: the one of least risk at the noise level.",
        symbol="s",
        minimum=0,
    )


class Smsr:
    """Smooth trajectories, global low rank."""

    name = "smsr"
    title = "Scalable monocular surface reconstruction"
    year = 2017
    summary = "tracks smoothed along time, then global low rank by the nuclear norm"
    assumes = "smooth trajectories; few deformation modes in all; cameras that turn"
    cost = "2F²P + F³ once; F²·min(2F, P) per iteration"
    needs = Needs(frame_order=True)
    camera_method = "proximal"
    denoise = False
    Options = SmsrOptions

    def cells(self, options: SmsrOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: SmsrOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Smooth, then alternate S and S♯ with multipliers until they agree."""
        smoother = Smoother(problem.tracks)
        strength = (
            options.smoothing if options.smoothing is not None else smoother.choose(problem.noise, problem.points)
        )
        gains = smoother.gains(strength)
        # White noise of the tracks that is left after the filter.
        noise = problem.noise * float(np.sqrt(np.mean(gains**2)))
        solution = solve_global(replace(problem, tracks=smoother.smooth(strength), noise=noise), options, monitor)
        solution.chosen |= {"smoothing": strength, "freedom": float(gains.sum())}
        return solution


class Smoother:
    """The Whittaker smoother of tracks (F, 2, N), diagonal in the eigenvectors of DᵀD: gains 1/(1 + sλ_j)."""

    def __init__(self, tracks: np.ndarray) -> None:
        frames = len(tracks)
        second = np.diff(np.eye(frames), 2, axis=0)
        penalties, self.basis = np.linalg.eigh(second.T @ second)
        self.penalties = np.maximum(penalties, 0.0)
        self.penalties[: min(2, frames)] = 0.0  # constant and linear trajectories
        self.tracks = tracks
        self.coefficients = self.basis.T @ tracks.reshape(frames, -1)

    def gains(self, strength: float) -> np.ndarray:
        """What each component is multiplied by, (F,)."""
        return 1.0 / (1.0 + strength * self.penalties)

    def smooth(self, strength: float) -> np.ndarray:
        """The tracks (F, 2, N) smoothed with that strength; 0 returns them as they are."""
        if strength <= 0:
            return self.tracks
        return (self.basis @ (self.gains(strength)[:, None] * self.coefficients)).reshape(self.tracks.shape)

    def choose(self, noise: float, points: int) -> float:
        """The strength of least risk at that noise level in P real points, of 142 a tenth of a decade apart."""
        energy = np.sum(self.coefficients**2, axis=1)
        risks = []
        for strength in _STRENGTHS:
            gains = self.gains(strength)
            risks.append(float(((1.0 - gains) ** 2) @ energy) + 4.0 * noise**2 * points * float(gains.sum()))
        return float(_STRENGTHS[int(np.argmin(risks))])
