"""``nrsfm run``: a video to tracks, shapes, scores, pictures, a file for other programs and a report, in stages."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nrsfm.cli import running
from nrsfm.cli.arguments import Parser, add_options, given_options
from nrsfm.cli.outputs import Stages, limited_threads, log_to
from nrsfm.cli.reconstruct import add_truth
from nrsfm.cli.stage_progress import StageProgress
from nrsfm.cli.summary import summary
from nrsfm.cli.text import to_json
from nrsfm.cli.track import add_video, reference_frame
from nrsfm.cli.work import Wishes, Work
from nrsfm.errors import FileError, InputError, OptionError, suggest
from nrsfm.stages import Stage, StageFolder, is_same, is_there, open_stages
from nrsfm.stages.run_folder import CONFIG, LOG, REPORT

_VERB = "nrsfm run"
_LATER = {"score", "draw", "export", "report"}
_APART = "track_"  # options of tracking have names of their own: the methods have some of the same
_SHARES = {
    "subspace": {
        "reading frames": 0.01,
        "pairwise flow": 0.08,
        "finding again": 0.35,
        "subspace flow": 0.27,
        "photometric fit": 0.29,
    },
    "dis": {"reading frames": 0.06, "pairwise flow": 0.94},
    "naive": {"reading frames": 0.1, "pairwise flow": 0.9},
}
"""Which part of the time of tracking each step takes, about."""


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    given, job, wishes = _asked(words)
    began = time.perf_counter()

    import nrsfm

    command = shlex.join(["nrsfm", "run", *job.command])
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(open_stages(job.out, _VERB, nrsfm.__version__, extra=(LOG, CONFIG)))
        work = Work(folder.path, wishes)
        stages = _stages(work, wishes, pictures=job.pictures, report=not given.no_report)
        _check_owner(folder, wishes, force=given.force, out=job.out)
        if wishes.truth is not None and (given.force or folder.why(stages["score"])):
            from nrsfm.video.truth import load_video_truth

            load_video_truth(wishes.truth)  # what is wrong with it is said before minutes of work
        log = stack.enter_context(log_to(folder.path / LOG, debug=job.debug, mode="a"))
        log.info("%s", command)
        threads = stack.enter_context(limited_threads(job.threads))
        line = stack.enter_context(StageProgress(len(stages), quiet=job.quiet))
        seconds: dict[str, float] = {}
        for name, stage in stages.items():
            why = "asked for by --force" if given.force else folder.why(stage)
            if not why:
                line.skip(name)
            else:
                if name == "report":
                    _write_config(folder, work, command, threads)
                log.info("stage %s: %s", name, why)
                shares = _SHARES.get(wishes.track_method) if name == "track" else None
                line.begin(name, "" if why == "not done yet" else why, shares)
                logged = Stages(line, log)
                folder.run(stage, logged)
                logged.close()
                line.end()
                seconds[name] = float((folder.entry(name) or {})["seconds"])
            work.facts[name] = folder.facts(name)
            if name == "reconstruct":  # not before: what fails until here leaves the folder as it was
                for gone in _LATER - stages.keys():
                    folder.drop(gone)
        if seconds or not (folder.path / CONFIG).exists():
            _write_config(folder, work, command, threads)
        log.info("done in %.2f s", time.perf_counter() - began)
        text = "" if job.quiet else _summary(folder, work, seconds, job.out)
    if text:  # the display is gone: it would break long lines
        print(text)
    return 0


def _asked(words: Sequence[str]) -> tuple[Any, running.Job, Wishes]:
    """What the command line says, checked before anything is read."""
    from nrsfm.export.options import FORMATS
    from nrsfm.options import split_options
    from nrsfm.tracking.options import METHODS, TrackingOptions

    parser = Parser(
        prog="nrsfm run",
        usage="nrsfm run VIDEO --out DIR [--mask MASK] [options]",
        description="Track the object in a video, reconstruct its moving 3D shape, score it where the truth is known,\n"
        "draw it, export it and make a report. Stages that are done are kept: the same command goes on where it\n"
        "was interrupted, and a changed option repeats only what depends on it.",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to make, or to go on with")
    add_video(parser)
    parser.add_argument(
        "--step",
        metavar="{PIXELS,auto}",
        default="auto",
        help="distance of the points; auto: as many points as are reconstructed in about a minute [default: auto]",
    )
    parser.add_argument(
        "--track-method", default="subspace", metavar="{" + ",".join(METHODS) + "}", help="[default: subspace]"
    )
    add_truth(parser, "--truth", metavar="FILE", help="true tracks and shapes, or one of them, to score against")
    parser.add_argument(
        "--export",
        default="glb",
        metavar="FORMATS",
        help=f"of {', '.join(FORMATS)}, separated by commas, or none [default: glb]",
    )
    parser.add_argument("--no-report", action="store_true", help="make no report")
    parser.add_argument("--force", action="store_true", help="do every stage again, whoever's run the folder holds")
    add_options(parser, "options of tracking", TrackingOptions, prefix=_APART)
    given, job = running.parse(parser, words, overwrite=False, apart=_APART)
    tracking = given_options(given, prefix=_APART)
    split_options((TrackingOptions,), tracking, "tracking")
    if given.track_method not in METHODS:
        raise OptionError(
            f"option '--track-method' must be one of {', '.join(METHODS)}, received '{given.track_method}'"
            f"{suggest(given.track_method, METHODS)}"
        )
    _check_video(given.video, job.out)
    return (
        given,
        job,
        Wishes(
            video=given.video,
            mask=given.mask,
            start=given.start,
            stop=given.stop,
            stride=given.stride,
            resize=given.resize,
            reference=reference_frame(given.reference),
            step=_step(given.step),
            track_method=given.track_method,
            tracking=tracking,
            method=job.method,
            options=job.options,
            seed=job.seed,
            truth=given.truth,
            truth_frame=given.truth_frame,
            formats=_formats(given.export),
            title=_title(given.video),
        ),
    )


def _stages(work: Work, asked: Wishes, *, pictures: bool, report: bool) -> dict[str, Stage]:
    """The stages that are wanted, in their order."""
    tracking = {
        name: getattr(asked, name)
        for name in ("start", "stop", "stride", "resize", "reference", "step", "track_method", "tracking")
    }
    inputs = {"video": asked.video}
    if asked.mask is not None and is_there(asked.mask):
        inputs["mask"] = asked.mask
    else:  # a polygon, or nothing
        tracking["mask"] = asked.mask
    found = [
        Stage("track", work.track, tracking, inputs),
        Stage(
            "reconstruct",
            work.reconstruct,
            {"method": asked.method, "seed": asked.seed, "options": asked.options},
            needs=("track",),
        ),
    ]
    if asked.truth is not None:
        frame = {"truth_frame": asked.truth_frame}
        found.append(Stage("score", work.score, frame, {"truth": asked.truth}, ("track", "reconstruct")))
    done = tuple(stage.name for stage in found)
    if pictures:
        found.append(Stage("draw", work.draw, {}, needs=done))
    if asked.formats:
        found.append(Stage("export", work.export, {"formats": asked.formats}, needs=("track", "reconstruct")))
    if report:
        found.append(Stage("report", work.report, {"title": asked.title}, needs=done))
    return {stage.name: stage for stage in found}


def _check_video(video: str, out: Path) -> None:
    from nrsfm.files.container import known_extensions

    path = Path(video)
    if path.suffix.lower() in known_extensions() and not path.is_dir():
        raise FileError(f"'{video}' is a file of tracks, not a video: nrsfm reconstruct takes it")
    if not path.exists() and not any(c in path.name for c in "*?["):
        raise FileError(f"cannot read '{video}': there is no such file or folder")
    if path.is_dir() and os.path.realpath(path) == os.path.realpath(out):
        raise OptionError(f"option '--out' must be another folder than the images', received '{out}'")


def _check_owner(folder: StageFolder, asked: Wishes, *, force: bool, out: Path) -> None:
    """The folder of another video is not replaced unasked."""
    kept = (folder.entry("track") or {}).get("inputs", {}).get("video")
    if kept is None or force or is_same(asked.video, kept):
        return
    if os.path.realpath(kept["path"]) != os.path.realpath(asked.video):
        raise FileError(
            f"cannot use folder '{out}': it holds the run of '{kept['path']}': name another folder, or --force to "
            "replace it"
        )


def _title(video: str) -> str:
    """The report's: name of the file or folder, or of the folder that a pattern is of."""
    path = Path(video)
    name = path.name if path.exists() else path.parent.name
    return name or path.resolve().name or video


def _step(text: str) -> int | None:
    if text == "auto":
        return None
    if not text.isdecimal() or int(text) < 1:
        raise OptionError(f"option '--step' must be a whole number of at least 1, or auto, received '{text}'")
    return int(text)


def _formats(text: str) -> tuple[str, ...]:
    from nrsfm.export.options import FORMATS

    if text == "none":
        return ()
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        if name not in FORMATS:
            known = [*FORMATS, "none"]
            raise OptionError(
                f"option '--export' must name formats of {', '.join(known)}, received '{name}'{suggest(name, known)}"
            )
    if "usd" in names and importlib.util.find_spec("pxr") is None:
        raise InputError("usd needs the library usd-core: pip install 'nrsfm[export]'")
    return names


def _write_config(folder: StageFolder, work: Work, command: str, threads: int) -> None:
    from nrsfm.files.atomic import atomic_file

    files: dict[str, dict[str, Any]] = {}
    for name in ("track", "reconstruct", "score"):
        entry = folder.entry(name)
        if entry is not None:
            work.facts.setdefault(name, folder.facts(name))
            files |= entry["inputs"] | entry["outputs"]
    with atomic_file(folder.path / CONFIG) as stream:
        stream.write((to_json(work.config(command, threads, files)) + "\n").encode())


def _summary(folder: StageFolder, work: Work, seconds: dict[str, float], out: Path) -> str:
    about, scored = work.facts["track"], work.facts.get("score", {})
    width, height = about["size"]
    lines = [
        ("video", f"{about['name']}: {about['frames']} frames of {width} x {height}"),
        (
            "tracked",
            f"{about['points']} points, every {about['step']} pixels, from frame {about['reference']}, method "
            f"{about['method']}, {100 * about['visible']:.1f} % visible",
        ),
    ]
    left_out = work.facts["reconstruct"].get("left_out")
    if left_out:
        lines.append(("left out", f"{100 * left_out:.1f} % of the entries: visible, but too uncertain"))
    found = scored.get("metrics", {})
    told = found.get("tracks")
    if told:
        lines.append(
            (
                "track error",
                f"mean {told['mean']:.2f}, median {told['median']:.2f} pixels, {100 * told['under_1']:.0f} % under 1, "
                f"{100 * told['under_3']:.0f} % under 3; visible: precision {told['precision']:.3f}, recall "
                f"{told['recall']:.3f}",
            )
        )
    written = work.facts.get("export", {}).get("written", [])
    lines += [("export", f"{out / entry['name']} ({entry['bytes'] / 1e6:.1f} MB)") for entry in written]
    if "report" in work.facts:
        lines.append(("report", str(out / REPORT)))
    warnings = [str(text) for name in work.facts for text in work.facts[name].get("warnings", [])]
    shapes = found if "shape_error" in found else None
    return summary(work.result, shapes, seconds, warnings, out, before=lines)
