"""The reference frame as a template: frames seen through a flow, how alike they are, and the flow that is left.

Images are freed of slow changes of light: local mean and deviation are evened out. What a flow leaves to be
explained is found by dense inverse search (Kroeger, Timofte, Dai, Van Gool: "Fast Optical Flow using Dense Inverse
Search", ECCV 2016; OpenCV's, with its variational refinement) between the reference and the frame warped back onto
it, so that large motion is always small. Likeness is the local correlation, weighted within the mask.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nrsfm.tracking.options import TrackingOptions
from nrsfm.video.libraries import import_cv2

SMOOTH = 0.7  # pixels: deviation of the least smoothing
_PAD = 16  # pixels around the mask
_WINDOW = 4.0  # pixels: deviation of the window of a local correlation
FLOOR = 30.0  # variance of grey levels that counts as no texture
_CONTRAST = 40.0  # grey levels of one deviation after normalisation
_NOISE = 8.0  # grey levels of noise that the least smoothing is for
_AGREE = 1.0  # pixels between forward and backward flow of a believed correction
_SURE = (0.35, 0.75)  # likeness at which trust begins, and is full


def pairwise_flow() -> Any:
    """OpenCV's dense inverse search at half resolution, medium preset."""
    cv2 = import_cv2()

    found = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    found.setFinestScale(1)
    return found


def evened(image: np.ndarray, sigma: float, smooth_by: float = SMOOTH) -> np.ndarray:
    """Return a grey image (H, W), smoothed a little, as uint8 with local mean 128 and local deviation about 40."""
    cv2 = import_cv2()

    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), smooth_by)
    centred = smooth - cv2.GaussianBlur(smooth, (0, 0), sigma)
    deviation = np.sqrt(cv2.GaussianBlur(centred * centred, (0, 0), sigma))
    found: np.ndarray = np.clip(128 + _CONTRAST * centred / (deviation + 4), 0, 255).astype(np.uint8)
    return found


class Template:
    """The reference inside its mask; flows are fields (h, w, 2) float32 over the box around the mask.

    Parameters
    ----------
    frames
        (F, H, W) uint8, evened out.
    mask
        (H, W) bool, where the object is in the reference frame.
    reference
        Its number.
    options
        See :class:`~nrsfm.tracking.options.TrackingOptions`.
    window
        Deviation of the window of a local correlation, pixels.
    """

    def __init__(
        self,
        frames: np.ndarray,
        mask: np.ndarray,
        reference: int,
        options: TrackingOptions,
        window: float = _WINDOW,
    ) -> None:
        self.frames, self.reference, self.options, self.window = frames, reference, options, window
        self.height, self.width = mask.shape
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        self.top, self.left = max(int(rows[0]) - _PAD, 0), max(int(columns[0]) - _PAD, 0)
        box = (slice(self.top, int(rows[-1]) + _PAD + 1), slice(self.left, int(columns[-1]) + _PAD + 1))
        self.inside = np.ascontiguousarray(mask[box])
        self.weight = self.inside.astype(np.float32)
        self.shape = self.inside.shape
        y, x = np.indices(self.shape, dtype=np.float32)
        self._own = np.dstack([x, y])
        self.position = self._own + np.array([self.left, self.top], dtype=np.float32)
        self.image = np.ascontiguousarray(frames[reference][box])
        self.flow = pairwise_flow()
        self._norm = self.blur(self.weight) + 1e-3
        self.centred, self.variance = self.moments(self.image.astype(np.float32))

    def blur(self, image: np.ndarray) -> np.ndarray:
        """Return the sum over the window."""
        cv2 = import_cv2()

        found: np.ndarray = cv2.GaussianBlur(image, (0, 0), self.window, borderType=cv2.BORDER_CONSTANT)
        return found

    def average(self, image: np.ndarray) -> np.ndarray:
        """Return the mean (h, w) over the window, within the mask."""
        found: np.ndarray = self.blur(image * self.weight) / self._norm
        return found

    def moments(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return an image (h, w) less its local mean, and its local variance (h, w)."""
        centred = image - self.blur(image * self.weight) / self._norm
        return centred, self.blur(centred * centred * self.weight) / self._norm

    def sample(self, image: np.ndarray, flow: np.ndarray) -> np.ndarray:
        """Return an image or field of a whole frame as seen at the reference pixels moved by ``flow``."""
        cv2 = import_cv2()

        found: np.ndarray = cv2.remap(
            image, self.position + flow, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return found

    def in_image(self, flow: np.ndarray) -> np.ndarray:
        """Return where (h, w) the reference pixels moved by ``flow`` lie in the image."""
        place = self.position + flow
        found: np.ndarray = ((place >= 0) & (place <= (self.width - 1, self.height - 1))).all(axis=2)
        return found

    def likeness(self, warped: np.ndarray) -> np.ndarray:
        """Return the local correlation (h, w) of a warped frame with the reference, lower where there is no texture."""
        centred, variance = self.moments(warped.astype(np.float32))
        covariance = self.blur(self.centred * centred * self.weight) / self._norm
        found: np.ndarray = covariance / np.sqrt((self.variance + FLOOR) * (variance + FLOOR))
        return found

    def trust(self, likeness: np.ndarray, flow: np.ndarray, sure: tuple[float, float] = _SURE) -> np.ndarray:
        """Return likeness as trust in [0, 1], 0 outside the mask and where ``flow`` leaves the image.

        ``sure`` is the likeness at which trust begins, and at which it is full.
        """
        certain = np.clip((likeness - sure[0]) / (sure[1] - sure[0]), 0, 1)
        found: np.ndarray = certain * self.weight * self.in_image(flow)
        return found

    def seen(self, frame: int, flow: np.ndarray) -> np.ndarray:
        """Return the trust in ``flow`` by what the frame shows there."""
        return self.trust(self.likeness(self.sample(self.frames[frame], flow)), flow)

    def step(self, frame: int, after: int, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return flow from one frame to the next at the points where ``flow`` has come to, and the trust in it."""
        forward = self.flow.calc(self.frames[frame], self.frames[after], None)
        backward = self.flow.calc(self.frames[after], self.frames[frame], None)
        move = self.sample(forward, flow)
        away = np.linalg.norm(move + self.sample(backward, flow + move), axis=2)
        return move, np.exp(-((away / self.options.forward_backward) ** 2))

    def correct(self, frame: int, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``flow`` with what is left to the frame added where that is believed, and the trust in it.

        Believed is what forward and backward flow agree on, what raises the likeness to a fair value, and what is
        not too long.
        """
        cv2 = import_cv2()

        warped = self.sample(self.frames[frame], flow)
        before = self.likeness(warped)
        inner = np.where(self.inside, warped, self.image)
        rest = self.flow.calc(self.image, inner, None)
        back = cv2.remap(
            self.flow.calc(inner, self.image, None),
            self._own + rest,
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        agree = np.linalg.norm(rest + back, axis=2) < _AGREE
        after = self.likeness(self.sample(self.frames[frame], flow + rest))
        believed = agree & (after > before) & (after > 0.5) & (np.linalg.norm(rest, axis=2) < self.options.furthest)
        found = flow + rest * believed[..., None]
        trust = self.trust(np.where(believed, after, before), found) * np.where(agree, 1, 0.3)
        return found, trust.astype(np.float32)


def despeckled(image: np.ndarray) -> np.ndarray:
    """Return a grey image (H, W) float32 in [0, 255] with single pixels that stick out replaced by their median.

    Ours: such a pixel is the brightest or darkest of its 3 × 3 neighbours, and differs from their median by more than
    40 grey levels and more than six deviations of what is usual in the image, so that texture and Gaussian noise stay.
    """
    cv2 = import_cv2()

    median = cv2.medianBlur(image.astype(np.float32), 3)
    away = np.abs(image - median)
    usual = 1.4826 * float(np.median(away))
    square = np.ones((3, 3), dtype=np.uint8)
    extreme = (image >= cv2.dilate(image, square)) | (image <= cv2.erode(image, square))
    found: np.ndarray = np.where(extreme & (away > max(40.0, 6 * usual)), median, image)
    return found


def noise_level(image: np.ndarray) -> float:
    """Return the deviation of white noise in a grey image (H, W), grey levels.

    From the differences that a constant and a slope do not have (Immerkær: "Fast Noise Variance Estimation", Computer
    Vision and Image Understanding 64, 1996), by their median.
    """
    cv2 = import_cv2()

    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6
    return 1.4826 * float(np.median(np.abs(cv2.filter2D(image.astype(np.float32), -1, kernel))))


def smoothing(least: float, noise: float) -> float:
    """Return the deviation of the smoothing in pixels that suits noise of a deviation in grey levels. Ours."""
    return float(np.clip(least * np.sqrt(noise / _NOISE), least, 2.0))
