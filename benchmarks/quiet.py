"""Whether the machine was quiet: how many cores other programs used while something was timed."""

from __future__ import annotations

import dataclasses
import os
import time
from pathlib import Path

_QUIET = 0.1  # cores


@dataclasses.dataclass(frozen=True)
class Watch:
    """Started by :meth:`start`; :meth:`others` then tells how busy everything else has been since."""

    wall: float
    own: float
    busy: float | None

    @classmethod
    def start(cls) -> Watch:
        """Begin to watch."""
        return cls(time.perf_counter(), _own(), _busy())

    def others(self) -> float | None:
        """Mean number of cores that other processes used; None where the system does not tell."""
        busy = _busy()
        if busy is None or self.busy is None:
            return None
        gone = max(time.perf_counter() - self.wall, 1e-3)
        return round(max(0.0, busy - self.busy - (_own() - self.own)) / gone, 2)


def disturbed(others: float | None) -> bool:
    """Whether other programs used enough of the processor to spoil times."""
    return others is not None and others > _QUIET


def sentence(others: float | None) -> str:
    """What a page says about it."""
    if others is None:
        return "Whether other programs ran meanwhile is not known on this system."
    if not disturbed(others):
        return f"The machine was quiet: other programs used {others:.2f} cores."
    return f"**The machine was not quiet: other programs used {others:.2f} cores, so the times are too long.**"


def _own() -> float:
    """Processor seconds of this process and of its finished children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _busy() -> float | None:
    """Processor seconds of everything since the start of the system."""
    try:
        first = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
    except OSError:
        return None
    user, nice, system, _idle, _wait, interrupts, soft, steal = map(int, first[1:9])
    return (user + nice + system + interrupts + soft + steal) / os.sysconf("SC_CLK_TCK")
