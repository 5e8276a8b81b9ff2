"""What an experiment is: cells to compute, rows that they become, a figure, and findings in words.

A :class:`Cell` is one reconstruction of one sequence, the smallest thing that is computed, kept and resumed. The runner
turns cells into records; an experiment only says which cells it wants and what to make of their records.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAMERAS = ("own", "intersection", "known")
"""The estimator that the method was published with; the intersection method, for every method; the true cameras."""

NOT_COMPARED = frozenset({"auto"})
"""Methods that are registered but are no part of the published comparison."""

Record = dict[str, Any]
"""What is kept of a cell: plain values by name of the measure, or ``{"error": text}`` for a cell that failed."""


@dataclass(frozen=True)
class Data:
    """Which tracks: a data set, noise as a ratio of max|W| with its seed, and what is left out of the data set.

    ``points`` and ``frames``: at most so many are kept, evenly spread points, the first frames; a built-in sequence is
    generated with exactly so many. ``camera_path``: the true shapes seen through a path of
    :mod:`nrsfm.experiments.paths` in place of the data set's own cameras. The noise comes last.
    """

    sequence: str
    noise: float = 0.0
    seed: int = 0
    points: int | None = None
    frames: int | None = None
    camera_path: str | None = None


@dataclass(frozen=True)
class Cell:
    """One call of ``reconstruct``, and the names of the measures (:mod:`nrsfm.experiments.measures`) taken of it.

    ``alone``: nothing else runs meanwhile, and every core may be used; for cells whose seconds are the result.
    """

    data: Data
    method: str
    cameras: str = "own"
    options: tuple[tuple[str, Any], ...] = ()
    measures: tuple[str, ...] = ("errors", "rotation", "seconds", "memory")
    alone: bool = False

    @property
    def key(self) -> str:
        """The cell in words, unique and stable between runs."""
        data = self.data
        words = [data.sequence]
        words += [f"noise {data.noise:g} seed {data.seed}"] if data.noise else []
        words += [f"{n} {v}" for n in ("points", "frames", "camera_path") if (v := getattr(data, n)) is not None]
        words += [self.method, self.cameras, *(f"{name}={value}" for name, value in self.options)]
        words += ["alone"] if self.alone else []
        return " | ".join([*words, *self.measures])


@dataclass(frozen=True)
class Scope:
    """What a run may use: ``quick`` asks for little; ``sequences`` are the names of data sets whose files are there.

    Among the sequences are built-in ones, in place of the faces whose files are not there, and in place of
    everything where there is no folder of data. ``methods``: those asked for, ``None`` for every registered one.
    """

    quick: bool
    sequences: tuple[str, ...]
    methods: tuple[str, ...] | None = None

    def having(self, names: Sequence[str]) -> list[str]:
        """Those of the names that are available, in the given order.

        In place of one that is not comes the built-in sequence that stands in for it, if the scope has that.
        """
        found = [name if name in self.sequences else stand_in(name) for name in names]
        return [name for name in dict.fromkeys(found) if name in self.sequences]

    def faces(self) -> list[str]:
        """The four dense faces, each as the original file, else as its stand-in, else built in."""
        kinds = ("original-face", "face-seq", "built-in-face")
        found = [next((f"{k}{i}" for k in kinds if f"{k}{i}" in self.sequences), None) for i in range(1, 5)]
        return [name for name in found if name is not None]

    def using(self, names: Collection[str] | None = None) -> list[str]:
        """Those of the methods (default: the comparison's) that are registered and asked for, in the registry's order.

        ``auto`` is none of the comparison's: it takes part where it is asked for by name.
        """
        from nrsfm.methods import method_names

        if names is None and self.methods is None:
            return [name for name in method_names() if name not in NOT_COMPARED]
        return [
            name
            for name in method_names()
            if (names is None or name in names) and (self.methods is None or name in self.methods)
        ]


def stand_in(name: str) -> str:
    """The built-in sequence that takes the place of one whose files are not there."""
    if name.startswith(("face-seq", "original-face")):
        return f"built-in-face{name[-1]}"
    return "built-in-face3" if name.startswith("ict-") or name == "face1" else "built-in-sheet"


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
