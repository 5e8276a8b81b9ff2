"""Which of several camera estimates to keep, judged without ground truth by the shapes that each one implies.

For a candidate R the compressed global low-rank problem

    min ‖S♯‖_*  subject to  R S = W

is solved (ADMM on the leading virtual points) and its singular values σ are looked at: wrong cameras need more
and larger ones.
"""

from __future__ import annotations

import numpy as np

from nrsfm.numerics.low_rank import singular_values_over_frames


def _threshold(shapes: np.ndarray, cut: float) -> tuple[np.ndarray, np.ndarray]:
    """Singular-value threshold of S♯ through whichever of its two Gram matrices is smaller."""
    from scipy.linalg import eigh

    flat = shapes.reshape(len(shapes), -1)
    left = len(flat) <= flat.shape[1]
    gram = flat @ flat.T if left else flat.T @ flat
    values, vectors = eigh(gram, check_finite=False, driver="evd")
    sigma = np.sqrt(np.maximum(values, 0.0))
    live = sigma > cut
    basis = vectors[:, live]
    gain = 1.0 - cut / sigma[live]
    out = (basis * gain) @ (basis.T @ flat) if left else ((flat @ basis) * gain) @ basis.T
    return out.reshape(shapes.shape), sigma[live][::-1] - cut


def low_rank_shapes(rotations: np.ndarray, factor: np.ndarray, *, iterations: int = 30) -> np.ndarray:
    """Shapes (F, 3, N) of least nuclear norm that reproject exactly: ADMM with a falling threshold."""
    rows = rotations[:, :2]
    back = np.swapaxes(rows, 1, 2)
    tracks = factor.reshape(len(rotations), 2, -1)
    low = back @ tracks
    dual = np.zeros_like(low)
    cut = 0.3 * np.linalg.norm(factor, 2)
    shapes = low
    for _ in range(iterations):
        shapes = low - dual
        shapes = shapes + back @ (tracks - rows @ shapes)
        low, _ = _threshold(shapes + dual, cut)
        dual = (dual + shapes - low) / 1.1
        cut /= 1.1
    return shapes


def spectrum_criteria(shapes: np.ndarray, factor: np.ndarray) -> dict[str, float]:
    """``norm`` = ‖S♯‖_*/‖W‖_F and ``log`` = mean log(σ_i/σ₁ + 10⁻³), both small for good cameras."""
    sigma, _ = singular_values_over_frames(shapes) if len(shapes) <= shapes[0].size else (_small(shapes), None)
    total = np.linalg.norm(factor)
    if sigma[0] <= 0 or total <= 0:
        return {"norm": 0.0, "log": 0.0}
    return {"norm": float(sigma.sum() / total), "log": float(np.mean(np.log(sigma / sigma[0] + 1e-3)))}


def _small(shapes: np.ndarray) -> np.ndarray:
    return np.linalg.svd(shapes.reshape(len(shapes), -1), compute_uv=False)
