"""Small videos with known content."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("av", reason="videos need the extra [video]")
pytest.importorskip("cv2", reason="videos need the extra [video]")


def scene(seed: int, height: int = 90, width: int = 120, frames: int = 24, speed: float = 1.5) -> list[np.ndarray]:
    """A textured disc that moves and grows before a textured ground."""
    from nrsfm.datasets.render_textures import noise

    rng = np.random.default_rng(seed)
    ground = 110 + 40 * noise((height, width), rng, power=1.2)
    skin = 140 + 45 * noise((height, width), rng, power=1.0)
    y, x = np.mgrid[:height, :width]
    images = []
    for f in range(frames):
        inside = np.hypot(x - 30 - speed * f, y - 40 - 4 * np.sin(f / 3)) < 18 + 0.2 * f
        grey = np.where(inside, np.roll(skin, round(speed * f), axis=1), ground)
        colour = grey[..., None] * np.array([1.0, 0.9, 0.8])
        images.append(np.clip(colour, 0, 255).astype(np.uint8))
    return images


@pytest.fixture(scope="session")
def images() -> list[np.ndarray]:
    return scene(0)


@pytest.fixture(scope="session")
def video(tmp_path_factory: pytest.TempPathFactory, images: list[np.ndarray]) -> Path:
    """Lossless, under a name with a space and a letter outside ASCII."""
    from nrsfm.video import write_video

    path = tmp_path_factory.mktemp("videos") / "ein schönes Video.mkv"
    write_video(path, images, lossless=True)
    return path
