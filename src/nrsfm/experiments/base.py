"""What an experiment is: cells to compute, rows that they become, a figure, and findings in words.

A :class:`Cell` is one reconstruction of one sequence, the smallest thing that is computed, kept and resumed. The runner
turns cells into records; an experiment only says which cells it wants and what to make of their records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAMERAS = ("own", "intersection", "known")
"""The estimator that the method was published with; the intersection method, for every method; the true cameras."""

Record = dict[str, Any]
"""What is kept of a cell: plain values by name of the measure, or ``{"error": text}`` for a cell that failed."""


@dataclass(frozen=True)
class Data:
    """Which tracks: a data set, noise as a ratio of max|W| with its seed, and what is left out of the data set.

    ``points`` and ``frames``: at most so many are kept, evenly spread points, the first frames. ``camera_path``: the
    true shapes seen through a path of :mod:`nrsfm.experiments.paths` in place of the data set's own cameras.
    """

    sequence: str
    noise: float = 0.0
    seed: int = 0
    points: int | None = None
    frames: int | None = None
    camera_path: str | None = None


@dataclass(frozen=True)
class Cell:
    """One call of ``reconstruct``, and the names of the measures (:mod:`nrsfm.experiments.measures`) taken of it."""

    data: Data
    method: str
    cameras: str = "own"
    options: tuple[tuple[str, Any], ...] = ()
    measures: tuple[str, ...] = ("errors", "rotation", "seconds", "memory")

    @property
    def key(self) -> str:
        """The cell in words, unique and stable between runs."""
        data = self.data
        words = [data.sequence]
        words += [f"noise {data.noise:g} seed {data.seed}"] if data.noise else []
        words += [f"{n} {v}" for n in ("points", "frames", "camera_path") if (v := getattr(data, n)) is not None]
        words += [self.method, self.cameras, *(f"{name}={value}" for name, value in self.options)]
        return " | ".join([*words, *self.measures])


@dataclass(frozen=True)
class Scope:
    """What a run may use: ``quick`` asks for little; ``sequences`` are the names of data sets whose files are there."""

    quick: bool
    sequences: tuple[str, ...]

    def having(self, names: Sequence[str]) -> list[str]:
        """Those of the names that are available, in the given order."""
        return [name for name in names if name in self.sequences]


@dataclass(frozen=True)
class Finding:
    """One claim of the paper held against the measured numbers.

    ``verdict``: "reproduced", "not reproduced", "in part" or "not measured"; ``text`` says what was found, with the
    numbers and the data they come from, and is made from them by rules that can come out either way.
    """

    claim: str
    verdict: str
    text: str


Row = dict[str, Any]


@dataclass(frozen=True)
class Picture:
    """A figure with its caption; ``name`` is the file's stem."""

    name: str
    figure: Figure
    caption: str = field(default="")


class Experiment(Protocol):
    """One table or figure of the paper. Instances are stateless; each lives in its own file."""

    name: str
    title: str
    question: str

    def cells(self, scope: Scope) -> list[Cell]:
        """What has to be computed."""
        ...

    def rows(self, cells: Sequence[Cell], records: Mapping[str, Record]) -> list[Row]:
        """The table that goes into the CSV, from the records by ``Cell.key``; failed cells are rows with ``error``."""
        ...

    def pictures(self, rows: Sequence[Row]) -> list[Picture]:
        """The figures; none if there are no rows."""
        ...

    def findings(self, rows: Sequence[Row]) -> list[Finding]:
        """What the paper found, and whether these numbers say the same."""
        ...

    def table(self, rows: Sequence[Row]) -> list[str]:
        """The lines of Markdown that show the main numbers on the results page."""
        ...
