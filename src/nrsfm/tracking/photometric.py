"""All frames and all points at once: basis and coefficients fitted to the images themselves.

Of a point with coefficients c(x) the flow to frame f is Q_f c(x). The images, linearised about it, say by how much it
is wrong: over a small window, with the gradient g and the difference r of reference and frame, S = Σ g gᵀ / σ² is what
they know, 2 × 2, and b = Σ g r / σ² where they pull. Coefficients and basis minimise

    Σ_f Σ_x  (δ − S⁻¹ b)ᵀ S (δ − S⁻¹ b),   δ the change of Q_f c(x),   + smoothness of c(x),

in turn, each by linear least squares: for a point all frames determine its R numbers, for a frame all points its 2 R.
So a point with little texture, or on an edge, gives only what it knows, and no error builds up along the video.
Estimating multi-frame flow by factorising such windowed quantities is due to Irani: "Multi-Frame Correspondence
Estimation Using Subspace Constraints", IJCV 48, 2002, and Anandan, Irani: "Factorization with Uncertainty", IJCV 49,
2002. Ours: what the images know is bounded by the deviation from the subspace that a point is allowed,
S (1 + d² S)⁻¹; the variance σ² is that of the window in that frame; trust by local correlation; the Gaussian
prior of the coefficients by their smoothed neighbourhood; and a first pass on the evened-out images as elsewhere, then
one on a finer band, in which the texture outweighs shading.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.tracking.matching import FLOOR, Template
from nrsfm.tracking.subspace import Subspace, principal, samples_apart, smoothed
from nrsfm.video.libraries import import_cv2

FINE_BAND = (2.0, 0.5)  # pixels: normalisation and smoothing of the images of the second pass
FINE_WINDOW = 5.0
_WINDOW = 4.0  # pixels: deviation of the window of a step
SAMPLES = 2 * np.pi * _WINDOW**2 / 3  # independent pixels in it: neighbours' noise is alike
_TRUST = (0.2, 0.7)  # likeness at which trust begins, and is full
_LEAST_NOISE = 20.0  # variance, grey levels
_FAR = 2.0  # pixels: what pulls further counts less
_HOLD = 1e-3  # of a frame's basis to what it was
_START = 0.01  # precision, 1 / pixels²: what the images know nothing about stays near where it began
_INNER = 3
_CHUNK = 16384  # points
_WIDTH_SHARE = 10 / 28  # of the steps are on the wide band

# Rank, deviation of the smoothing in samples, precision of a coefficient given its surroundings, deviation from the
# subspace in pixels; along the first pass and along the second.
_WIDE = ((12, 3.0, 20.0, 0.7), (16, 2.5, 20.0, 0.7), (20, 2.0, 15.0, 0.7), (24, 2.0, 15.0, 0.7), (28, 2.0, 10.0, 0.7))
_FINE = ((28, 2.0, 15.0, 0.5), (32, 1.5, 12.0, 0.5), (36, 1.5, 10.0, 0.5))


def gradient(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives (h, w) of an image to the right and down."""
    cv2 = import_cv2()

    return cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8), cv2.Sobel(
        image, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8
    )


def _knowledge(
    template: Template, slope: tuple[np.ndarray, np.ndarray], frame: int, flow: np.ndarray, step: int, deviation: float
) -> np.ndarray:
    """Return what one frame knows about ``flow`` (h, w, 2) on the grid: Sxx, Sxy, Syy, bx, by, (5, rows, columns)."""
    cv2 = import_cv2()

    warped = template.sample(template.frames[frame], flow).astype(np.float32)
    centred, variance = template.moments(warped)
    trust = template.trust(template.likeness(warped), flow, _TRUST)[::step, ::step]
    rest = template.centred - centred * np.sqrt((template.variance + FLOOR) / (variance + FLOOR))
    own = gradient(warped)
    gx, gy = (slope[0] + own[0]) / 2, (slope[1] + own[1]) / 2

    def window(image: np.ndarray) -> np.ndarray:
        found: np.ndarray = cv2.GaussianBlur(image * template.weight, (0, 0), _WINDOW, borderType=cv2.BORDER_CONSTANT)[
            ::step, ::step
        ]
        return found

    noise = window(rest * rest) / (window(np.ones_like(rest)) + 1e-3) + _LEAST_NOISE
    scale = SAMPLES / noise * trust
    xx, xy, yy, bx, by = (window(part) * scale for part in (gx * gx, gx * gy, gy * gy, gx * rest, gy * rest))
    # S (1 + d² S)⁻¹, and the pull likewise.
    d = deviation**2
    mxx, mxy, myy = 1 + d * xx, d * xy, 1 + d * yy
    ixx, ixy, iyy = np.stack([myy, -mxy, mxx]) / (mxx * myy - mxy * mxy)
    known = np.stack(
        [ixx * xx + ixy * xy, ixx * xy + ixy * yy, ixy * xy + iyy * yy, ixx * bx + ixy * by, ixy * bx + iyy * by]
    )
    least = 1e-2
    determinant = (known[0] + least) * (known[2] + least) - known[1] ** 2
    dx = ((known[2] + least) * known[3] - known[1] * known[4]) / determinant
    dy = ((known[0] + least) * known[4] - known[1] * known[3]) / determinant
    found: np.ndarray = known / np.maximum(1, np.hypot(dx, dy) / _FAR)
    return found


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (F, R, R) of (F, R) each."""
    found: np.ndarray = np.einsum("fr,fs->frs", a, b)
    return found


def _fit(
    model: np.ndarray, known: np.ndarray, inside: np.ndarray, rank: int, sigma: float, pull: float, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return basis (2F, R) and coefficients (n, R) nearest to what is known (F, 5, n) about ``model`` (2F, n)."""
    frames, _, count = known.shape
    flow = model.reshape(frames, 2, count)
    xx, xy, yy = known[:, 0], known[:, 1], known[:, 2]
    towards_x = known[:, 3] + xx * flow[:, 0] + xy * flow[:, 1]
    towards_y = known[:, 4] + xy * flow[:, 0] + yy * flow[:, 1]
    basis = principal(model, weight, rank)
    size = basis.shape[1]
    pairs = basis.reshape(frames, 2, size)
    unit = np.eye(size, dtype=np.float32)
    coefficients = np.linalg.solve(basis.T @ basis + 1e-3 * unit, basis.T @ model).T.astype(np.float32)

    across = _products(pairs[:, 0], pairs[:, 1])
    parts = (
        (xx, _products(pairs[:, 0], pairs[:, 0]).reshape(frames, -1)),
        (xy, (across + across.transpose(0, 2, 1)).reshape(frames, -1)),
        (yy, _products(pairs[:, 1], pairs[:, 1]).reshape(frames, -1)),
    )
    right = towards_x.T @ pairs[:, 0] + towards_y.T @ pairs[:, 1]
    chunks = [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
    normal = np.zeros((0, size, size), dtype=np.float32)
    for n in range(_INNER):
        near = smoothed(coefficients, inside, weight + 0.02 * weight.mean(), sigma)
        for chunk in chunks:
            if n == 0 or len(chunks) > 1:  # normal equations of all points would be large: made again
                a, b, c = (part[:, chunk].T @ product for part, product in parts)
                normal = (a + b + c).reshape(-1, size, size) + np.float32(pull) * unit
            solved = np.linalg.solve(normal, (right[chunk] + np.float32(pull) * near[chunk])[..., None])
            coefficients[chunk] = solved[..., 0]
    for f in range(frames):
        a, b, c = ((coefficients * part[f][:, None]).T @ coefficients for part in (xx, xy, yy))
        whole = np.block([[a, b], [b, c]]).astype(np.float64)
        hold = _HOLD * np.trace(whole) / len(whole) + 1e-3
        before = pairs[f].reshape(-1).astype(np.float64)
        sum_ = np.concatenate([towards_x[f] @ coefficients, towards_y[f] @ coefficients]) + hold * before
        basis[2 * f : 2 * f + 2] = np.linalg.solve(whole + hold * np.eye(len(whole)), sum_).reshape(2, size)
    return basis, coefficients


def fit(wide: Template, fine: Template, flows: np.ndarray, advance: Callable[[], None]) -> Subspace:
    """Fit a subspace to the images from ``flows`` (F, h, w, 2), which become its predictions (changed in place).

    ``wide`` and ``fine`` are the templates of both bands.
    """
    options = wide.options
    frames, total = len(flows), options.fine
    step = samples_apart(wide)
    inside = wide.inside[::step, ::step]
    model = flows[:, ::step, ::step][:, inside].transpose(0, 2, 1).reshape(2 * frames, -1)
    begun = model
    broad = min(round(_WIDTH_SHARE * total), total - 1)
    found: Subspace | None = None
    slope = gradient(wide.image.astype(np.float32))
    template = wide
    for n in range(total):
        if n == broad:
            template, slope = fine, gradient(fine.image.astype(np.float32))
        plan, part = (_WIDE, n / max(broad, 1)) if n < broad else (_FINE, (n - broad) / (total - broad))
        rank, sigma, pull, deviation = plan[int(part * len(plan))]
        rank = max(1, min(rank, options.rank, 2 * frames - 1, model.shape[1] - 1))
        known = np.zeros((frames, 5, model.shape[1]), dtype=np.float32)
        for f in range(frames):
            if f == template.reference:
                known[f, [0, 2]] = 1 / deviation**2
            else:
                flow = flows[f] if found is None else found.prediction(f, template.shape)
                known[f] = _knowledge(template, slope, f, flow, step, deviation)[:, inside]
            advance()
        back = (begun - model).reshape(frames, 2, -1)
        known[:, [0, 2]] += _START
        known[:, 3:] += _START * back
        weight = (known[:, 0] + known[:, 2]).mean(axis=0) * deviation**2 / 2
        basis, coefficients = _fit(model, known, inside, rank, sigma, pull, weight)
        model = basis @ coefficients.T
        # A point's distance from the subspace is what its window would still move it by.
        left = np.hypot(known[:, 3], known[:, 4]) / np.maximum(known[:, 0] + known[:, 2], 1e-6) * 2
        share = known[:, 0] + known[:, 2]
        residual = float(np.sqrt((share * left**2).sum() / max(float(share.sum()), 1e-9)))
        found = Subspace(basis, coefficients, inside, step, residual)
    if found is None:
        raise ValueError("at least one step is needed")
    for f in range(frames):
        flows[f] = 0 if f == wide.reference else found.prediction(f, wide.shape)
    return found
