"""Low-rank Gaussian shapes seen by a perspective camera, fitted by expectation-maximisation to a sample of the tracks.

    y_fp (1 + ε s_f (R_f S_fp)_z) = s_f (R_f S_fp)_xy + t_f + n,   S_f = M + Σ_k c_fk V_k,   c_f ~ N(0, I), n ~ N(0, σ²)

with y the points about the principal point in units of their rms, and ε the strength of perspective: that unit over
the focal length. ε = 0 is the scaled orthographic camera. Multiplied out, the equation is linear in the shapes,

    y_fp = s_f (R_xy − ε y_fp r_z)_f S_fp + t_f + n,

with one 2×3 camera per point, so that E- and M-step are those of the affine model. Depth reversed with the mirrored
cameras is the same model with −ε: the likelihood over ε of both signs is evidence for the focal length and for the
mirror together. The Jacobian of y ↦ y (1 + ε z) is part of it, or a model that shrinks the data would win.

Each iteration: posterior of c (K×K per frame); M and V by one 3(K+1) system per point; t, σ²; a Gauss–Newton step on
R, s and t; and a standardisation of c, which makes the iteration fast. Cost per iteration O(F P K²).

Source: affine model and EM of Torresani, Hertzmann and Bregler (PAMI 30, 2008); the perspective form, its use as
evidence, and the standardisation: ours. Not run on the compression (a virtual point has no place in the image).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_SMALLEST_NOISE = 1e-8  # variance, in squared units; exact tracks would drive the likelihood to infinity
_LARGEST_TURN = 0.2  # radians of one Gauss-Newton step
_NARROWEST, _WIDEST = 0.2, 5.0  # scales, of mean 1
_UPPER = np.triu_indices(3)


@dataclass
class LowRankModel:
    """State of the fit.

    mean (3, N) M, basis (K, 3, N) V, rotations (F, 3, 3), scales (F,) of mean 1, shifts (F, 2) t, noise σ²,
    weights (F, K) posterior means of c, spread (F, K, K) their covariance, shapes (F, 3, N) posterior means,
    likelihood: log p per coordinate.
    """

    mean: np.ndarray
    basis: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    shifts: np.ndarray
    noise: float
    weights: np.ndarray
    spread: np.ndarray
    shapes: np.ndarray
    likelihood: float = -np.inf

    def copy(self) -> LowRankModel:
        """A copy of the state; no array is ever changed in place."""
        return LowRankModel(**self.__dict__)

    def camera_shapes(self) -> np.ndarray:
        """(F, 3, N) in the camera's frame, scaled to the image."""
        return np.asarray(self.scales[:, None, None] * (self.rotations @ self.shapes))


def start(tracks: np.ndarray, rotations: np.ndarray, scales: np.ndarray, shapes: np.ndarray, rank: int) -> LowRankModel:
    """The model from a reconstruction: its mean and leading deviations, in a gauge without rigid motion.

    tracks (F, 2, N), rotations (F, 3, 3), scales (F,), shapes (F, 3, N), all in the unit of the tracks.
    """
    frames, _, count = tracks.shape
    scales = scales / scales.mean()
    rotations, shapes = without_motion(rotations, shapes)
    mean = shapes.mean(axis=0)
    flat = (shapes - mean).reshape(frames, -1)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    basis = (vectors[:, ::-1][:, :rank].T @ flat).reshape(-1, 3, count) / np.sqrt(frames)
    shifts = tracks.mean(axis=2)
    gap = tracks - scales[:, None, None] * (rotations[:, :2] @ shapes) - shifts[:, :, None]
    cut = max(float(values[: max(0, frames - rank)].sum()), 0.0) / (frames * 3 * count)
    noise = max(float(np.mean(gap * gap)) + cut, 1e-6)
    size = len(basis)
    return LowRankModel(
        mean, basis, rotations, scales, shifts, noise, np.zeros((frames, size)), np.zeros((frames, size, size)), shapes
    )


def without_motion(rotations: np.ndarray, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every shape turned onto the mean (Procrustes), the cameras turned back: W = R S does not change."""
    shapes = shapes - shapes.mean(axis=2, keepdims=True)
    for _ in range(10):
        left, _, right = np.linalg.svd(shapes.mean(axis=0) @ np.swapaxes(shapes, 1, 2))
        sign = np.ones((len(shapes), 3))
        sign[:, 2] = np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)
        turn = (left * sign[:, None, :]) @ right
        shapes = turn @ shapes
        rotations = rotations @ np.swapaxes(turn, 1, 2)
    return rotations, shapes


def fit(model: LowRankModel, tracks: np.ndarray, strength: float, iterations: int) -> LowRankModel:
    """A new model after so many iterations at a fixed ε; a fit that breaks down has likelihood −infinity."""
    model = model.copy()
    try:
        for _ in range(iterations):
            _expect(model, tracks, strength)
            _maximise(model, tracks, strength)
        _expect(model, tracks, strength)
    except np.linalg.LinAlgError:
        model.likelihood = -np.inf
    if not np.isfinite(model.likelihood):
        model.likelihood = -np.inf
    return model


def _observed(model: LowRankModel, tracks: np.ndarray, strength: float, shapes: np.ndarray) -> np.ndarray:
    """(F, n, 2, N): what the cameras of all frames make of shapes (n, 3, N)."""
    out = np.empty((len(tracks), len(shapes), *tracks.shape[1:]))
    sized = (model.scales[:, None, None] * model.rotations).reshape(-1, 3)
    bent = strength * tracks
    for number, shape in enumerate(shapes):  # one at a time: the working copies stay in the processor's cache
        turned = (sized @ shape).reshape(len(tracks), 3, -1)
        out[:, number] = turned[:, :2] - bent * turned[:, 2:]
    return out


def _expect(model: LowRankModel, tracks: np.ndarray, strength: float) -> None:
    """Posterior of the weights, shapes, and the likelihood."""
    frames, _, count = tracks.shape
    rank = len(model.basis)
    design = _observed(model, tracks, strength, model.basis).reshape(frames, rank, 2 * count)
    gap = tracks - model.shifts[:, :, None] - _observed(model, tracks, strength, model.mean[None])[:, 0]
    gap = gap.reshape(frames, 2 * count)
    precision = design @ np.swapaxes(design, 1, 2) / model.noise + np.eye(rank)
    model.spread = np.linalg.inv(precision)
    model.weights = (model.spread @ (design @ gap[..., None]))[..., 0] / model.noise
    model.shapes = model.mean + (model.weights @ model.basis.reshape(rank, -1)).reshape(frames, 3, count)
    explained = np.einsum("fk,fkl,fl->f", model.weights, precision, model.weights)
    quadratic = np.sum(gap * gap) / model.noise - np.sum(explained)
    volume = np.sum(np.linalg.slogdet(precision)[1]) + tracks.size * np.log(2.0 * np.pi * model.noise)
    depths = model.scales[:, None] * (model.rotations[:, 2:3] @ model.shapes)[:, 0]
    jacobian = 2.0 * np.sum(np.log(np.maximum(1.0 + strength * depths, 0.05)))
    model.likelihood = float((-0.5 * (quadratic + volume) + jacobian) / tracks.size)


def _maximise(model: LowRankModel, tracks: np.ndarray, strength: float) -> None:
    """M and V, σ², cameras, and a standard gauge of the weights."""
    frames, _, count = tracks.shape
    rank = len(model.basis)
    found = point_systems(model, tracks, strength)
    found -= found.mean(axis=2, keepdims=True)
    model.mean, model.basis = found[0], found[1:]
    model.shapes = model.mean + (model.weights @ model.basis.reshape(rank, -1)).reshape(frames, 3, count)
    design = _observed(model, tracks, strength, model.basis).reshape(frames, rank, 2 * count)
    turned = model.rotations @ model.shapes
    seen = model.scales[:, None, None] * (turned[:, :2] - strength * tracks * turned[:, 2:])
    model.shifts = np.mean(tracks - seen, axis=2)
    gap = tracks - seen - model.shifts[:, :, None]
    uncertain = np.sum((design @ np.swapaxes(design, 1, 2)) * model.spread)
    model.noise = max(float((np.sum(gap * gap) + uncertain) / tracks.size), _SMALLEST_NOISE)
    _move_cameras(model, tracks, strength, turned, seen, gap)
    # The same model with weights of mean 0 and covariance I: EM alone crawls towards it.
    middle = model.weights.mean(axis=0)
    weights = model.weights - middle
    model.mean = model.mean + (middle @ model.basis.reshape(rank, -1)).reshape(3, count)
    covariance = (weights.T @ weights + model.spread.sum(axis=0)) / frames
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(rank))
    model.basis = (root.T @ model.basis.reshape(rank, -1)).reshape(rank, 3, count)


def point_systems(model: LowRankModel, tracks: np.ndarray, strength: float) -> np.ndarray:
    """(K+1, 3, N): mean and basis of every point by least squares, given cameras and weights."""
    frames, _, count = tracks.shape
    size = len(model.basis) + 1
    rows = model.rotations[:, :2, :, None] - strength * tracks[:, :, None] * model.rotations[:, 2][:, None, :, None]
    rows = model.scales[:, None, None, None] * rows  # (F, 2, 3, N)
    weights = np.concatenate([np.ones((frames, 1)), model.weights], axis=1)
    moments = weights[:, :, None] * weights[:, None]
    moments[:, 1:, 1:] += model.spread
    left, right = _UPPER
    squares = rows[:, 0][:, left] * rows[:, 0][:, right] + rows[:, 1][:, left] * rows[:, 1][:, right]
    blocks = (moments.reshape(frames, -1).T @ squares.reshape(frames, -1)).reshape(size, size, 6, count)
    normal = np.empty((count, size, 3, size, 3))
    for number, (i, j) in enumerate(zip(left, right, strict=True)):
        normal[:, :, i, :, j] = normal[:, :, j, :, i] = blocks[:, :, number].transpose(2, 0, 1)
    systems = normal.reshape(count, 3 * size, 3 * size)
    data = np.sum(rows * (tracks - model.shifts[:, :, None])[:, :, None], axis=1)
    data = (weights.T @ data.reshape(frames, -1)).reshape(size, 3, count).transpose(2, 0, 1).reshape(count, -1)
    diagonal = np.arange(3 * size)
    systems[:, diagonal, diagonal] += 1e-7 * float(np.mean(systems[:, diagonal, diagonal])) + 1e-12
    found = np.linalg.solve(systems, data[..., None])[..., 0]
    return np.asarray(found.reshape(count, size, 3).transpose(1, 2, 0))


def _move_cameras(
    model: LowRankModel, tracks: np.ndarray, strength: float, turned: np.ndarray, seen: np.ndarray, gap: np.ndarray
) -> None:
    """One Gauss–Newton step on rotation, image position and scale of every frame."""
    frames, _, count = tracks.shape
    (x, y, z), scale = turned.transpose(1, 0, 2), model.scales[:, None]
    across, down = strength * tracks[:, 0], strength * tracks[:, 1]
    slopes = np.zeros((frames, 6, 2, count))
    slopes[:, 0, 0], slopes[:, 0, 1] = -scale * across * y, -scale * (z + down * y)
    slopes[:, 1, 0], slopes[:, 1, 1] = scale * (z + across * x), scale * down * x
    slopes[:, 2, 0], slopes[:, 2, 1] = -scale * y, scale * x
    slopes[:, 3, 0] = slopes[:, 4, 1] = 1.0
    slopes[:, 5] = seen / model.scales[:, None, None]
    rows = slopes.reshape(frames, 6, -1)
    normal = rows @ np.swapaxes(rows, 1, 2)
    diagonal = np.arange(6)
    normal[:, diagonal, diagonal] = normal[:, diagonal, diagonal] * (1.0 + 1e-6) + 1e-12 * count
    step = np.linalg.solve(normal, rows @ gap.reshape(frames, -1, 1))[..., 0]
    turn = step[:, :3]
    turn = turn * np.minimum(1.0, _LARGEST_TURN / np.maximum(np.linalg.norm(turn, axis=1), 1e-12))[:, None]
    model.rotations = _rotations(turn) @ model.rotations
    model.shifts = model.shifts + step[:, 3:5]
    scales = np.clip(model.scales + step[:, 5], _NARROWEST, _WIDEST)
    common = float(scales.mean())
    model.scales = scales / common
    model.mean, model.basis, model.shapes = model.mean * common, model.basis * common, model.shapes * common


def _rotations(axes: np.ndarray) -> np.ndarray:
    """Rotation matrices (F, 3, 3) of axis-angle vectors (F, 3)."""
    angle = np.linalg.norm(axes, axis=1)[:, None, None]
    cross = np.zeros((len(axes), 3, 3))
    cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = axes.T
    cross -= np.swapaxes(cross, 1, 2)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / 2 / np.pi) ** 2 * cross @ cross
    )
