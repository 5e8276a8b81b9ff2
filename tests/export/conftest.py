"""A bending sheet, small enough to compare number by number, with everything that a reconstruction may have."""

import dataclasses

import numpy as np
import pytest

from nrsfm.reconstruction import Reconstruction

ROWS, COLUMNS, FRAMES = 6, 8, 7
LEFT_OUT = (0, 13)
MATRIX = np.array([[900.0, 0.0, 310.0], [0.0, 850.0, 250.0], [0.0, 0.0, 1.0]])


def turn(angles):
    """Rotations about y, then x."""
    a, b = angles, 0.3 * np.sin(2 * angles)
    zero, one = np.zeros_like(a), np.ones_like(a)
    about_y = np.array([[np.cos(a), zero, np.sin(a)], [zero, one, zero], [-np.sin(a), zero, np.cos(a)]])
    about_x = np.array([[one, zero, zero], [zero, np.cos(b), -np.sin(b)], [zero, np.sin(b), np.cos(b)]])
    return np.einsum("ijf,jkf->fik", about_x, about_y)


def bending_sheet(*, holes=False, scales=True, dtype=np.float32):
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = 20 * (columns - (COLUMNS - 1) / 2).ravel(), 20 * (rows - (ROWS - 1) / 2).ravel()
    time = np.linspace(0, 1, FRAMES)
    depth = time[:, None] * (x / 40) ** 2 + np.sin(3 * time)[:, None] * y / 5
    shapes = np.stack([np.broadcast_to(x, depth.shape), np.broadcast_to(y, depth.shape), 3 * depth], axis=2)
    shapes = shapes - shapes.mean(axis=1, keepdims=True)
    frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]  # the object frame is free: not the camera's
    frame *= np.linalg.det(frame)
    shapes = (shapes @ frame).astype(dtype)
    confidence = rng.uniform(0, 1, shapes.shape[:2]).astype(np.float32)
    deviation = rng.uniform(0, 1, shapes.shape[:2]).astype(np.float32)
    if holes:
        shapes[:, LEFT_OUT], confidence[:, LEFT_OUT], deviation[:, LEFT_OUT] = np.nan, 0, np.nan
    return Reconstruction(
        shapes=shapes,
        rotations=turn(time - 0.2) @ frame,
        translations=np.column_stack([320 + 30 * time, 240 - 50 * time]),
        scales=1.0 + 0.3 * np.cos(4 * time) if scales else np.ones(FRAMES),
        groups=np.arange(ROWS * COLUMNS) % 5 - 1,
        method="bmm",
        confidence=confidence,
        depth_deviation=deviation,
    )


def with_perspective(result):
    report = {"undone": True, "intrinsics": MATRIX.tolist(), "focal": MATRIX[0, 0]}
    return dataclasses.replace(result, diagnostics={"perspective": report})


def seen_in_perspective(result, frame):
    """What the pinhole camera sees of a frame: an account of its own of the conventions, (P, 2)."""
    (fx, _, cx), (_, fy, cy), _ = MATRIX
    turned = result.scales[frame] * (result.shapes[frame].astype(float) @ result.rotations[frame].T)
    centred = turned[:, :2] + result.translations[frame] - (cx, cy)
    over = 1 + turned[:, 2] / fx
    return np.column_stack([cx + centred[:, 0] / over, cy + fy / fx * centred[:, 1] / over])


def view(points, orientation, position):
    """Points (N, 3) in the frame of a camera: x right, y up, z backward."""
    return (points - position) @ orientation


@pytest.fixture
def result():
    return bending_sheet()


@pytest.fixture
def holed():
    return bending_sheet(holes=True)


@pytest.fixture(params=["object", "camera"])
def frame(request):
    return request.param
