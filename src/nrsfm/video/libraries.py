"""The optional libraries of video input, imported when used."""

from __future__ import annotations

from typing import Any

from nrsfm.errors import InputError


def import_av() -> Any:
    """Return PyAV, silenced: what FFmpeg has to say becomes this package's errors.

    Raises ``InputError`` where it is not installed.
    """
    try:
        import av
        import av.logging
    except ImportError as error:
        raise InputError("videos need PyAV: pip install 'nrsfm[video]'") from error
    av.logging.set_level(None)
    return av


def import_cv2() -> Any:
    """Return OpenCV. Raises ``InputError`` where it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise InputError("videos need OpenCV: pip install 'nrsfm[video]'") from error
    return cv2
