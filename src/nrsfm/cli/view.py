"""``nrsfm view``: a reconstruction in the browser, to be played, turned and coloured."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.reconstruct import add_reading, add_truth, drawing_aids, read_tracks
from nrsfm.errors import FileError, InputError, NrsfmError, OptionError

if TYPE_CHECKING:
    import numpy as np

    from nrsfm.reconstruction import Reconstruction

_RECONSTRUCTION = "reconstruction.npz"
_FEWEST = 400  # points: below, triangles found by themselves are hardly a surface
_COLOURS = ("colours", "colors")


def run(words: Sequence[str]) -> int:
    """Run the verb until Ctrl-C, and return the exit code."""
    parser = Parser(
        prog="nrsfm view",
        usage="nrsfm view RECONSTRUCTION [--tracks FILE] [--truth FILE] [--images FOLDER|VIDEO] [options]",
        description="Show a reconstruction in the browser, on this machine only: play, turn, colour, compare with the\n"
        "input and the truth. Open the address that is printed; Ctrl-C ends it.",
    )
    parser.add_argument(
        "reconstruction", metavar="RECONSTRUCTION", help="reconstruction.npz, or the folder of a run that holds it"
    )
    parser.add_argument("--tracks", metavar="FILE", help="the tracks it was made from, to draw over the input")
    add_reading(parser)
    add_truth(parser, "--truth", metavar="FILE", help="file with the true shapes, to colour by error")
    parser.add_argument("--images", metavar="PATH", help="the input: a video, or a folder of images, a frame each")
    parser.add_argument("--port", type=int, metavar="N", help="[default: 8090, or the next free one; 0: any]")
    add_showing(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress")
    given = parser.parse_strictly(words, _explain)
    check_fps(given.fps)

    from nrsfm.numerics.threads import single_thread
    from nrsfm.progress import TerminalProgress, silent
    from nrsfm.viewing.viewer import ViewServer

    with single_thread(), TerminalProgress() as line:
        content = _content(given, silent if given.quiet else line)
    try:
        with ViewServer(content, port=given.port) as server:
            print(f"nrsfm: view at {server.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
            server.wait()
    except KeyboardInterrupt:  # that is how it is meant to end
        print("nrsfm: view ended", file=sys.stderr)
    return 0


def _explain(flag: str) -> str | None:
    return "the viewer serves this machine only, at 127.0.0.1" if flag in ("--host", "--bind", "--share") else None


def _content(given: Any, report: Any) -> Any:
    from nrsfm.reconstruction import load_reconstruction
    from nrsfm.viewing.viewer import make_content, open_pictures

    source = Path(given.reconstruction)
    if source.is_dir():
        source /= _RECONSTRUCTION
    report("reading files", None)
    result = load_reconstruction(source)
    tracks = read_tracks(given.tracks, given) if given.tracks else None
    truth, valid = _truth(given, result)
    aids = drawing_aids(given.tracks, given.truth)
    pictures = open_pictures(given.images, result.n_frames, report=report) if given.images else None
    report("finding the surface", None)
    faces, surface, warnings = shown_faces(given.faces, aids.get("faces"), aids.get("edges"), result)
    report("colouring", None)
    return make_content(
        result,
        title=source.parent.resolve().name if source.name == _RECONSTRUCTION else source.stem,
        fps=given.fps,
        tracks=tracks,
        truth=truth,
        valid=valid,
        pictures=pictures,
        faces=faces,
        edges=shown_edges(aids.get("edges"), result),
        colours=given_colours(given.tracks, given.truth),
        surface=surface,
        warnings=warnings,
    )


def _truth(given: Any, result: Reconstruction) -> tuple[np.ndarray | None, np.ndarray | None]:
    from nrsfm.files import load_shapes

    if not given.truth:
        return None, None
    truth = load_shapes(given.truth)
    if truth.shapes.shape[:2] != (result.n_frames, result.n_points):
        received = "{} frames of {} points".format(*truth.shapes.shape[:2])
        raise InputError(
            f"'{given.truth}': {result.n_frames} frames of {result.n_points} points are needed, as the reconstruction "
            f"has, received {received}"
        )
    return truth.shapes, truth.valid


def add_showing(parser: Parser) -> None:
    """What is shown of the shapes, and how fast."""
    parser.add_argument(
        "--faces",
        metavar="FACES",
        help="none, auto, grid:ROWSxCOLS, or a file with faces [default: those of tracks or truth, or auto]",
    )
    parser.add_argument("--fps", type=float, default=30.0, metavar="X", help="frames a second [default: 30]")


def check_fps(fps: float) -> None:
    """Refuse what no player can keep up with."""
    if not (math.isfinite(fps) and 0 < fps <= 1000):
        raise OptionError(f"option '--fps' must be greater than 0 and at most 1000, received {fps:g}")


def shown_faces(
    asked: str | None, came: Any, edges: Any, result: Reconstruction
) -> tuple[np.ndarray | None, str, tuple[str, ...]]:
    """Triangles, where they come from, and what to know; unasked, what cannot be a surface is shown as points."""
    from nrsfm.export.surfaces import find_surface

    if asked is not None:
        surface = find_surface(asked, result)
    elif came is not None:
        surface = find_surface(came, result)
        if surface is not None:
            return surface.faces, "the faces that came with the files", surface.warnings
    elif edges is not None or result.n_points - result.n_missing < _FEWEST:
        return None, "", ()
    else:
        try:
            surface = find_surface("auto", result)
        except NrsfmError:
            return None, "", ()
        if surface is None or surface.warnings:
            return None, "", ()
    return (None, "", ()) if surface is None else (surface.faces, surface.origin, surface.warnings)


def shown_edges(edges: Any, result: Reconstruction) -> np.ndarray | None:
    """Lines (E, 2) between points, checked; ``None`` where there are none."""
    import numpy as np

    if edges is None:
        return None
    lines = np.asarray(edges)
    if lines.ndim != 2 or lines.shape[1] != 2 or lines.dtype.kind not in "iu":
        raise InputError(f"edges: integers of shape (n, 2) are needed, received {lines.dtype} {lines.shape}")
    if lines.size and (lines.min() < 0 or lines.max() >= result.n_points):
        raise InputError(f"edges: point numbers from 0 to {result.n_points - 1} are needed, received {lines.max()}")
    return lines if lines.size else None


def given_colours(*paths: str | None) -> np.ndarray | None:
    """The array of colours that a file brings along, the first of them."""
    from nrsfm.files.container import open_arrays

    for path in paths:
        if path is None:
            continue
        entries = open_arrays(path)
        for name in _COLOURS:
            if name in entries:
                try:
                    return entries[name].read()
                except FileError as error:
                    raise FileError(f"'{path}': {error}") from error
    return None
