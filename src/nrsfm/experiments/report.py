"""Run experiments and write what they give: NAME.csv, NAME.json and pictures, each whole or not at all."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nrsfm.errors import InputError, OptionError, suggest
from nrsfm.experiments import sequences
from nrsfm.experiments.base import Cell, Experiment, Finding, Record, Row, Scope
from nrsfm.experiments.kept import Store, code_digest, plain
from nrsfm.experiments.machine import machine
from nrsfm.experiments.process import cores
from nrsfm.experiments.runner import Limits, Tell, run_cells

CELLS = "cells"


@dataclasses.dataclass(frozen=True)
class Settings:
    """What a run was asked for; ``root`` is the folder of data sets or ``None`` for built-in sequences alone.

    ``cluster``: the address of a dask scheduler whose workers compute the cells, or ``None`` for this machine.
    """

    out: Path
    root: Path | None = None
    quick: bool = False
    jobs: int | None = None
    methods: tuple[str, ...] | None = None
    sequences: tuple[str, ...] | None = None
    limits: Limits = dataclasses.field(default_factory=Limits)
    cluster: str | None = None

    @property
    def processes(self) -> int:
        """How many cells run at a time."""
        return self.jobs or cores()

    @property
    def complete(self) -> bool:
        """Whether nothing was left out."""
        return not self.quick and self.methods is None and self.sequences is None


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A picture that was written."""

    name: str
    caption: str
    png: Path


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What one experiment gave. ``failures``: cells by the reason that they have no numbers for."""

    name: str
    title: str
    question: str
    cells: int
    rows: list[Row]
    findings: list[Finding]
    table: list[str]
    pictures: list[Drawn]
    failures: dict[str, list[str]]


def make_scope(settings: Settings) -> Scope:
    """The sequences and methods that may be used; raises ``InputError`` for names that are unknown or not here."""
    from nrsfm.methods import method_names

    here = sequences.available(settings.root)
    if settings.sequences is not None:
        known = sequences.sequence_names()
        for name in settings.sequences:
            if name not in known:
                raise InputError(f"'{name}' is not a sequence{suggest(name, known) or '; known: ' + ', '.join(known)}")
            if name not in here and name not in sequences.BUILT_IN:
                where = f"'{settings.root}'" if settings.root else "a folder of data, of which none was given (--data)"
                raise InputError(f"sequence '{name}': its files are not in {where}")
        here = tuple(name for name in known if name in settings.sequences)
    for name in settings.methods or ():
        if name not in method_names():
            hint = suggest(name, method_names()) or f"; known are {', '.join(method_names())}"
            raise OptionError(f"unknown method '{name}'{hint}")
    return Scope(settings.quick, here, settings.methods)


def plan(experiment: Experiment, scope: Scope) -> list[Cell]:
    """The cells of an experiment that the scope allows, each once."""
    cells = {cell.key: cell for cell in experiment.cells(scope)}
    return [cell for cell in cells.values() if scope.methods is None or cell.method in scope.methods]


def run_experiment(experiment: Experiment, settings: Settings, tell: Tell = lambda progress: None) -> Outcome:
    """Compute what is missing, draw, judge and write."""
    cells = plan(experiment, make_scope(settings))
    store = Store(settings.out / CELLS, settings.root)
    records = run_cells(
        cells,
        store,
        settings.root,
        jobs=settings.jobs,
        limits=settings.limits,
        tell=tell,
        cluster=settings.cluster,
    )
    return write(experiment, cells, records, settings, store)


def write(
    experiment: Experiment, cells: Sequence[Cell], records: Mapping[str, Record], settings: Settings, store: Store
) -> Outcome:
    """Write the table, the configuration and the pictures of finished cells."""
    from nrsfm.viewing.style import save_figure

    rows = experiment.rows(cells, records)
    _write_text(settings.out / f"{experiment.name}.csv", csv_text(rows))
    drawn = []
    for picture in experiment.pictures(rows) if rows else []:
        png = save_figure(picture.figure, settings.out / f"{picture.name}.png")
        save_figure(picture.figure, settings.out / f"{picture.name}.svg")
        drawn.append(Drawn(picture.name, picture.caption, png))
    config = configuration(experiment, cells, settings, store)
    _write_text(settings.out / f"{experiment.name}.json", json.dumps(config, indent=1, ensure_ascii=False) + "\n")
    return Outcome(
        name=experiment.name,
        title=experiment.title,
        question=experiment.question,
        cells=len(cells),
        rows=rows,
        findings=experiment.findings(rows),
        table=experiment.table(rows),
        pictures=drawn,
        failures=failures(cells, records),
    )


def failed(experiment: Experiment, error: Exception) -> Outcome:
    """An outcome that says that the experiment itself failed."""
    reason = f"**This experiment failed: {type(error).__name__}: {error}**"
    return Outcome(experiment.name, experiment.title, experiment.question, 0, [], [], [reason, ""], [], {})


def failures(cells: Sequence[Cell], records: Mapping[str, Record]) -> dict[str, list[str]]:
    """The cells without numbers, by reason."""
    found: dict[str, list[str]] = {}
    for cell in cells:
        reason = records.get(cell.key, {}).get("error")
        if reason is not None:
            words = [cell.method, f"{cell.cameras} cameras", cell.data.sequence]
            words += [f"{cell.data.points} points"] if cell.data.points else []
            words += [f"{cell.data.frames} frames"] if cell.data.frames else []
            words += [f"noise {cell.data.noise:g}"] if cell.data.noise else []
            found.setdefault(str(reason), []).append(", ".join(words))
    return found


def csv_text(rows: Sequence[Row]) -> str:
    """Rows as CSV; the columns are those of all rows in the order in which they first come."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_csv_value(row.get(name)) for name in columns])
    return stream.getvalue()


def _csv_value(value: Any) -> Any:
    value = plain(value)
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict) else value


def configuration(experiment: Experiment, cells: Sequence[Cell], settings: Settings, store: Store) -> dict[str, Any]:
    """Everything that the numbers of an experiment depend on."""
    names = list(dict.fromkeys(cell.data.sequence for cell in cells))
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "quick": settings.quick,
        "methods": sorted({cell.method for cell in cells}),
        "processes": settings.processes,
        "threads_each": max(1, cores() // settings.processes),
        "cluster": settings.cluster,
        "limits": dataclasses.asdict(settings.limits),
        "machine": machine(),
        "data": {
            name: {
                "sha256": sequences.digest(name, settings.root),
                "files": [path.name for path in sequences.files(name, settings.root)],
            }
            for name in names
        },
        "cells": [
            {
                "key": cell.key,
                **plain(dataclasses.asdict(cell)),
                "options": plain(dict(cell.options)),
                "code": code_digest(cell),
                "file": f"{CELLS}/{store.stem(cell)}.json",
            }
            for cell in cells
        ],
    }


def _write_text(path: Path, text: str) -> None:
    from nrsfm.files.atomic import atomic_file

    with atomic_file(path) as stream:
        stream.write(text.encode())
