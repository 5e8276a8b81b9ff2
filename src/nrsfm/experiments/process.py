"""One worker process as the runner sees it: its channel, what it does and since when, what it holds."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nrsfm.experiments.base import Cell, Data

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Process:
    """One worker process: its channel, what it does and since when."""

    def __init__(self, folder: Path, root: Path | None, threads: int) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed by ``end``)
        self._folders = {"folder": str(folder.resolve()), "root": None if root is None else str(root.resolve())}
        # A session of its own: Ctrl-C reaches the runner alone, which then ends its processes.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "nrsfm.experiments.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=os.environ | dict.fromkeys(_THREADS, str(threads)),
            start_new_session=True,
        )
        self._buffer = b""
        self.data: Data | None = None
        self.cell: Cell | None = None
        self.busy = self.loading = False
        self.since = time.perf_counter()
        self.doing = ""

    @property
    def answers(self) -> int:
        """The descriptor that answers come from."""
        if self._process.stdout is None:  # cannot be: it was asked for
            raise RuntimeError("no channel")
        return self._process.stdout.fileno()

    def load(self, data: Data) -> None:
        """Have other data loaded."""
        self.send({"data": dataclasses.asdict(data), **self._folders}, f"loading {data.sequence}")
        self.data, self.loading = data, True

    def send(self, job: dict[str, Any], doing: str, cell: Cell | None = None) -> None:
        """Give it something to do."""
        self.cell, self.doing, self.busy, self.since = cell, doing, True, time.perf_counter()
        # A process that has just died is found out by its silence.
        with contextlib.suppress(BrokenPipeError):
            if self._process.stdin is not None:
                self._process.stdin.write(json.dumps(job).encode() + b"\n")
                self._process.stdin.flush()

    def listen(self) -> Iterator[dict[str, Any] | None]:
        """Answers that have come; ``None`` at the end of the channel."""
        received = os.read(self.answers, 1 << 20)
        if not received:
            yield None
            return
        *lines, self._buffer = (self._buffer + received).split(b"\n")
        for line in lines:
            yield json.loads(line)

    def held_bytes(self) -> int | None:
        """Memory that the process holds, where the system tells."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            pages = int(Path(f"/proc/{self._process.pid}/statm").read_text(encoding="ascii").split()[1])
            return pages * os.sysconf("SC_PAGE_SIZE")
        return None

    def last_words(self) -> str:
        """How a process that is gone ended."""
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        end = f"signal {-code}" if code < 0 else f"exit {code}"
        return f"{end}{': ' + lines[-1][:200] if lines else ''}"

    def end(self) -> None:
        """Kill it, whatever it does."""
        self._process.kill()
        self._process.wait()
        for channel in (self._process.stdin, self._process.stdout, self._errors):
            with contextlib.suppress(OSError):
                if channel is not None:
                    channel.close()
