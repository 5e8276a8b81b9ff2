"""``nrsfm report``: one HTML page about a finished run, which opens without a network; or an animation of it."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.reconstruct import add_reading, add_truth, drawing_aids, image_size, load_truth, read_tracks
from nrsfm.cli.text import columns
from nrsfm.cli.view import add_showing, check_fps, given_colours, shown_edges, shown_faces
from nrsfm.errors import FileError, NrsfmError, OptionError
from nrsfm.stages.digest import digest

if TYPE_CHECKING:
    from nrsfm.viewing.report import Run, Sources


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm report",
        usage="nrsfm report DIR [--out FILE] [--animation FILE] [options]",
        description="Make one HTML page about a finished run: what went in, what was chosen and why, how well it\n"
        "fits, pictures from several sides and a player. It needs no other file and no network. With --animation\n"
        "make an animation instead, of the tracks beside the shape; with --out as well, both.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder that nrsfm reconstruct, or demo, has made")
    parser.add_argument("--out", metavar="FILE", help="[default: report.html in the folder]")
    parser.add_argument("--animation", metavar="FILE", help="file to make: .gif, .webp or .mp4")
    parser.add_argument(
        "--megabytes", type=float, default=2.0, metavar="X", help="most that the animation may have [default: 2]"
    )
    parser.add_argument("--title", default="", metavar="TEXT", help="[default: the folder's name]")
    parser.add_argument("--tracks", metavar="FILE", help="the tracks it was made from, if they are elsewhere now")
    add_reading(parser)
    parser.add_argument("--image-size", type=image_size, metavar="WxH", help="pixels, for relative coordinates")
    add_truth(parser, "--truth", metavar="FILE", help="the true shapes, if they are elsewhere now")
    parser.add_argument("--images", metavar="PATH", help="the input's frames: a video, or a folder of images")
    add_showing(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace a file of that name")
    parser.add_argument("--quiet", action="store_true", help="no progress and no summary")
    given = parser.parse_strictly(words)
    check_fps(given.fps)
    if not (math.isfinite(given.megabytes) and given.megabytes > 0):
        raise OptionError(f"option '--megabytes' must be greater than 0, received {given.megabytes:g}")

    from nrsfm.numerics.threads import single_thread
    from nrsfm.progress import TerminalProgress, silent
    from nrsfm.viewing.report import REPORT, make_report, read_run, write_report

    began = time.perf_counter()
    page = given.animation is None or given.out is not None
    out = Path(given.folder) / REPORT if given.out is None else Path(given.out)
    if os.path.lexists(given.folder):  # refused before anything is computed
        _check_targets(given, out if page else None)
    made: list[tuple[str, str]] = []
    with single_thread(), TerminalProgress() as line:
        report = silent if given.quiet else line
        report("reading files", None)
        found = read_run(given.folder)
        pictures = _pictures(found, given, report)
        sources = _sources(found, given, pictures)
        if page:
            text = make_report(found, sources, title=given.title, fps=given.fps, report=report)
            size = write_report(text, out, overwrite=given.overwrite)
            made.append(("output", f"{out} ({size / 1e6:.1f} MB)"))
        if given.animation is not None:
            made.append(("animation", _animate(found, given, sources, pictures, report)))
    if not given.quiet:
        lines = [*made, ("seconds", f"{time.perf_counter() - began:.1f}")]
        notes = [text for text in (sources.missing_tracks, sources.missing_truth) if text]
        print(columns([*lines, *(("left out", text) for text in notes)]))
    return 0


def _pictures(found: Run, given: Any, report: Any) -> Any:
    if given.images is None:
        return None
    from nrsfm.viewing.viewer.pictures import open_pictures

    return open_pictures(given.images, found.result.n_frames, report=report)


def _animate(found: Run, given: Any, sources: Sources, pictures: Any, report: Any) -> str:
    """Make the animation, and say what it is."""
    from nrsfm.viewing.animation import PACE, make_animation, write_animation

    animation = make_animation(
        found.result,
        tracks=sources.tracks,
        pictures=pictures,
        faces=sources.faces,
        edges=sources.edges,
        colours=sources.colours,
        pace=PACE[Path(given.animation).suffix.lower()],
        report=report,
    )
    report("writing", None)
    size, (width, height), count = write_animation(
        animation, given.animation, megabytes=given.megabytes, overwrite=given.overwrite
    )
    return f"{given.animation} ({size / 1e6:.1f} MB, {width} × {height} pixels, {count} pictures)"


def _check_targets(given: Any, out: Path | None) -> None:
    """Refuse what cannot be written, before anything is computed."""
    named = [] if out is None else [out]
    if out is not None and out.suffix.lower() not in (".html", ".htm"):
        raise OptionError(f"option '--out' must end in .html, received '{out}'")
    if given.animation is not None:
        from nrsfm.viewing.animation import check_animation_path

        check_animation_path(given.animation)
        named.append(Path(given.animation))
    for path in named:
        if path.is_file() and not given.overwrite:
            raise FileError(f"cannot write '{path}': it exists (to replace it: --overwrite)")


def _sources(found: Run, given: Any, pictures: Any) -> Sources:
    """What the run was made from: as named on the command line, or as its config.json names it, if still the same."""
    from nrsfm.viewing.report import Sources

    generated = None if given.tracks or given.truth else _generated(found)
    if generated is not None:
        faces, surface, warnings = shown_faces(given.faces, generated.faces, generated.edges, found.result)
        return Sources(
            tracks=generated.tracks,
            truth=generated.shapes,
            valid=generated.valid,
            faces=faces,
            edges=shown_edges(generated.edges, found.result),
            surface=surface,
            colours=_colours(found, pictures, generated.tracks),
            unit="px",
            warnings=warnings,
        )
    before = _as_it_was_read(found)
    tracks_path, no_tracks = _locate(found, "tracks", given.tracks)
    truth_path, no_truth = _locate(found, "truth", given.truth)
    tracks = truth = None
    if tracks_path:
        asked = given if given.tracks else before
        try:
            tracks = read_tracks(tracks_path, asked)
        except NrsfmError as error:
            if given.tracks:
                raise
            tracks_path, no_tracks = None, f"The tracks cannot be read any more: {error}."
    if truth_path:
        try:
            truth = load_truth(truth_path, (given if given.truth else before).truth_frame)
        except NrsfmError as error:
            if given.truth:
                raise
            truth_path, no_truth = None, f"The truth cannot be read any more: {error}."
    aids = drawing_aids(tracks_path, truth_path)
    faces, surface, warnings = shown_faces(given.faces, aids.get("faces"), aids.get("edges"), found.result)
    return Sources(
        tracks=tracks,
        missing_tracks=no_tracks,
        truth=None if truth is None else truth.shapes,
        valid=None if truth is None else truth.valid,
        missing_truth=no_truth,
        faces=faces,
        edges=shown_edges(aids.get("edges"), found.result),
        surface=surface,
        colours=_colours(found, pictures, tracks, tracks_path, truth_path),
        warnings=warnings,
    )


def _colours(found: Run, pictures: Any, tracks: Any, *paths: str | None) -> Any:
    """Colours (P, 3) uint8 of the points: those that a file brings along, or else those of the input's frames."""
    import numpy as np

    from nrsfm.viewing.viewer.content import fixed_colours

    result = found.result
    kept = np.flatnonzero(result.reconstructed)
    texture = fixed_colours(result, kept, tracks, pictures, given_colours(*paths))[0].get("texture")
    if texture is None:
        return None
    colours = np.zeros((result.n_points, 3), dtype=np.uint8)
    colours[kept] = texture
    return colours


def _locate(found: Run, what: str, asked: str | None) -> tuple[str | None, str]:
    """The file of tracks or truth that the run read; or ``None``, and in words why it is not used."""
    if asked:
        return asked, ""
    record = found.config.get(what)
    if not isinstance(record, dict) or not isinstance(record.get("path"), str):
        if what == "truth":
            return None, ""
        return None, "Where the tracks are is not recorded here: --tracks FILE names them, to see how well they fit."
    name = record["path"]
    place = next((p for p in (Path(name), found.folder / name, found.folder.parent / name) if p.is_file()), None)
    word = "tracks are" if what == "tracks" else "true shapes are"
    if place is None:
        return None, f"The {word} no longer at “{name}”: --{what} FILE says where they are now."
    if digest(place)["sha256"] != record.get("sha256"):
        return None, f"The {word} not used here, as the file “{name}” has changed since the run."
    return str(place), ""


def _as_it_was_read(found: Run) -> Any:
    """The options of the recorded command that say how its files are read."""
    parser = Parser(add_help=False)
    add_reading(parser)
    parser.add_argument("--image-size", type=image_size)
    add_truth(parser, "--truth")
    usual = parser.parse_known_args([])[0]
    with contextlib.suppress(ValueError, NrsfmError):
        return parser.parse_known_args(shlex.split(str(found.config.get("command", ""))))[0]
    return usual


def _generated(found: Run) -> Any:
    """The built-in sequence that the run was made from, made again; ``None`` where it was none, or is another now."""
    from nrsfm.datasets.synthetic import CAMERAS, face_sequence

    record = found.config.get("tracks")
    if not isinstance(record, dict) or record.get("sequence") != "face" or record.get("camera") not in CAMERAS:
        return None
    settings: dict[str, Any] = {name: record.get(name) for name in ("frames", "points", "camera", "noise", "seed")}
    if (settings["frames"], settings["points"]) != (found.result.n_frames, found.result.n_points):
        return None
    try:
        sequence = face_sequence(**settings)
    except (NrsfmError, TypeError):  # a config.json that was changed by hand
        return None
    same = hashlib.sha256(sequence.tracks.points.tobytes()).hexdigest() == record.get("sha256")
    return sequence if same else None
