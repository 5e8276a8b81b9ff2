"""What a real camera does to an image: light that changes, blur, noise, 8 bits. And what stands in the way.

Ours. Images are linear light, float32, until :func:`develop`. Per-frame changes are smooth functions of time with
seeded phases, so that neighbouring frames resemble each other as in a video.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from nrsfm.errors import OptionError, suggest

VARIANTS = {
    "plain": "texture alone: no shading, blur or noise",
    "realistic": "moving light, gloss, gain and gamma drift, motion and defocus blur, sensor noise",
    "discs": "two discs pass in front of the object",
    "gaussian": "Gaussian noise of standard deviation 0.2 of the range on every frame",
    "salt-and-pepper": "a tenth of the pixels black or white in every frame",
}
"""What ``variant`` may name; several are joined by ``+``, as in ``"realistic+discs"``."""


@dataclasses.dataclass(frozen=True)
class Effects:
    """How frames are lit and taken.

    Attributes
    ----------
    shading
        Lambert's law with ambient light and a little gloss; without it every sample shows its reflectance.
    light
        How far the light wanders, radians; gain drifts by 0.3 and gamma by 0.1 of this.
    shutter
        Share of the time between frames during which the shutter is open: length of the motion blur.
    defocus
        (least, most) standard deviation of the defocus in pixels, between which it breathes.
    read_noise, shot_noise
        Standard deviation in linear light is sqrt(read² + shot² · light).
    gaussian, impulses
        Noise after development: standard deviation relative to the range, and share of pixels hit.
    discs
        Number of discs that pass in front.
    disc_radius
        Their radius, relative to the image's shorter side.
    """

    shading: bool = False
    light: float = 0.0
    shutter: float = 0.0
    defocus: tuple[float, float] = (0.0, 0.0)
    read_noise: float = 0.0
    shot_noise: float = 0.0
    gaussian: float = 0.0
    impulses: float = 0.0
    discs: int = 0
    disc_radius: float = 0.08


_PARTS: dict[str, dict[str, object]] = {
    "plain": {},
    "realistic": {
        "shading": True,
        "light": 0.45,
        "shutter": 0.4,
        "defocus": (0.35, 0.9),
        "read_noise": 0.004,
        "shot_noise": 0.018,
    },
    "discs": {"discs": 2},
    "gaussian": {"gaussian": 0.2},
    "salt-and-pepper": {"impulses": 0.1},
}


def effects(variant: str) -> Effects:
    """Return the effects of a variant. Raises ``OptionError`` for one that is not in :data:`VARIANTS`."""
    chosen: dict[str, object] = {}
    for part in variant.split("+"):
        if part not in _PARTS:
            raise OptionError(
                f"variant must be one of {', '.join(VARIANTS)}, or several joined by +, received {variant!r}"
                f"{suggest(part, VARIANTS)}"
            )
        chosen.update(_PARTS[part])
    return dataclasses.replace(Effects(), **chosen)  # type: ignore[arg-type]  # the keys are the fields' names


@dataclasses.dataclass(frozen=True, eq=False)
class Conditions:
    """What changes from frame to frame: ``light`` (F, 3) unit vectors towards the light, the rest (F,)."""

    light: np.ndarray
    gain: np.ndarray
    gamma: np.ndarray
    defocus: np.ndarray


def conditions(frames: int, chosen: Effects, rng: np.random.Generator) -> Conditions:
    """Draw smooth changes over time."""
    time = np.linspace(0, 1, frames)

    def drift() -> np.ndarray:
        phase, rate = rng.uniform(0, 2 * np.pi, 2), rng.uniform((0.6, 1.6), (1.4, 3.0))
        wave: np.ndarray = np.sin(2 * np.pi * rate[0] * time + phase[0]) + 0.4 * np.sin(
            2 * np.pi * rate[1] * time + phase[1]
        )
        return wave / 1.4

    across, above = -0.5 + chosen.light * drift(), -0.6 + 0.6 * chosen.light * drift()
    light = np.stack([np.sin(across), np.sin(above), -np.cos(across) * np.cos(above)], axis=1)
    least, most = chosen.defocus
    return Conditions(
        light=light / np.linalg.norm(light, axis=1, keepdims=True),
        gain=1 + 0.3 * chosen.light * drift(),
        gamma=1 + 0.1 * chosen.light * drift(),
        defocus=least + (most - least) * (0.5 + 0.5 * drift()),
    )


def shade(normals: np.ndarray, light: np.ndarray, view: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return what a surface reflects per unit of reflectance, and its gloss, (P,) float32 each.

    ``normals`` (P, 3) are unit, camera frame (z away from the camera) and turned towards the camera. Ambient light
    is a quarter of the whole; the gloss is a Blinn lobe of exponent 24 and height 0.06.
    """
    towards = np.array([0.0, 0.0, -1.0]) if view is None else view
    half = light + towards
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    diffuse = 0.35 + 0.9 * np.maximum(normals @ light, 0)
    gloss = 0.06 * np.maximum(np.einsum("pk,...k->p", normals, half), 0) ** 24
    return diffuse.astype(np.float32), gloss.astype(np.float32)


def motion_blur(layer: np.ndarray, velocity: np.ndarray, shutter: float, samples: int = 5) -> np.ndarray:
    """Return (H, W, C) averaged along each pixel's motion (H, W, 2) during the exposure, centred on its middle.

    ``velocity`` is in pixels per frame, premultiplied like ``layer``, whose last channel is the coverage: around
    the object the motion of its rim is used, so that the rim itself is blurred.
    """
    import cv2

    coverage = layer[..., 3]
    weight = cv2.boxFilter(coverage, -1, (9, 9))
    motion = cv2.boxFilter(velocity, -1, (9, 9)) / np.maximum(weight, 1e-3)[..., None]
    solid = coverage > 0.5
    motion[solid] = velocity[solid] / coverage[solid, None]
    height, width = coverage.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    total = np.zeros_like(layer)
    for part in (np.arange(samples) + 0.5) / samples - 0.5:
        shift = np.float32(part * shutter)
        total += cv2.remap(layer, x - shift * motion[..., 0], y - shift * motion[..., 1], cv2.INTER_LINEAR)
    return total / samples


def defocus(layer: np.ndarray, sigma: float) -> np.ndarray:
    """Return (H, W, C) under a Gaussian of standard deviation ``sigma`` pixels."""
    if sigma <= 0:
        return layer
    import cv2

    blurred: np.ndarray = cv2.GaussianBlur(layer, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return blurred


def develop(image: np.ndarray, chosen: Effects, gain: float, gamma: float, rng: np.random.Generator) -> np.ndarray:
    """Return 8-bit RGB (H, W, 3): gain, shot and read noise, gamma 1/2.2 with drift, noise of the variant."""
    image = image * np.float32(gain)
    if chosen.read_noise or chosen.shot_noise:
        spread = np.sqrt(chosen.read_noise**2 + chosen.shot_noise**2 * np.maximum(image, 0))
        image = image + spread * rng.standard_normal(image.shape, dtype=np.float32)
    shown = np.clip(image, 0, 1) ** np.float32(gamma / 2.2)
    if chosen.gaussian:
        shown = shown + chosen.gaussian * rng.standard_normal(shown.shape, dtype=np.float32)
    if chosen.impulses:
        drawn = rng.random(shown.shape[:2])
        shown[drawn < chosen.impulses] = 1.0
        shown[drawn < chosen.impulses / 2] = 0.0
    quantised: np.ndarray = np.clip(shown * 255 + 0.5, 0, 255).astype(np.uint8)
    return quantised


def disc_paths(frames: int, count: int, radius: float, width: int, height: int, rng: np.random.Generator) -> np.ndarray:
    """Return discs (F, count, 3): x, y and radius in pixels, circling about the middle of the image."""
    start = rng.uniform(0, 2 * np.pi)
    angle = start + 2 * np.pi * (np.arange(count) / max(count, 1) + 0.9 * np.linspace(0, 1, frames)[:, None])
    discs = np.empty((frames, count, 3))
    discs[..., 0] = (width - 1) / 2 + 0.24 * width * np.cos(angle)
    discs[..., 1] = (height - 1) / 2 + 0.24 * height * np.sin(angle)
    discs[..., 2] = radius * min(width, height)
    return discs


def inside_discs(points: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Return which points (..., 2) lie in one of the discs (count, 3), border included."""
    covered = np.zeros(points.shape[:-1], dtype=bool)
    for x, y, radius in discs:
        covered |= (points[..., 0] - x) ** 2 + (points[..., 1] - y) ** 2 <= radius**2
    return covered


def paint_discs(image: np.ndarray, discs: np.ndarray, surface: np.ndarray, sigma: float) -> np.ndarray:
    """Return the image with discs over it, which carry their own texture ``surface`` (H, W, 3) along."""
    height, width = image.shape[:2]
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    for number, (at_x, at_y, radius) in enumerate(discs):
        # Over one pixel the edge goes from covered to clear; defocus widens it.
        away = np.hypot(x - at_x, y - at_y)
        cover = np.clip((radius - away) / (1 + 2 * sigma) + 0.5, 0, 1).astype(np.float32)[..., None]
        shift = (round(at_y) + 97 * number, round(at_x) + 31 * number)
        image = image + cover * (np.roll(surface, shift, axis=(0, 1))[:height, :width] - image)
    return image
