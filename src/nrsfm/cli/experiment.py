"""``nrsfm experiment``: compute, draw and judge the tables and figures of the paper."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nrsfm.cli.arguments import Parser
from nrsfm.cli.text import columns
from nrsfm.errors import NrsfmError, OptionError, suggest

if TYPE_CHECKING:
    from nrsfm.experiments.report import Outcome, Settings

ALL = "all"


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    from nrsfm.experiments import about, experiment_names

    listed = columns([("  " + name, about(name)) for name in experiment_names()])
    parser = Parser(
        prog="nrsfm experiment",
        usage="nrsfm experiment NAME [--data ROOT] [--out DIR] [--quick] [options]",
        description="Compute a table or figure of the paper: a CSV, figures as PNG and SVG, and the configuration.\n"
        "What is finished is kept in DIR/cells: an interrupted run resumes where it stopped.",
        epilog=f"experiments:\n{listed}\n  {ALL:16}  every one, and one page: DIR/report.html, results.md",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help=f"one of those below, or {ALL}")
    parser.add_argument("--data", metavar="ROOT", help="folder of data sets [default: the variable NRSFM_DATA]")
    parser.add_argument("--out", default="experiments-output", metavar="DIR", help="[default: experiments-output]")
    parser.add_argument("--quick", action="store_true", help="little of everything: minutes for all")
    parser.add_argument("--jobs", type=int, metavar="N", help="cells at a time [default: one a core]")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="on the workers of a dask cluster, such as tcp://host:8786"
    )
    parser.add_argument("--methods", metavar="M,...", help="only these methods")
    parser.add_argument("--sequences", metavar="S,...", help="only these sequences, where an experiment can choose")
    parser.add_argument("--page", metavar="FILE", help=f"{ALL}: the Markdown page, its pictures beside it")
    given = parser.parse_strictly(words)
    names = _names(given.name)
    if given.jobs is not None and given.jobs < 1:
        raise OptionError(f"option '--jobs' must be at least 1, received {given.jobs}")
    if given.cluster is not None and given.jobs is not None:
        raise OptionError("option '--jobs' is for this machine alone: a cluster takes a cell for each of its threads")
    if given.page is not None and given.name != ALL:
        raise OptionError(f"option '--page' belongs to 'nrsfm experiment {ALL}', received '{given.name}'")

    from nrsfm.experiments.report import Settings, make_scope

    settings = Settings(
        out=Path(given.out),
        root=_root(given.data),
        quick=given.quick,
        jobs=given.jobs,
        methods=_words(given.methods, "--methods"),
        sequences=_words(given.sequences, "--sequences"),
        cluster=given.cluster,
    )
    make_scope(settings)  # unknown names are found before anything is computed
    if settings.root is None:
        print("no folder of data sets was given (--data, or the variable NRSFM_DATA): built-in sequences are used")
    return _run(names, settings, Path(given.page) if given.page else None, whole=given.name == ALL, debug=given.debug)


def _names(name: str | None) -> list[str]:
    from nrsfm.experiments import experiment_names

    known = [*experiment_names(), ALL]
    if name is None:
        raise OptionError(f"an experiment is needed, one of {', '.join(known)}")
    if name not in known:
        hint = suggest(name, known) or f"; known are {', '.join(known)}"
        raise OptionError(f"unknown experiment '{name}'{hint}")
    return experiment_names() if name == ALL else [name]


def _root(given: str | None) -> Path | None:
    from nrsfm.datasets import data_folder
    from nrsfm.datasets.folder import VARIABLE

    return data_folder(given) if given is not None or os.environ.get(VARIABLE) else None


def _words(text: str | None, flag: str) -> tuple[str, ...] | None:
    if text is None:
        return None
    words = tuple(word.strip() for word in text.split(",") if word.strip())
    if not words:
        raise OptionError(f"option '{flag}' needs names with commas between, received '{text}'")
    return words


def _run(names: Sequence[str], settings: Settings, page: Path | None, *, whole: bool, debug: bool) -> int:
    from nrsfm.cli.counting import Counting
    from nrsfm.experiments import get_experiment
    from nrsfm.experiments.report import failed, run_experiment

    outcomes: list[Outcome] = []
    faults = 0
    for number, name in enumerate(names, start=1):
        label = f"{name} ({number} of {len(names)})" if whole else name
        experiment = get_experiment(name)
        with Counting(label) as counting:
            try:
                outcome = run_experiment(experiment, settings, counting)
            except NrsfmError:
                raise
            except Exception as error:
                # Hours of the others are worth more than the purity of an early end; the page says what failed.
                if not whole or debug:
                    raise
                faults += 1
                outcome = failed(experiment, error)
                print(f"nrsfm: a fault of nrsfm in '{name}': {error} (--debug shows where)", file=sys.stderr)
        print(_said(outcome, settings.out), flush=True)
        outcomes.append(outcome)
    if whole:
        from nrsfm.experiments.page import default_page, write_pages

        for path in write_pages(outcomes, settings, page or default_page(settings)):
            print(f"written: {path}")
    return 1 if faults else 0


def _said(outcome: Outcome, folder: Path) -> str:
    lines = [f"{outcome.name}: {outcome.title}"]
    lines += [f"  {finding.verdict}: {finding.claim} {finding.text}" for finding in outcome.findings]
    failed = sum(map(len, outcome.failures.values()))
    if failed:
        lines.append(f"  {failed} of {outcome.cells} cells have no numbers (the CSV says why)")
    if not outcome.cells:
        lines.append("  nothing to measure: no sequence or method that this needs was asked for")
    files = [f"{outcome.name}.csv", f"{outcome.name}.json", *(picture.png.name for picture in outcome.pictures)]
    lines.append(f"  in {folder}: {', '.join(files)}")
    return "\n".join(lines)
