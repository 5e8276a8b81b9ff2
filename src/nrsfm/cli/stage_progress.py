"""Progress of a run in stages: which of them, how far, and how much time is left; always on stderr."""

from __future__ import annotations

import time
from typing import IO, TYPE_CHECKING, Self

from nrsfm.progress import TerminalDisplay

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

_EVERY = 30.0  # seconds between two plain lines
_SOONEST = 2.0  # seconds before which nothing is said about the time left
_EARLIEST = 0.03  # part done before which nothing is said about the time left


class StageProgress(TerminalDisplay):
    """A bar on a terminal, plain lines elsewhere; the object is the callable that the running stage reports to.

    ``shares`` of a stage say which part of its time each of its steps takes, roughly and in their order; the time left
    is then that of the stage, otherwise that of the step.
    """

    def __init__(self, total: int, stream: IO[str] | None = None, *, quiet: bool = False) -> None:
        super().__init__(stream)
        self._total, self._quiet = total, quiet
        self._number, self._name = 0, ""
        self._shares: dict[str, float] = {}
        self._step: str | None = None
        self._began = self._step_began = self._said = time.perf_counter()

    def _columns(self) -> list[ProgressColumn]:
        from rich.progress import BarColumn, TextColumn

        return [TextColumn("{task.description}"), BarColumn(bar_width=24), TextColumn("{task.fields[time]}")]

    def __enter__(self) -> Self:
        return self if self._quiet else super().__enter__()

    def begin(self, name: str, why: str, shares: dict[str, float] | None = None) -> None:
        """A stage begins."""
        self._number, self._name, self._shares, self._step = self._number + 1, name, shares or {}, None
        self._began = self._step_began = self._said = time.perf_counter()
        if self._display is None:
            self._say(f"{self._title()} ({why})" if why else self._title())
        else:
            self._task = self._display.add_task(self._title(), total=None, time="")

    def end(self) -> None:
        """The stage is done."""
        if self._display is not None and self._task is not None:
            self._display.remove_task(self._task)
            self._task = None
        self._say(f"{self._title()}: done in {time.perf_counter() - self._began:.1f} s")

    def skip(self, name: str) -> None:
        """A stage need not be done."""
        self._number, self._name = self._number + 1, name
        self._say(f"{self._title()}: done before, unchanged")

    def __call__(self, step: str, fraction: float | None = None) -> None:
        """Show how far the running stage is, as any ``progress`` callable."""
        now = time.perf_counter()
        if step != self._step:
            self._step, self._step_began = step, now
        part, left = self._left(step, fraction, now)
        if self._display is not None and self._task is not None:
            self._display.update(
                self._task,
                description=f"{self._title()}: {step}",
                total=None if part is None else 1.0,
                completed=0.0 if part is None else part,
                time=f"{_clock(now - self._began)}  {left}",
            )
        elif now - self._said > _EVERY:
            self._said = now
            done = "" if part is None else f" {100 * part:.0f} %"
            self._say(f"{self._title()}: {step}{done}{', ' + left if left else ''}")

    def _left(self, step: str, fraction: float | None, now: float) -> tuple[float | None, str]:
        """Part of the stage, or of the step, that is done, and the time left in words."""
        if fraction is None:
            return None, ""
        part, began, of = min(max(fraction, 0.0), 1.0), self._step_began, " in this step"
        if step in self._shares:
            before = 0.0
            for name, share in self._shares.items():
                if name == step:
                    break
                before += share
            part, began, of = (before + self._shares[step] * part) / sum(self._shares.values()), self._began, ""
        if not _EARLIEST <= part < 1 or now - began < _SOONEST:
            return part, ""
        from nrsfm.cli.counting import duration

        return part, f"about {duration((now - began) * (1 - part) / part)} left{of}"

    def _title(self) -> str:
        return f"{self._number}/{self._total} {self._name}"

    def _say(self, text: str) -> None:
        if self._quiet:
            return
        if self._display is not None:
            self._display.console.print(text, highlight=False, markup=False)
        else:
            print(f"nrsfm: {text}", file=self._stream, flush=True)


def _clock(seconds: float) -> str:
    """Minutes and seconds; rich's own clock of a task stops when a step is complete."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
