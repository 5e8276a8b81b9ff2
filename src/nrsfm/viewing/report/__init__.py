"""One HTML page about one run, which opens without a network: what went in, what was chosen and why, what came out.

:func:`read_run` reads an output folder, :func:`make_report` makes the page, :func:`write_report` writes it.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.progress import Report, silent
from nrsfm.stages.run_folder import REPORT
from nrsfm.viewing.report.folder import Run, read_run

__all__ = ["REPORT", "Run", "Sources", "make_report", "read_run", "write_report"]


@dataclasses.dataclass(frozen=True, eq=False)
class Sources:
    """What a run was made from, as far as it is still there.

    Attributes
    ----------
    tracks
        ``Tracks``, or ``None``; then ``missing_tracks`` says why.
    truth, valid
        True shapes (F, P, 3) and which of them count (F, P), or ``None``; then ``missing_truth`` says why.
    faces, edges
        (T, 3) triangles and (E, 2) lines of points, or ``None``; ``surface`` says where the triangles are from.
    colours
        (P, 3) uint8 of the points, or ``None``.
    unit
        Of the tracks, in words.
    warnings
        What else the reader should know.
    """

    tracks: Any = None
    missing_tracks: str = ""
    truth: np.ndarray | None = None
    valid: np.ndarray | None = None
    missing_truth: str = ""
    faces: np.ndarray | None = None
    edges: np.ndarray | None = None
    surface: str = ""
    colours: np.ndarray | None = None
    unit: str = ""
    warnings: tuple[str, ...] = ()


def make_report(
    run: Run, sources: Sources | None = None, *, title: str = "", fps: float = 30.0, report: Report = silent
) -> str:
    """Return the page as text.

    Raises ``InputError`` where the sources are of another size than the reconstruction.
    """
    from nrsfm.viewing import player
    from nrsfm.viewing.report import choices, measures, outcome, page, pictures, sections
    from nrsfm.viewing.report.advice import warnings_of
    from nrsfm.viewing.report.markup import Html, el, number, percent, plural
    from nrsfm.viewing.viewer.colours import confidence_scale, deviation_scale, error_scale

    given, result = sources or Sources(), run.result
    _check(run, given)
    title = title or run.name
    kept = np.flatnonzero(result.reconstructed)
    report("measuring", None)
    fit = None if given.tracks is None else measures.fit_over_frames(result, given.tracks)
    errors = None if given.truth is None else measures.errors_over_frames(result, given.truth, given.valid)
    deviation = measures.deviation_over_frames(result)
    deformed = measures.deformation(result)
    scales = {
        "confidence": confidence_scale(result, kept),
        "deviation": deviation_scale(result, kept),
        "error": None if given.truth is None else error_scale(result, given.truth, given.valid, kept),
    }
    report("packing the player", None)
    packed = player.pack(
        result,
        faces=given.faces,
        edges=given.edges,
        scales={name: scale for name, scale in scales.items() if scale is not None},
        colours=given.colours,
        fps=fps,
        unit=given.unit,
    )
    report("drawing", None)
    views = pictures.side_views(result, given.faces, given.edges)
    shown = pictures.poster(result, given.faces, given.edges)

    def coloured(name: str, words: str) -> Html | None:
        scale = scales[name]
        if scale is None:
            return None
        values, high = measures.mean_of_points(scale, kept, result.n_points)
        picture = pictures.coloured_view(
            result, values, high, given.faces, given.edges, f"The points coloured: {words}"
        )
        return outcome.with_scale(picture, high, words, given.unit if name == "deviation" or not scaled else "")

    scaled = errors is not None and errors.align == "similarity"
    distance = "distance of each point from the truth, mean over frames"
    deep = "standard deviation of each depth, mean over frames"
    report("writing", None)

    share = percent(packed.rms / packed.size)
    thin = "" if len(packed.points) == len(kept) else f"{len(packed.points):,} of the {len(kept):,} points are shown. "
    faces = f"Surface: {given.surface}. " if given.surface and given.faces is not None else ""
    hint = (
        "Drag to turn; click the picture, then scroll to zoom. The charts below follow the player, and a click on one "
        f"takes it to that frame. {thin}{faces}"
    )
    mixed = (
        f"To keep this page small the player mixes {plural(packed.modes, 'shape')}. It is off by {share} of the "
        f"object's size (root mean square), at most by {percent(packed.largest / packed.size)}."
    )
    frame_words = f"{plural(result.n_frames, 'frame')} of {plural(result.n_points, 'point')}"
    body: list[Html | None] = [
        outcome.key_figures(run, fit, errors, deviation, deformed, given.unit),
        sections.warned(warnings_of(result, given.warnings)),
        el(
            "section",
            el("h2", "The moving shape", id="shape"),
            Html(player.markup(packed, shown, f"The reconstructed shape of {title} in frame 0")),
            el("p", hint, el("br"), mixed, class_="hint"),
            aria_labelledby="shape",
        ),
        sections.what_went_in(run, given.tracks, given.missing_tracks),
        sections.what_was_chosen(choices.choices(result, deformed, given.unit)),
        sections.convergence(run),
        outcome.how_it_fits(run, fit, given.missing_tracks, given.unit),
        outcome.from_several_sides(views),
        outcome.against_the_truth(run, errors, given.missing_truth, coloured("error", distance)),
        outcome.how_certain(run, deviation, deformed, given.unit, coloured("deviation", deep)),
        sections.how_it_ran(run),
    ]
    there = [part for part in body if part is not None]
    names = [
        ("shape", "Shape"), ("input", "Input"), ("choices", "Choices"), ("convergence", "Convergence"),
        ("fit", "Fit"), ("sides", "Sides"), ("truth", "Truth"), ("uncertainty", "Uncertainty"), ("repeat", "Repeat"),
    ]  # fmt: skip
    listed = [(name, text) for name, text in names if any(f'<h2 id="{name}">' in part for part in there)]
    began = run.log[:16] if run.log[:4].isdigit() else ""
    version = run.config.get("versions")
    version = f" {version['nrsfm']}" if isinstance(version, dict) and version.get("nrsfm") else ""
    subtitle = " · ".join(
        part for part in (frame_words, f"method {result.method}" if result.method else "", began) if part
    )
    head = el(
        "header",
        el("p", "nrsfm report", class_="brand"),
        el("h1", title),
        el("p", subtitle, class_="subtitle"),
        page.contents(listed),
        class_="top",
    )
    foot = el("footer", f"Made by nrsfm{version}. This page needs no network and loads nothing.", class_="bottom")
    description = f"{title}: {frame_words}, reconstructed in 3D"
    if fit is not None:
        description += f", reprojection error {number(fit.overall)}"
    return page.page(f"{title} – nrsfm report", description, head, el("main", there), foot)


def write_report(text: str, path: str | os.PathLike[str], *, overwrite: bool = False) -> int:
    """Write the page, whole or not at all, and return its size in bytes.

    Raises ``FileError`` where the file exists and ``overwrite`` is false, or cannot be written.
    """
    from nrsfm.files.atomic import atomic_file

    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileError(
            f"cannot write '{path}': the name of a report must end in .html, received '{Path(path).suffix}'"
        )
    data = text.encode("utf-8")
    with atomic_file(path, overwrite=overwrite) as stream:
        stream.write(data)
    return len(data)


def _check(run: Run, given: Sources) -> None:
    frames, points = run.result.n_frames, run.result.n_points
    tracks = given.tracks
    for name, size in (
        ("tracks", None if tracks is None else (tracks.n_frames, tracks.n_points)),
        ("truth", None if given.truth is None else given.truth.shape[:2]),
    ):
        if size is not None and tuple(size) != (frames, points):
            raise InputError(
                f"{name}: {frames} frames of {points} points are needed, as the reconstruction has, received {size[0]} "
                f"frames of {size[1]} points"
            )
