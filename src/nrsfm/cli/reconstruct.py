"""``nrsfm reconstruct``: a file of tracks to an output folder with shapes, cameras, scores and pictures."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli import running
from nrsfm.cli.arguments import Parser
from nrsfm.cli.inputs import Inputs
from nrsfm.cli.scores import FRAMES_OF_TRUTH, Truth
from nrsfm.progress import Report
from nrsfm.stages.digest import digest

if TYPE_CHECKING:
    from nrsfm.tracks import Tracks


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm reconstruct",
        usage="nrsfm reconstruct TRACKS --out DIR [--method M] [options]",
        description="Reconstruct the 3D shape of every frame, and the cameras, from 2D point tracks.",
    )
    parser.add_argument("tracks", metavar="TRACKS", help="file of tracks: .npz .npy .mat .h5 .zarr .csv")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to make")
    add_reading(parser)
    parser.add_argument(
        "--image-size", type=image_size, metavar="WxH", help="pixels, for coordinates relative to the image"
    )
    parser.add_argument("--cameras", metavar="FILE", help="file with known rotations [default: estimated]")
    add_truth(parser, "--truth", metavar="FILE", help="file with the true shapes, to score against")
    given, job = running.parse(parser, words)

    def load(report: Report) -> Inputs:
        from nrsfm.files import load_rotations

        report("reading files", None)
        tracks = read_tracks(given.tracks, given)
        record: dict[str, Any] = {
            "tracks": digest(given.tracks)
            | {"frames": tracks.n_frames, "points": tracks.n_points, "missing": tracks.n_missing},
            "cameras": digest(given.cameras) if given.cameras else "estimated",
            "truth": digest(given.truth) if given.truth else None,
        }
        aids = drawing_aids(given.tracks)
        return Inputs(
            tracks=tracks,
            rotations=load_rotations(given.cameras) if given.cameras else None,
            truth=load_truth(given.truth, given.truth_frame) if given.truth else None,
            record=record,
            mesh=aids.get("faces"),
            **(aids | drawing_aids(given.truth)),
        )

    return running.run("reconstruct", job, load)


def add_reading(parser: Parser) -> None:
    """Add the arguments that say how a file is to be read, where it does not say so itself."""
    from nrsfm.files import ORDERS
    from nrsfm.files.trackers import TRACKERS

    parser.add_argument("--order", choices=ORDERS, help="layout of the array, if its name does not say")
    parser.add_argument("--array", metavar="NAME", help="the array to read, if the file has several")
    parser.add_argument("--tracker", choices=TRACKERS, help="the tracks are as this point tracker writes them")
    parser.add_argument(
        "--seen-size",
        type=image_size,
        metavar="WxH",
        help="pixels of the image that the tracker saw, if it was resized",
    )


def read_tracks(path: str, asked: argparse.Namespace) -> Tracks:
    """Read tracks as the arguments of :func:`add_reading`, and ``image_size`` where there is such, say."""
    from nrsfm.files import load_tracks

    return load_tracks(
        path,
        order=asked.order,
        name=asked.array,
        image_size=getattr(asked, "image_size", None),
        tracker=asked.tracker,
        seen_size=asked.seen_size,
    )


def image_size(text: str) -> tuple[float, float]:
    """Return (width, height) of a text such as ``640x480``."""
    width, _, height = text.partition("x")
    try:
        return float(width), float(height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"WIDTHxHEIGHT is needed, received {text!r}") from None


def add_truth(parser: Parser, name: str, **settings: Any) -> None:
    """Add the argument for a file of true shapes and the one for the frame that they are in."""
    parser.add_argument(name, **settings)
    parser.add_argument(
        "--truth-frame",
        choices=FRAMES_OF_TRUTH,
        default="object",
        help="the true shapes are in the object's frame, or in the camera's of each frame [default: object]",
    )


def drawing_aids(*paths: str | None) -> dict[str, Any]:
    """Return the triangles ``faces`` and the lines ``edges`` between points that a file brings along."""
    from nrsfm.files.container import open_arrays

    found: dict[str, Any] = {}
    for path in paths:
        # MATLAB counts from 1, and nothing in such a file says whether its indices do.
        if path is None or Path(path).suffix.lower() == ".mat":
            continue
        entries = open_arrays(path)
        found |= {name: entries[name].read() for name in ("faces", "edges") if name in entries}
    return found


def load_truth(path: str, frame: str) -> Truth:
    """Read true shapes, and the true cameras if the same file has them."""
    from nrsfm.errors import FileError
    from nrsfm.files import load_rotations, load_shapes

    truth = load_shapes(path)
    try:
        rotations = load_rotations(path)
    except FileError as error:  # a truth without cameras is usual
        logging.getLogger(__name__).info("no true cameras: %s", error)
        rotations = None
    return Truth(truth.shapes, truth.valid, rotations, frame)
