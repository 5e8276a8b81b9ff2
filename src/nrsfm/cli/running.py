"""What ``demo`` and ``reconstruct`` share: their options, and the one path from inputs to output folder."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.checkpoints import forget
from nrsfm.cli.arguments import Parser, add_options, flag_of, given_options
from nrsfm.cli.inputs import Inputs
from nrsfm.cli.outputs import Stages, limited_threads, log_to, versions
from nrsfm.cli.scores import scores
from nrsfm.cli.summary import summary
from nrsfm.cli.text import to_json
from nrsfm.errors import InputError, OptionError, suggest
from nrsfm.files.atomic import atomic_folder
from nrsfm.numerics.threads import single_thread
from nrsfm.options import split_options
from nrsfm.progress import Report, TerminalProgress, silent
from nrsfm.stages.run_folder import CONFIG, LOG, METRICS, OUTPUT_NAMES, RECONSTRUCTION, REPORT

if TYPE_CHECKING:
    import argparse

    import numpy as np

    from nrsfm.reconstruction import Reconstruction
    from nrsfm.tracks import Tracks

DEFAULT_METHOD = "auto"


@dataclasses.dataclass(frozen=True)
class Job:
    """How a run is done and where it goes."""

    command: tuple[str, ...]
    method: str
    options: dict[str, Any]
    out: Path
    seed: int
    threads: int | None
    overwrite: bool
    pictures: bool
    quiet: bool
    debug: bool


def parse(
    parser: Parser, words: Sequence[str], *, overwrite: bool = True, apart: str = ""
) -> tuple[argparse.Namespace, Job]:
    """Add the arguments of every run and those of the chosen method, and parse.

    The method is read first, because it decides which options there are. Without ``overwrite`` there is no such flag;
    options that begin with ``apart`` are not the method's.
    """
    method = _chosen_method(words)
    classes = _option_classes(method)
    parser.add_argument("--method", default=method, metavar="M", help=f"see nrsfm methods [default: {DEFAULT_METHOD}]")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of every random choice [default: 0]")
    parser.add_argument("--threads", type=int, metavar="N", help="threads of the numerical libraries [default: theirs]")
    if overwrite:
        parser.add_argument("--overwrite", action="store_true", help="replace a finished output of that name")
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")
    parser.add_argument("--quiet", action="store_true", help="no progress and no summary")
    for title, cls in classes.items():
        add_options(parser, title, cls)
    given = parser.parse_strictly(words, lambda flag: _other_methods(flag, method))
    for name in ("seed", "threads"):
        value, least = getattr(given, name), 1 if name == "threads" else 0
        if value is not None and value < least:
            raise OptionError(f"option '--{name}' must be at least {least}, received {value}")
    options = {name: value for name, value in given_options(given).items() if not apart or not name.startswith(apart)}
    split_options(tuple(classes.values()), options, f"method '{method}'")  # checked before anything is read
    job = Job(
        command=tuple(words),
        method=method,
        options=options,
        out=Path(given.out),
        seed=given.seed,
        threads=given.threads,
        overwrite=overwrite and given.overwrite,
        pictures=not given.no_pictures,
        quiet=given.quiet,
        debug=given.debug,
    )
    return given, job


def _chosen_method(words: Sequence[str]) -> str:
    from nrsfm.methods import method_names

    first = Parser(add_help=False)
    first.add_argument("--method", default=DEFAULT_METHOD)
    method: str = first.parse_known_args(words)[0].method
    known = method_names()
    if method not in known:
        hint = suggest(method, known) or f"; known are {', '.join(known)}"
        raise OptionError(f"unknown method '{method}'{hint}")
    return method


def _option_classes(method: str) -> dict[str, type]:
    from nrsfm.methods import get_method
    from nrsfm.pipeline import STAGE_OPTIONS

    stages = {f"options of the {name}": cls for name, cls in STAGE_OPTIONS.items()}
    return {f"options of the method {method}": get_method(method).Options, **stages}


def _other_methods(flag: str, method: str) -> str | None:
    """Say which methods have this flag, if the chosen one has not."""
    from nrsfm.methods import get_method, method_names

    name = flag.removeprefix("--").removeprefix("no-")
    owners = [
        other
        for other in method_names()
        if any(flag_of(f.name) == f"--{name}" for f in dataclasses.fields(get_method(other).Options))
    ]
    return f"it belongs to {', '.join(owners)} and not to {method}" if owners else None


def run(verb: str, job: Job, load: Callable[[Report], Inputs]) -> int:
    """Load, reconstruct, score, draw; the output folder appears at the end, complete, or not at all."""
    import nrsfm

    began = time.perf_counter()
    with contextlib.ExitStack() as stack:
        # The folder comes first: a path that cannot be written is found before anything is computed.
        folder = stack.enter_context(
            atomic_folder(job.out, overwrite=job.overwrite, replaceable=(*OUTPUT_NAMES, REPORT))
        )
        log = stack.enter_context(log_to(folder / LOG, debug=job.debug))
        command = shlex.join(["nrsfm", verb, *job.command])
        log.info("%s", command)
        threads = stack.enter_context(limited_threads(job.threads))
        display: Report = silent if job.quiet else stack.enter_context(TerminalProgress())
        stages = Stages(display, log)
        inputs = load(stages)
        tracks, truth = inputs.tracks, inputs.truth
        _check_sizes(inputs)
        mesh = _mesh_of_the_input(job, inputs)
        if mesh:
            log.info("faces: the %d that came with the tracks", len(mesh["faces"]))
        aside = _shapes_aside(job, tracks, folder / RECONSTRUCTION)
        result = nrsfm.reconstruct(
            tracks,
            method=job.method,
            rotations=inputs.rotations,
            seed=job.seed,
            progress=stages,
            **(job.options | aside),
            **mesh,
        )
        if aside:  # an arrangement of ours, no wish of the user's
            result = dataclasses.replace(result, options=result.options | {"shapes_file": None})
        stages("writing", None)
        result.save(folder / RECONSTRUCTION)
        config = {
            "command": command,
            **inputs.record,
            "method": job.method,
            "seed": job.seed,
            "threads": threads,
            **({"faces": "came with the tracks"} if mesh else {}),
            "options": {name: value for name, value in result.options.items() if name != "seed"},
            "versions": versions(),
        }
        (folder / CONFIG).write_text(to_json(config) + "\n", encoding="utf-8")
        found = None
        if truth is not None:
            stages("scoring", None)
            with single_thread():  # many small products: threads would wait for each other
                found = scores(result, truth)
            (folder / METRICS).write_text(to_json(found) + "\n", encoding="utf-8")
        warnings = [str(text) for text in result.diagnostics.get("warnings", [])]
        if job.pictures and tracks.unchecked:
            log.info("no pictures of tracks that stay in their file")
        elif job.pictures:
            warnings += _draw(folder, inputs, result, found, stages, log)
        stages.close()
        log.info("done in %.2f s", time.perf_counter() - began)
    if job.options.get("checkpoint"):
        forget(job.options["checkpoint"])
    if not job.quiet:
        print(summary(result, found, stages.seconds, warnings, job.out))
    return 0


def _shapes_aside(job: Job, tracks: Tracks, path: Path) -> dict[str, str]:
    """The option that has the shapes written into the reconstruction's file as they are made, where memory is short."""
    wanted = tracks.unchecked or job.options.get("memory") is not None
    return {"shapes_file": str(path)} if wanted and not job.options.get("shapes_file") else {}


def _draw(
    folder: Path,
    inputs: Inputs,
    result: Reconstruction,
    found: dict[str, Any] | None,
    report: Report,
    log: logging.Logger,
) -> list[str]:
    """Draw the pictures; return a warning if that fails."""
    from nrsfm.cli.pictures import draw

    try:
        with single_thread():
            draw(folder, inputs, result, found, report)
    except Exception as error:  # whatever a picture fails for, the result is worth keeping
        log.exception("a picture could not be drawn")
        return [f"not every picture could be drawn: {error} (log.txt says more)"]
    return []


def _mesh_of_the_input(job: Job, inputs: Inputs) -> dict[str, np.ndarray]:
    """The option ``faces``, where the method has it, the tracks came with a mesh and no other neighbours were named."""
    from nrsfm.methods import get_method

    names = {field.name for field in dataclasses.fields(get_method(job.method).Options)}
    if inputs.mesh is None or "faces" not in names or {"faces", "grid"} & job.options.keys():
        return {}
    return {"faces": inputs.mesh}


def _check_sizes(inputs: Inputs) -> None:
    frames, points = inputs.tracks.n_frames, inputs.tracks.n_points
    if inputs.truth is not None:
        inputs.truth.require_size(frames, points, "the input")
    if inputs.rotations is not None and len(inputs.rotations) != frames:
        raise InputError(
            f"cameras: {frames} rotations are needed, one for each frame, received {len(inputs.rotations)}"
        )
