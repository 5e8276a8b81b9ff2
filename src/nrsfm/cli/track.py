"""``nrsfm track``: a video to dense tracks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser, add_options, given_options
from nrsfm.cli.text import columns, to_json
from nrsfm.errors import FileError, OptionError, suggest

if TYPE_CHECKING:
    from nrsfm.tracking import TrackingResult

_EXTENSIONS = (".h5", ".hdf5", ".npz")


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    from nrsfm.tracking.options import METHODS, TrackingOptions

    listed = "\n".join(f"  {name:9} {text}" for name, text in METHODS.items())
    parser = Parser(
        prog="nrsfm track",
        usage="nrsfm track VIDEO --out TRACKS.h5 [--mask MASK] [options]",
        description="Track every pixel of the object from a reference frame through the video.",
        epilog=f"methods:\n{listed}",
    )
    parser.add_argument("--out", required=True, metavar="FILE", help="tracks to write, .h5 or .npz")
    parser.add_argument(
        "--method", default="subspace", metavar="{" + ",".join(METHODS) + "}", help="[default: subspace]"
    )
    add_video(parser)
    parser.add_argument("--step", type=int, default=1, metavar="PIXELS", help="distance of the points [default: 1]")
    add_options(parser, "options of tracking", TrackingOptions)
    parser.add_argument("--overwrite", action="store_true", help="replace an output of that name")
    parser.add_argument("--quiet", action="store_true", help="no progress and no summary")
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    given = parser.parse_strictly(words)
    out = Path(given.out)
    if out.suffix.lower() not in _EXTENSIONS:  # before minutes of work
        raise FileError(
            f"cannot save dense tracks as '{out}': the name must end in {', '.join(_EXTENSIONS)}"
            f"{suggest(out.suffix.lower(), _EXTENSIONS)}"
        )
    if out.exists() and not given.overwrite:
        raise FileError(f"'{out}' exists already; --overwrite replaces it")

    from nrsfm.progress import TerminalProgress, silent
    from nrsfm.tracking import save_tracking, track
    from nrsfm.video import check_frames, open_frames, read_mask

    with (
        open_frames(given.video, given.start, given.stop, given.stride, given.resize) as frames,
        TerminalProgress() as line,
    ):
        check_frames(frames)
        mask = None if given.mask is None else read_mask(given.mask, frames)
        found = track(
            frames,
            mask,
            reference_frame(given.reference),
            given.method,
            given.step,
            silent if given.quiet else line,
            **given_options(given),
        )
    save_tracking(found, out, overwrite=given.overwrite)
    if not given.quiet:
        print(to_json(_facts(found, given.out)) if given.json else columns(_lines(found, given.out)))
    return 0


def add_video(parser: Parser) -> None:
    """The video, which of its frames, and where the object is."""
    parser.add_argument("video", metavar="VIDEO", help="video file, folder of images, or pattern of images")
    parser.add_argument(
        "--mask",
        metavar="MASK",
        help="where the object is: an image (of the reference frame), a folder of images (of every frame), or a "
        "polygon 'x,y x,y x,y' [default: everywhere]",
    )
    parser.add_argument("--start", type=int, default=0, metavar="N", help="first frame [default: 0]")
    parser.add_argument("--stop", type=int, metavar="N", help="first frame not used [default: the end]")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="use every Nth frame [default: 1]")
    parser.add_argument("--resize", metavar="SIZE", help="longest side in pixels, or WIDTHxHEIGHT")
    parser.add_argument(
        "--reference",
        default="auto",
        metavar="{N,auto}",
        help="frame to track from, counted within the chosen ones; auto: the one most like the others, or the "
        "first where the mask is one image [default: auto]",
    )


def reference_frame(text: str) -> int | str:
    """Return a frame's number, or ``auto``, of what was typed."""
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise OptionError(f"option '--reference' must be a frame number or auto, received '{text}'") from None


def _facts(found: TrackingResult, out: str) -> dict[str, Any]:
    told = found.diagnostics
    return {
        "out": out,
        "method": told.method,
        "frames": found.tracks.n_frames,
        "points": found.tracks.n_points,
        "reference": told.reference,
        "visible": told.visible.tolist(),
        "likeness": told.likeness.tolist(),
        "photometric_error": told.photometric_error.tolist(),
        "rank": told.rank,
        "residual": told.residual,
        "seconds": told.seconds,
    }


def _lines(found: TrackingResult, out: str) -> list[tuple[str, str]]:
    import numpy as np

    told = found.diagnostics
    worst = int(np.argmin(told.visible))
    lines = [
        ("output", out),
        ("tracks", f"{found.tracks.n_points} points in {found.tracks.n_frames} frames, method {told.method}"),
        ("reference", f"frame {told.reference}"),
        (
            "visible",
            f"{100 * told.visible.mean():.1f} % of all entries, at least {100 * told.visible[worst]:.1f} % "
            f"(frame {worst})",
        ),
        ("likeness", f"local correlation with the reference: median {np.nanmedian(told.likeness):.2f}"),
    ]
    if told.rank:
        lines.append(("subspace", f"rank {told.rank}, trusted flow within {told.residual:.2f} pixels rms"))
    lines.append(("seconds", ", ".join(f"{stage} {value:.1f}" for stage, value in told.seconds.items())))
    return lines
