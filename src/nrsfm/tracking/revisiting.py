"""What the chain lost, found again: by landmarks, from the frames before and after, and from what is seen around it.

Ours; choosing between flows that came by different ways, point by point, is after Crivelli, Conze, Robert, Pérez:
"From Optical Flow to Dense Long Term Correspondences" (ICIP 2012). The video is swept in both directions. In every
frame, beside the flow it has, stand the flow of the neighbouring frame carried on by one step, what landmarks
suggest, and the continuation of trusted flow by locally affine motion (normalised convolution of first order,
Knutsson, Westin: "Normalized and Differential Convolution", CVPR 1993), so that what is found grows outwards also
where the surface is compressed. A point that is not trusted tries what looks most like the reference, all is matched
again, and what then looks better than before is kept. All this is for textures that can be told apart: frames in which
landmarks contradict each other are left alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.tracking.filling import fill
from nrsfm.tracking.landmarks import Landmarks
from nrsfm.tracking.matching import Template
from nrsfm.video.libraries import import_cv2

_BETTER = 0.1  # of local correlation
_SURE = 0.3  # trust above which flow is carried on, and below which it is given up
_WORTH = 0.002  # share of points that must have changed
_LEAST = 1e-5
_STEP = 4  # pixels between the samples of the continuation
_REACH = 4.0  # samples: deviation of its window
_STIFF = 0.02  # of the continuation's gradient


def continued(flow: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Return the flow (h, w, 2) that goes on affinely from where it is trusted."""
    cv2 = import_cv2()

    known = cv2.erode(trust, np.ones((5, 5), dtype=np.uint8))[::_STEP, ::_STEP].astype(np.float64)
    known[known < _SURE] = 0
    field = flow[::_STEP, ::_STEP].astype(np.float64)
    y, x = np.indices(known.shape, dtype=np.float64)

    def around(values: np.ndarray) -> np.ndarray:
        found: np.ndarray = cv2.GaussianBlur(values, (0, 0), _REACH, borderType=cv2.BORDER_CONSTANT)
        return found

    one, sx, sy = around(known), around(known * x), around(known * y)
    # Moments about each sample itself.
    mx, my = sx - one * x, sy - one * y
    xx = around(known * x * x) - 2 * x * sx + x * x * one
    yy = around(known * y * y) - 2 * y * sy + y * y * one
    xy = around(known * x * y) - x * sy - y * sx + x * y * one
    stiff = _STIFF * _REACH**2 * one + 1e-9
    normal = np.stack(
        [np.stack([one + 1e-9, mx, my], -1), np.stack([mx, xx + stiff, xy], -1), np.stack([my, xy, yy + stiff], -1)], -2
    )
    right = []
    for k in range(2):
        u = known * field[..., k]
        plain, ux, uy = around(u), around(u * x), around(u * y)
        right.append(np.stack([plain, ux - plain * x, uy - plain * y], -1))
    found = np.linalg.solve(normal, np.stack(right, -1))[..., 0, :]
    share = (one / (one + 1e-4))[..., None]
    found = np.where(share > 0.5, found, 0).astype(np.float32)
    near = (share[..., 0] > 0.5).astype(np.float32)
    height, width = trust.shape
    scale = np.array([[1 / _STEP, 0, 0], [0, 1 / _STEP, 0]], dtype=np.float32)
    how = {"flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, "borderMode": cv2.BORDER_REPLICATE}
    wide = cv2.warpAffine(found, scale, (width, height), **how)
    inner = cv2.warpAffine(near, scale, (width, height), **how)[..., None] > 0.99
    result: np.ndarray = np.where(inner, wide, flow)
    return result


def _attempt(
    template: Template, frame: int, own: np.ndarray, trust: np.ndarray, others: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a better flow and its trust, or ``None`` where hardly anything is better."""
    image = template.frames[frame]
    before = template.likeness(template.sample(image, own))
    best = np.where(trust > _SURE, before + _BETTER, np.minimum(before, 0))
    flow = own.copy()
    for other in others:
        likeness = template.likeness(template.sample(image, other))
        better = (likeness > best) & template.inside
        flow[better], best = other[better], np.where(better, likeness, best)
    if np.count_nonzero(np.abs(flow - own).max(axis=2) > 0.5) < _WORTH * np.count_nonzero(template.inside):
        return None
    flow, _ = template.correct(frame, flow)
    after = template.likeness(template.sample(image, flow))
    better = (after > before + _BETTER) & template.inside
    if np.count_nonzero(better) < _WORTH * np.count_nonzero(template.inside):
        return None
    flow = np.where(better[..., None], flow, own)
    seen = template.seen(frame, flow)
    flow = fill(flow, np.maximum(seen, _LEAST * template.weight).astype(np.float32))
    return flow, template.seen(frame, flow)


def revisit(
    template: Template, flows: np.ndarray, trusts: np.ndarray, sweeps: int, advance: Callable[[], None]
) -> tuple[np.ndarray, np.ndarray]:
    """Sweep forward and backward; ``flows`` (F, h, w, 2) and ``trusts`` (F, h, w) are changed in place."""
    landmarks = Landmarks(template)
    count = len(flows)
    suggestions = np.zeros(count, dtype=bool)
    for sweep in range(sweeps):
        step = 1 if sweep % 2 == 0 else -1
        for f in range(count)[::step]:
            advance()
            if f == template.reference:
                continue
            others = []
            if sweep == 0:
                suggested = landmarks.suggestion(f)
                if suggested is not None:
                    others.append(suggested)
                    suggestions[f] = True
            if not suggestions[f]:
                continue  # a texture that cannot be told apart would be led astray
            before = f - step
            if 0 <= before < count:
                move, sure = template.step(before, f, flows[before])
                sure = sure * trusts[before]
                others.append(np.where(sure[..., None] > _SURE, flows[before] + move, flows[f]))
            found = _attempt(template, f, flows[f], trusts[f], others)
            for _ in range(2):
                if found is not None:
                    flows[f], trusts[f] = found
                found = _attempt(template, f, flows[f], trusts[f], [continued(flows[f], trusts[f])])
                if found is None:
                    break
            if found is not None:
                flows[f], trusts[f] = found
    return flows, trusts
