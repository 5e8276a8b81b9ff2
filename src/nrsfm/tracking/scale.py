"""The size at which images are matched: small objects can be enlarged.

Ours. Windows, patches, the smoothing and the grid of coefficients are so many pixels wide. On an object of few pixels
they cover much of it: motion inside a window differs, and is averaged. So the images can be enlarged first, up to
twice, and everything that is found is brought back to the video's own pixels. The other way about, less of the object
is in a window: where texture is smooth, as on plain cloth, that loses more than it gains, so it is not done unasked.
"""

from __future__ import annotations

import numpy as np

from nrsfm.video.libraries import import_cv2

LARGEST = 2.0  # beyond that interpolation has nothing to add


class Scale:
    """From the video's pixels to those in which it is matched, and back.

    Parameters
    ----------
    mask
        (H, W) bool, where the object is in the reference frame.
    size
        Square root of the object's area, in pixels, up to which it is enlarged; 0 never enlarges.
    """

    def __init__(self, mask: np.ndarray, size: float) -> None:
        height, width = mask.shape
        wanted = float(np.clip(size / np.sqrt(np.count_nonzero(mask)), 1.0, LARGEST))
        self.shape = (round(wanted * height), round(wanted * width))
        self.factors = np.array([self.shape[1] / width, self.shape[0] / height], dtype=np.float32)
        """(2,): of x and y; they differ by rounding."""
        self.factor = float(np.sqrt(self.factors[0] * self.factors[1]))

    def enlarged(self, image: np.ndarray) -> np.ndarray:
        """Return an image (H, W) float32 as it is matched."""
        if self.shape == image.shape:
            return image
        cv2 = import_cv2()
        found: np.ndarray = cv2.resize(image, self.shape[::-1], interpolation=cv2.INTER_CUBIC)
        return found

    def enlarged_mask(self, mask: np.ndarray) -> np.ndarray:
        """Return a mask (H, W) as it is matched."""
        if self.shape == mask.shape:
            return mask
        cv2 = import_cv2()
        found: np.ndarray = cv2.resize(mask.astype(np.uint8), self.shape[::-1], interpolation=cv2.INTER_NEAREST)
        return found.astype(bool)

    def places(self, pixels: np.ndarray) -> np.ndarray:
        """Return where positions (..., 2) of the video lie in the images that are matched: centres at whole numbers."""
        found: np.ndarray = (pixels.astype(np.float32) + 0.5) * self.factors - 0.5
        return found


class Sampler:
    """Values at points of the video's grid, from fields over the box of a template.

    Parameters
    ----------
    scale
        Of the images that the template has.
    pixels
        (P, 2) whole x, y in the video, row by row.
    corner
        (left, top) of the template's box in the images that are matched.
    """

    def __init__(self, scale: Scale, pixels: np.ndarray, corner: tuple[int, int]) -> None:
        low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
        self._map = scale.places(np.stack([x, y], axis=-1)) - np.array(corner, dtype=np.float32)
        self._at = (pixels[:, 1] - low[1], pixels[:, 0] - low[0])

    def __call__(self, field: np.ndarray) -> np.ndarray:
        """Return (P,) or (P, n) of a field (h, w) or (h, w, n); the nearest value where it is bool."""
        cv2 = import_cv2()
        way = cv2.INTER_NEAREST if field.dtype == np.bool_ else cv2.INTER_LINEAR
        plain = field.astype(np.uint8) if field.dtype == np.bool_ else field.astype(np.float32)
        found: np.ndarray = cv2.remap(plain, self._map, None, way, borderMode=cv2.BORDER_REPLICATE)[self._at]
        return found.astype(bool) if field.dtype == np.bool_ else found
