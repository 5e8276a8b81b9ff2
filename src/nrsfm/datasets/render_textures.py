"""Procedural textures for the test renderer: reflectances with the spectrum of real surfaces.

Ours. Natural images have amplitude spectra near 1/f (Field, "Relations between the statistics of natural images
and the response properties of cortical cells", JOSA A 4(12), 1987); skin adds freckles and pores, cloth a weave and
a print. Every texture has zones with almost no detail, where optical flow has little to hold on to. Values are
linear reflectances in (0, 1), RGB, float32.
"""

from __future__ import annotations

import numpy as np

KINDS = ("skin", "cloth", "print")


def noise(shape: tuple[int, int], rng: np.random.Generator, *, power: float = 1.0, finest: float = 2.0) -> np.ndarray:
    """Return periodic noise (H, W) float32 of mean 0 and deviation 1 with amplitude spectrum 1/f**power.

    ``finest`` is the shortest wavelength in texels that is left at half its amplitude.
    """
    height, width = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None])
    frequency[0, 0] = 1.0
    amplitude = frequency**-power * np.exp2(-((frequency * finest) ** 2))
    amplitude[0, 0] = 0.0
    spectrum = np.fft.rfft2(rng.standard_normal(shape)) * amplitude
    field = np.fft.irfft2(spectrum, s=shape)
    return (field / field.std()).astype(np.float32)


def _spots(shape: tuple[int, int], rng: np.random.Generator, count: int, radii: tuple[float, float]) -> np.ndarray:
    """Soft round spots of random place, size and strength, (H, W) float32 in [0, 1)."""
    height, width = shape
    clear = np.ones(shape, dtype=np.float32)
    for _ in range(count):
        radius = float(np.exp(rng.uniform(*np.log(radii))))
        reach = int(np.ceil(3 * radius))
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        rows = np.arange(int(y) - reach, int(y) + reach + 1)
        columns = np.arange(int(x) - reach, int(x) + reach + 1)
        blob = np.exp(-0.5 * (((rows - y) / radius) ** 2)[:, None] - 0.5 * (((columns - x) / radius) ** 2)[None])
        clear[np.ix_(rows % height, columns % width)] *= 1 - float(rng.uniform(0.15, 0.6)) * blob.astype(np.float32)
    return 1 - clear


def weak_zones(shape: tuple[int, int], rng: np.random.Generator, *, share: float = 0.3) -> np.ndarray:
    """Return a smooth factor (H, W) in [0.1, 1]: about ``share`` of the surface has hardly any detail."""
    field = noise(shape, rng, power=2.2, finest=min(shape) / 8)
    level = np.quantile(field, share)
    return (0.1 + 0.9 / (1 + np.exp(-(field - level) / 0.12))).astype(np.float32)


def texture(kind: str, shape: tuple[int, int], seed: int, *, texels: float = 2.0) -> np.ndarray:
    """Return a texture (H, W, 3) float32 of one of :data:`KINDS`; it repeats without seams.

    ``texels`` is the number of texels per pixel of the reference image: nothing finer than about 2 pixels is
    drawn, so that the image can show it.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    calm = weak_zones(shape, rng)
    finest = 2.2 * texels
    fine = noise(shape, rng, power=1.0, finest=finest)
    pores = noise(shape, rng, power=0.4, finest=1.5 * texels)
    tint = noise(shape, rng, power=2.0, finest=16 * texels)
    area = shape[0] * shape[1] / texels**2
    if kind == "skin":
        freckles = _spots(shape, rng, int(area / 450), (0.8 * texels, 3.0 * texels))
        marks = _spots(shape, rng, int(area / 9000), (3 * texels, 8 * texels))
        light = np.exp(calm * (0.10 * fine + 0.05 * pores) + 0.05 * tint) * (1 - calm * 0.6 * freckles)
        base = np.array([0.56, 0.33, 0.24], dtype=np.float32)
        chroma = np.stack([0.02 * tint, -0.05 * tint - 0.3 * marks, -0.05 * tint - 0.25 * marks], axis=2)
        return np.clip(base * light[..., None] * np.exp(chroma), 0.01, 0.98)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    if kind == "cloth":
        # A weave of about 4 pixels whose phase wanders, so that it does not repeat exactly.
        period = 4.5 * texels
        wander = 0.6 * noise(shape, rng, power=2.0, finest=20 * texels)
        weave = np.sin(2 * np.pi * rows / period + wander) * np.sin(2 * np.pi * columns / period - wander)
        light = np.exp(calm * (0.16 * fine + 0.05 * weave.astype(np.float32)) + 0.06 * tint)
        base = np.array([0.30, 0.36, 0.48], dtype=np.float32)
        chroma = 0.12 * tint[..., None] * np.array([1.0, 0.0, -1.0], dtype=np.float32)
        return np.clip(base * light[..., None] * np.exp(chroma), 0.01, 0.98)
    # A print: a few inks in soft-edged patches, plain ground between them.
    patches = noise(shape, rng, power=1.8, finest=6 * texels)
    inks = np.array([[0.62, 0.58, 0.50], [0.50, 0.10, 0.09], [0.10, 0.16, 0.40], [0.60, 0.42, 0.12]], dtype=np.float32)
    edges = np.quantile(patches, (0.45, 0.65, 0.85))
    colour = np.broadcast_to(inks[0], (*shape, 3)).copy()
    for level, ink in zip(edges, inks[1:], strict=True):
        share = 1 / (1 + np.exp(np.clip(-(patches - level) / 0.02, -60, 60)))
        colour += share[..., None] * (ink - colour)
    return np.clip(colour * np.exp(calm * (0.13 * fine + 0.04 * pores))[..., None], 0.01, 0.98).astype(np.float32)


def background(shape: tuple[int, int], seed: int) -> np.ndarray:
    """Return what stands behind the object, (H, W, 3) float32: a blurred room, with some detail in it."""
    rng = np.random.default_rng([seed, 99])
    coarse = noise(shape, rng, power=1.6, finest=10)
    fine = noise(shape, rng, power=1.0, finest=4)
    tint = noise(shape, rng, power=2.0, finest=40)
    light = 0.22 * np.exp(0.35 * coarse + 0.08 * fine)
    colour = light[..., None] * np.exp(0.15 * tint[..., None] * np.array([1.0, 0.1, -1.0], dtype=np.float32))
    return np.clip(colour, 0.01, 0.95).astype(np.float32)
