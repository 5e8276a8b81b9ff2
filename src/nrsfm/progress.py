"""Progress as one callable, ``report(stage, fraction)``: silence, a user's function or a terminal line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import TracebackType
from typing import IO, TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, TaskID

Report = Callable[[str, float | None], None]
"""Called with the name of the stage that runs and the part of it that is done, 0 to 1, or ``None``."""


def silent(stage: str, fraction: float | None) -> None:
    """Report nothing."""


class TerminalDisplay:
    """Bars on a stream, stderr if not given, where that is a terminal; ``_display`` is ``None`` elsewhere.

    Use as a context manager; at the end the bars go. Who inherits names the columns.
    """

    def __init__(self, stream: IO[str] | None = None) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._display: Progress | None = None
        self._task: TaskID | None = None

    def _columns(self) -> list[ProgressColumn]:
        raise NotImplementedError

    def __enter__(self) -> Self:
        if self._stream.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self._display = Progress(*self._columns(), console=Console(file=self._stream), transient=True)
            self._display.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._display is not None:
            self._display.stop()
            self._display = None


class TerminalProgress(TerminalDisplay):
    """A line on stderr with the stage, a bar and the time; nothing at all where stderr is not a terminal.

    Use as a context manager; inside it, the object is the callable to report to. At the end the line goes.
    """

    def __init__(self, stream: IO[str] | None = None) -> None:
        super().__init__(stream)
        self._stage: str | None = None

    def _columns(self) -> list[ProgressColumn]:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        return [TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()]

    def __call__(self, stage: str, fraction: float | None = None) -> None:
        """Show that ``stage`` runs and, unless ``fraction`` is ``None``, how much of it is done."""
        if self._display is None:
            return
        if stage != self._stage:
            if self._task is not None:
                self._display.remove_task(self._task)
            self._task, self._stage = self._display.add_task(stage, total=None), stage
        if fraction is not None and self._task is not None:
            self._display.update(self._task, total=1.0, completed=min(max(fraction, 0.0), 1.0))
