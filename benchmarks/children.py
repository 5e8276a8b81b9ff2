"""Fresh processes for what has to be timed alone: a task in this folder, with its own number of threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from benchmarks.runs import THREADS
from benchmarks.store import ROOT

TIMED_THREADS = 2


class TaskError(RuntimeError):
    """The task ended with an error; the message holds the end of what it wrote to stderr."""


KEEPS_MEMORY = {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": "100000000000"}
"""Environment in which a process (of glibc) keeps the memory that it has freed, and takes from it what it needs."""


def run_task(
    module: str, settings: dict[str, Any], threads: int = TIMED_THREADS, more: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Run ``python -m benchmarks.<module>`` with settings as JSON on stdin; its stdout is the JSON result.

    ``more``: added to its environment.
    """
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{module}"],
        input=json.dumps(settings),
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment(threads) | (more or {}),
        check=False,
    )
    if done.returncode:
        raise TaskError(f"{module} {settings}: exit {done.returncode}: {done.stderr.strip()[-2000:]}")
    values: dict[str, Any] = json.loads(done.stdout)
    return values


def environment(threads: int = TIMED_THREADS) -> dict[str, str]:
    """The environment of this process with that many linear-algebra threads."""
    return os.environ | dict.fromkeys(THREADS, str(threads))
