"""A rendered video with its truth as files: for trying out, and for comparing trackers (ours).

``video.mp4``, or with every bit kept ``frames/0000.png`` ...; ``masks/0000.png`` ..., white where the object is; and
``truth.npz``, whose arrays have the names that :func:`nrsfm.load_tracks`, ``load_shapes`` and ``load_rotations`` read,
so that it also serves as a file of perfect tracks. Shapes before an orthographic camera are in pixels of the reference
frame.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from nrsfm.datasets.rendering import RenderedSequence
from nrsfm.errors import InputError, OptionError
from nrsfm.files.atomic import atomic_folder
from nrsfm.progress import Report, silent
from nrsfm.video.libraries import import_cv2
from nrsfm.video.writing import write_video

VIDEO, FRAMES, MASKS, TRUTH = "video.mp4", "frames", "masks", "truth.npz"


def save_rendered(
    made: RenderedSequence,
    folder: str | os.PathLike[str],
    *,
    step: int = 2,
    fps: float = 30.0,
    lossless: bool = False,
    overwrite: bool = False,
    report: Report = silent,
) -> Path:
    """Write a rendered video, its masks and its truth; the folder appears whole or not at all. Returns the video.

    Parameters
    ----------
    made
        From :func:`~nrsfm.datasets.rendering.rendered`.
    folder
        To make.
    step
        Pixels between the points of the truth, in the reference frame.
    fps
        Frames a second of the video.
    lossless
        PNG images in place of a video, which changes them a little.
    overwrite
        Replace an earlier output of this function.

    Raises
    ------
    OptionError
        ``step`` is below 1.
    InputError
        No pixel of the object lies on the grid of that step.
    FileError
        The folder holds something else or cannot be written.
    """
    if isinstance(step, bool) or int(step) != step or step < 1:
        raise OptionError(f"step must be a whole number of at least 1, received {step!r}")
    cv2 = import_cv2()
    kept = np.flatnonzero((made.queries % step == 0).all(axis=1))
    if not len(kept):
        raise InputError(f"step: at least one pixel of the object must be on the grid, received {step}")
    frames, height, width = made.masks.shape
    with atomic_folder(folder, overwrite=overwrite, replaceable=(VIDEO, FRAMES, MASKS, TRUTH)) as aside:
        (aside / MASKS).mkdir()
        if lossless:
            (aside / FRAMES).mkdir()
        else:
            report("writing the video", None)
            write_video(aside / VIDEO, made.images, fps=fps)
        for f in range(frames):
            _write_png(cv2, aside / MASKS / f"{f:04d}.png", made.masks[f].astype(np.uint8) * 255)
            if lossless:
                _write_png(cv2, aside / FRAMES / f"{f:04d}.png", made.images[f][..., ::-1])
            report("writing images", (f + 1) / frames)
        report("writing the truth", None)
        np.savez(
            aside / TRUTH,
            tracks=made.tracks[:, kept],
            visible=made.visible[:, kept],
            shapes=made.query_shapes(kept) * np.float32(1.0 if made.scene.focal else made.scene.scales[made.reference]),
            rotations=made.rotations,
            pixels=made.queries[kept],
            reference=np.array(made.reference),
            image_size=np.array([width, height]),
        )
    return Path(folder) / (FRAMES if lossless else VIDEO)


def _write_png(cv2: object, path: Path, image: np.ndarray) -> None:
    # cv2.imwrite knows no names outside of the system's code page.
    good, data = cv2.imencode(".png", np.ascontiguousarray(image))  # type: ignore[attr-defined]
    if not good:
        raise InputError(f"'{path}': the image could not be encoded")
    path.write_bytes(data.tobytes())
