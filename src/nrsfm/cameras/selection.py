"""Which of several camera estimates to keep, judged without ground truth by the shapes that each one implies.

For a candidate R the compressed global low-rank problem

    min ‖S♯‖_*  subject to  R S = W

is solved on the leading virtual points (ADMM, Dai, Li and He 2014) and the singular values σ of S♯ are looked at:
wrong cameras need more and larger ones. ``norm`` = ‖S♯‖_*/‖W‖ rejects the grossly wrong; among the candidates
within 3% of the least, ``log`` = mean log(σ_i + 10⁻³σ₁), which rewards a sharp fall, decides. Candidates whose
``log`` is within 0.006 of the least count as equal, and then the largest K wins: its metric upgrade leaves the
least unexplained, and where the data have the rank its cameras are the more exact ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.numerics.low_rank import threshold_over_frames

VIRTUAL_POINTS = 30
FRAMES = 120
NORM_TOLERANCE = 0.03
LOG_TOLERANCE = 0.006


class Judge:
    """Scores camera paths on a fixed, small part of the data: leading virtual points, evenly spread frames."""

    def __init__(self, basis: np.ndarray, iterations: int = 25) -> None:
        """``basis``: Π = UΣ (2F, n), the factor's leading columns."""
        frames = len(basis) // 2
        stride = -(-frames // FRAMES)
        self.frames = np.arange(0, frames, stride)
        small = basis[:, :VIRTUAL_POINTS].reshape(frames, 2, -1)[self.frames]
        self.tracks = np.ascontiguousarray(small)
        self.iterations = iterations

    def shapes(self, rotations: np.ndarray) -> np.ndarray:
        """Low-rank shapes (f, 3, n) of the judged frames for rotations (F, 3, 3) of all frames."""
        return low_rank_shapes(rotations[self.frames], self.tracks, self.iterations)

    def criteria(self, rotations: np.ndarray) -> dict[str, float]:
        """The two criteria of this module's head; smaller is better."""
        shapes = self.shapes(rotations).reshape(len(self.frames), -1)
        gram = shapes @ shapes.T if len(shapes) <= shapes.shape[1] else shapes.T @ shapes
        sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0))
        total = float(np.linalg.norm(self.tracks))
        if total <= 0 or sigma[0] <= 0:
            return {"norm": 0.0, "log": 0.0}
        sigma = sigma / np.sqrt(total**2 / len(self.frames))
        return {
            "norm": float(sigma.sum() / np.sqrt(len(self.frames))),
            "log": float(np.mean(np.log(sigma + 1e-3 * sigma[0]))),
        }


def low_rank_shapes(rotations: np.ndarray, tracks: np.ndarray, iterations: int) -> np.ndarray:
    """Shapes (F, 3, N) of least nuclear norm over frames that reproject to tracks (F, 2, N) exactly.

    ADMM; the threshold starts at a third of the largest singular value of W and falls by 10% an iteration.
    """
    rows = rotations[:, :2]
    back = np.swapaxes(rows, 1, 2)
    low = back @ tracks
    dual = np.zeros_like(low)
    cut = 0.3 * float(np.linalg.norm(tracks.reshape(2 * len(tracks), -1), 2))
    shapes = low
    for _ in range(iterations):
        shapes = low - dual
        shapes = shapes + back @ (tracks - rows @ shapes)
        low, _ = threshold_over_frames(shapes + dual, cut)
        dual = (dual + shapes - low) / 1.1
        cut /= 1.1
    return shapes


def choose(rows: list[dict[str, Any]]) -> int:
    """Index of the winner by the rule of this module's head; of equals, the one of largest K, then least cost."""
    least = min(row["norm"] for row in rows)
    close = [i for i, row in enumerate(rows) if row["norm"] <= (1.0 + NORM_TOLERANCE) * least]
    sharpest = min(rows[i]["log"] for i in close)
    equal = [i for i in close if rows[i]["log"] <= sharpest + LOG_TOLERANCE]
    return max(equal, key=lambda i: (rows[i]["K"], -rows[i]["cost"]))
