"""Cameras that circle the object at an even pace: R_f = exp(f ω) R₀, three numbers instead of 3F.

Tracks alone cannot tell a turn of the camera from a turn of the object that all points share: R_f Oᵀ and O S_f
reproject alike for every rotation O. Estimates from tracks put as much of the object's own slow turning (a body
that bends down) as possible into the camera. Where an even turn explains the tracks as well, it is the simpler
account, and it leaves the object's motion in the shapes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nrsfm.manifolds.rotations import from_vectors, to_vectors


def _nearest(cross: np.ndarray) -> np.ndarray:
    """Rotation that maximises trace(Rᵀ cross)."""
    u, _, vt = np.linalg.svd(cross)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def orbit_path(velocity: np.ndarray, frames: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """exp(f ω) R₀ for the given frame numbers, with R₀ the one nearest to ``rotations`` (F, 3, 3)."""
    turns = from_vectors(frames[:, None] * velocity)
    return turns @ _nearest(np.einsum("fji,fjk->ik", turns, rotations))


def fit_orbit(rotations: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Angular velocity ω (radians per frame) of the orbit nearest to a camera path (F, 3, 3).

    Gauss-Newton on the squared angles from the median turn between consecutive frames. Returns ω, the mean
    deviation and the whole turn |ω|(F − 1), both in degrees.
    """
    count = len(rotations)
    frames = np.arange(count) - (count - 1) / 2.0
    velocity = np.median(to_vectors(rotations[1:] @ np.swapaxes(rotations[:-1], 1, 2)), axis=0)
    for _ in range(30):
        path = orbit_path(velocity, frames, rotations)
        gap = to_vectors(rotations @ np.swapaxes(path, 1, 2))
        slope = np.empty((count, 3, 6))
        slope[:, :, 3:] = path @ np.swapaxes(path[:1], 1, 2)
        back = np.swapaxes(from_vectors(frames[:, None] * velocity), 1, 2)
        for i in range(3):
            moved = from_vectors(frames[:, None] * (velocity + 1e-6 * np.eye(3)[i]))
            slope[:, :, i] = to_vectors(moved @ back) / 1e-6
        step = np.linalg.lstsq(slope.reshape(-1, 6), gap.ravel(), rcond=None)[0][:3]
        velocity = velocity + step
        if np.linalg.norm(step) < 1e-10:
            break
    gap = to_vectors(rotations @ np.swapaxes(orbit_path(velocity, frames, rotations), 1, 2))
    deviation = float(np.degrees(np.linalg.norm(gap, axis=1).mean()))
    return velocity, deviation, float(np.degrees(np.linalg.norm(velocity)) * (count - 1))


def refine_orbit(
    velocity: np.ndarray, frames: int, criterion: Callable[[np.ndarray], float], evaluations: int
) -> tuple[np.ndarray, float]:
    """Nelder-Mead on ω for the least ``criterion(ω)``, within steps that turn the last frame by some degrees."""
    from scipy.optimize import minimize

    step = np.radians(4.0) / frames
    # Along the axis a step turns the ends of the path; across it, it tilts the axis by step/|ω|.
    speed = np.linalg.norm(velocity)
    axis = velocity / speed
    across = np.linalg.svd(axis[None])[2][1:]
    tilt = np.radians(2.0) * speed
    simplex = np.vstack([velocity, velocity + step * axis, velocity + tilt * across[0], velocity + tilt * across[1]])
    found = minimize(
        criterion,
        velocity,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": evaluations, "xatol": step / 50.0, "fatol": 0.0},
    )
    return found.x, float(found.fun)
