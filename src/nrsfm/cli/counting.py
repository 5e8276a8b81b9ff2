"""Progress of many cells: a line that moves on a terminal, now and then a plain line elsewhere; always on stderr."""

from __future__ import annotations

import time
from typing import IO, TYPE_CHECKING, Self

from nrsfm.experiments.runner import Progress as State
from nrsfm.progress import TerminalDisplay

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

_EVERY = 30.0  # seconds between two plain lines


class Counting(TerminalDisplay):
    """Shows cells done, failed and running, and the time that is left; to be called with the runner's progress."""

    def __init__(self, label: str, stream: IO[str] | None = None) -> None:
        super().__init__(stream)
        self._label = label
        self._said = time.perf_counter()
        self._first = True

    def _columns(self) -> list[ProgressColumn]:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

        described = TextColumn("{task.description}")
        return [TextColumn(self._label), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), described]

    def __enter__(self) -> Self:
        super().__enter__()
        if self._display is not None:
            self._task = self._display.add_task("", total=None)
        return self

    def __call__(self, state: State) -> None:
        """Show how far it is."""
        if self._display is not None and self._task is not None:
            self._display.update(self._task, completed=state.done, total=state.total, description=_words(state))
            return
        now = time.perf_counter()
        # What was kept from before is said at once, what is added from time to time.
        if (self._first and state.done < state.total) or now - self._said > _EVERY:
            text = f"{self._label}: {state.done} of {state.total} cells{_words(state, ', ')}"
            print(text, file=self._stream, flush=True)
            self._said, self._first = now, False


def _words(state: State, before: str = "") -> str:
    words = [f"about {duration(state.left)} left"] if state.left and state.done < state.total else []
    words += [f"{state.failed} without numbers"] if state.failed else []
    words += ["; ".join(state.running)] if state.running else []
    return before + ", ".join(words) if words else ""


def duration(seconds: float) -> str:
    """A rough time: 20 s, 4 min, 1 h 10 min."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
