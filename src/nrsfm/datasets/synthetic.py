"""Built-in sequences: generated surfaces that deform non-linearly, seen by cameras like the paper's four.

Nothing is downloaded. A sequence is a function of its arguments alone: with the same seed, more frames sample
the same motion more finely and more points sample the same surface more finely. One unit is one pixel of the
tracks; the image is 480 × 480 pixels and the object about 300 pixels in its larger direction.
"""

from __future__ import annotations

import dataclasses
import numbers
from collections.abc import Callable
from typing import Any

import numpy as np

from nrsfm.datasets.grids import full_grid, trimmed_grid
from nrsfm.datasets.sequence import Sequence, add_noise, choose_dtype
from nrsfm.errors import OptionError, suggest
from nrsfm.tracks import Tracks

IMAGE_SIZE = 480
"""Width and height of the image in pixels."""

CAMERAS = {
    "pan30": "turns evenly from -30° to +30° about the vertical axis",
    "pan90": "turns evenly from -90° to +90° about the vertical axis",
    "fast": "several quick turns, up to 40° sideways and 18° up and down",
    "slow": "one slow turn, up to 35° sideways and 12° up and down",
}
"""The camera paths, by name."""

_PIXELS_PER_MM = 1.5  # a head of ordinary size fills two thirds of the image


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SyntheticSequence(Sequence):
    """A generated sequence: a :class:`Sequence` whose scales and translations are known too.

    Without noise, ``tracks.points[f] = scales[f] * (rotations[f] @ shapes[f].T)[:2].T + translations[f]``.

    Attributes
    ----------
    scales
        (F,) image scale of each frame: pixels per unit of the shapes.
    translations
        (F, 2) pixels: where the object's origin is seen.
    """

    scales: np.ndarray = dataclasses.field(default_factory=lambda: np.ones(0))
    translations: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))


def face_sequence(
    frames: int = 99,
    points: int = 28_880,
    camera: str = "fast",
    noise: float = 0.0,
    seed: int = 0,
    deformation: float = 1.0,
    *,
    zoom: float = 0.0,
    dtype: Any = None,
) -> SyntheticSequence:
    """Return a generated face that speaks, smiles, frowns and blinks in front of an orthographic camera.

    Parameters
    ----------
    frames, points
        F ≥ 2 and P ≥ 4; exactly as many are returned. The points are a regular grid on the skin, trimmed to
        an oval.
    camera
        One of :data:`CAMERAS`: ``"pan30"``, ``"pan90"``, ``"fast"``, ``"slow"``.
    noise
        Standard deviation of the Gaussian noise on the tracks, as a ratio of max |W| (W centred row by row).
    seed
        Seed of the expressions and of the noise.
    deformation
        Strength of the expressions, 0 (rigid) to 2; at 1 the rigid mean shape scores an e3D of about .06.
    zoom
        Relative change of the image scale over the sequence, 0 (orthographic) to 0.5.
    dtype
        ``float32`` or ``float64``, of tracks and shapes; by default float64 unless the sequence is large.

    Returns
    -------
    SyntheticSequence
        With ``faces`` (M, 3), triangles of neighbouring grid points.

    Raises
    ------
    OptionError
        An argument is out of range, or the camera is unknown.
    InputError
        Another dtype.
    """
    from nrsfm.datasets import face_surface as face

    options = _check(frames, points, camera, noise, seed, deformation, zoom, dtype)
    area = 32_800.0  # mm² inside the outline
    u, v, faces = trimmed_grid(
        options.points, (112.0, 112.0), (0.0, -6.0), face.outline, area=area, smooth=options.points >= 200
    )
    skin = face.make_skin(u, v)
    motion = _activations(options.frames, np.random.default_rng([options.seed, 1]))
    middle = face.pose(skin, dict.fromkeys(face.EXPRESSIONS, 0.0)).mean(axis=1, keepdims=True)

    def shape(f: int) -> np.ndarray:
        moved = face.pose(skin, {name: deformation * values[f] for name, values in motion.items()})
        return (moved - middle) * _PIXELS_PER_MM

    return _sequence("face", options, shape, faces, "generated face with local, non-linear expressions")


def sheet_sequence(
    frames: int = 99,
    points: int = 10_000,
    camera: str = "slow",
    noise: float = 0.0,
    seed: int = 0,
    deformation: float = 1.0,
    *,
    zoom: float = 0.0,
    dtype: Any = None,
) -> SyntheticSequence:
    """Return a generated cloth that waves and twists without stretching along its length.

    Parameters, result and errors as in :func:`face_sequence`.
    """
    from nrsfm.datasets import sheet_surface as sheet

    options = _check(frames, points, camera, noise, seed, deformation, zoom, dtype)
    u, v, faces = full_grid(options.points, *sheet.SIZE)
    shape = sheet.waves(u, v, options.frames, options.seed, options.deformation)
    return _sequence("sheet", options, shape, faces, "generated cloth with travelling waves")


@dataclasses.dataclass(frozen=True)
class _Options:
    frames: int
    points: int
    camera: str
    noise: float
    seed: int
    deformation: float
    zoom: float
    dtype: np.dtype[Any]


def _whole(name: str, value: Any, minimum: int) -> int:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < minimum:
        raise OptionError(f"{name} must be a whole number of at least {minimum}, received {value!r}")
    return int(value)


def _ratio(name: str, value: Any, maximum: float) -> float:
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not 0 <= float(value) <= maximum:
        raise OptionError(f"{name} must be a number from 0 to {maximum:g}, received {value!r}")
    return float(value)


def _check(
    frames: Any, points: Any, camera: Any, noise: Any, seed: Any, deformation: Any, zoom: Any, dtype: Any
) -> _Options:
    if not isinstance(camera, str) or camera not in CAMERAS:
        raise OptionError(
            f"camera must be one of {', '.join(CAMERAS)}, received {camera!r}{suggest(str(camera), CAMERAS)}"
        )
    frames, points = _whole("frames", frames, 2), _whole("points", points, 4)
    return _Options(
        frames=frames,
        points=points,
        camera=camera,
        noise=_ratio("noise", noise, 10.0),
        seed=_whole("seed", seed, 0),
        deformation=_ratio("deformation", deformation, 2.0),
        zoom=_ratio("zoom", zoom, 0.5),
        dtype=choose_dtype(dtype, 2 * frames * points),
    )


def _pulses(time: np.ndarray, rng: np.random.Generator, count: int, width: float) -> tuple[np.ndarray, ...]:
    """Raised bumps at jittered moments: (count, F) bumps of height 1 and their heights (count,)."""
    moments = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    widths = width * rng.uniform(0.7, 1.5, count)
    bumps = np.exp(-0.5 * ((time - moments[:, None]) / widths[:, None]) ** 2)
    return bumps, rng.uniform(0.6, 1.0, count)


def _activations(frames: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Smooth activation (F,) of every expression over time, 0 to 1; ``jaw_side`` from -1 to 1."""
    time = np.linspace(0.0, 1.0, frames)
    motion: dict[str, np.ndarray] = {}
    for name, count, width in (
        ("jaw", 6, 0.035),
        ("pucker", 6, 0.035),
        ("frown", 5, 0.04),
        ("sneer", 4, 0.03),
    ):
        bumps, heights = _pulses(time, rng, count, width)
        motion[name] = np.tanh(1.5 * heights @ bumps)
    for name, count, width in (("smile", 6, 0.04), ("brow", 6, 0.035), ("puff", 5, 0.035)):
        bumps, heights = _pulses(time, rng, count, width)
        # Faces are not symmetric: each side follows the common pulse with its own strength.
        for side in ("left", "right"):
            own = np.clip(heights + rng.uniform(-0.35, 0.15, count), 0.1, 1.0)
            motion[f"{name}_{side}"] = np.tanh(1.6 * own @ bumps)
    bumps, _ = _pulses(time, rng, 6, 0.014)
    motion["blink"] = np.clip(bumps.sum(axis=0), 0.0, 1.0)
    bumps, heights = _pulses(time, rng, 6, 0.035)
    motion["jaw_side"] = np.tanh(heights * rng.choice([-1.0, 1.0], 6) @ bumps)
    return motion


def _angles(camera: str, frames: int) -> np.ndarray:
    """Yaw, pitch and roll in degrees, (F, 3)."""
    t = np.linspace(0.0, 1.0, frames)
    zero = np.zeros(frames)
    if camera in ("pan30", "pan90"):
        reach = float(camera[3:])
        return np.stack([reach * (2.0 * t - 1.0), zero, zero], axis=1)
    turn = 2.0 * np.pi * t
    if camera == "fast":
        return np.stack(
            [40.0 * np.sin(3.0 * turn + 0.3), 18.0 * np.sin(2.2 * turn + 1.1), 6.0 * np.sin(1.3 * turn)],
            axis=1,
        )
    return np.stack([35.0 * np.sin(0.9 * turn - 0.5), 12.0 * np.sin(0.7 * turn + 0.8), zero], axis=1)


def camera_rotations(camera: str, frames: int) -> np.ndarray:
    """Return the rotations (F, 3, 3), camera from object, of one of :data:`CAMERAS`.

    At rest the object faces the camera. Raises ``OptionError`` for an unknown camera or fewer than 2 frames.
    """
    options = _check(frames, 4, camera, 0.0, 0, 0.0, 0.0, np.float64)
    yaw, pitch, roll = np.radians(_angles(options.camera, options.frames)).T
    rotations = np.zeros((3, options.frames, 3, 3))
    for matrix, angle, (i, j) in zip(rotations, (yaw, pitch, roll), ((2, 0), (1, 2), (0, 1)), strict=True):
        matrix[:] = np.eye(3)
        matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
        matrix[:, j, i] = np.sin(angle)
        matrix[:, i, j] = -np.sin(angle)
    return rotations[2] @ rotations[1] @ rotations[0]


def _sequence(
    name: str, options: _Options, shape: Callable[[int], np.ndarray], faces: np.ndarray, note: str
) -> SyntheticSequence:
    frames, points = options.frames, options.points
    rotations = camera_rotations(options.camera, frames)
    t = np.linspace(0.0, 2.0 * np.pi, frames)
    scales = 1.0 + options.zoom * np.sin(1.1 * t + 0.4)
    middle = IMAGE_SIZE / 2
    translations = np.stack([middle + 14.0 * np.sin(1.7 * t), middle + 9.0 * np.sin(2.3 * t + 1.0)], axis=1)
    shapes = np.empty((frames, points, 3), dtype=options.dtype)
    tracks = np.empty((frames, points, 2), dtype=options.dtype)
    # From y up and z towards the viewer to y down and z away: half a turn about x.
    flip = np.array([[1.0], [-1.0], [-1.0]])
    for f in range(frames):
        shapes[f] = (shape(f) * flip).T
        # Project what is stored, so that the tracks agree with the shapes to the last bit of either dtype.
        seen = scales[f] * (shapes[f] @ rotations[f, :2].T.astype(options.dtype, copy=False))
        tracks[f] = seen + translations[f]
    kind = "scaled orthographic" if options.zoom else "orthographic"
    return SyntheticSequence(
        name=name,
        tracks=add_noise(Tracks(tracks), options.noise, options.seed),
        shapes=shapes,
        rotations=rotations,
        valid=None,
        faces=faces,
        edges=None,
        note={
            "origin": note,
            "units": "pixels of the tracks",
            "camera": f"{kind}; {CAMERAS[options.camera]}",
            "noise": options.noise,
            "seed": options.seed,
            "deformation": options.deformation,
        },
        scales=scales,
        translations=translations,
    )
