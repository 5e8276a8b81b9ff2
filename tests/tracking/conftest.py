"""Images that move as is known."""

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")


def textured(size: int, seed: int) -> np.ndarray:
    """Texture of three widths (size, size), its deviation arbitrary."""
    rng = np.random.default_rng(seed)
    return sum(cv2.GaussianBlur(rng.standard_normal((size, size)).astype(np.float32), (0, 0), s) * s for s in (1, 2, 4))


def warped(texture: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The image whose reference pixel x has come to x + u(x): inverse by fixed-point iteration."""
    height, width = motion.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    back = np.zeros_like(motion)
    for _ in range(30):
        back = -cv2.remap(motion, x + back[..., 0], y + back[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return cv2.remap(texture, x + back[..., 0], y + back[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
