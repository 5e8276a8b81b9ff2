"""The command ``nrsfm``: one file per verb; nrsfm.cli.command finds the verb, this one gets there.

Only what cannot be avoided is imported here: Ctrl-C while Python still imports would show a traceback.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Sequence
from types import FrameType

VERBS = {
    "demo": "reconstruct a built-in sequence, score it and draw it",
    "reconstruct": "tracks to shapes and cameras",
    "evaluate": "a reconstruction against the truth, under every alignment",
    "run": "a video to shapes, pictures, a file for Blender and a report, in stages that are kept",
    "track": "a video to dense tracks",
    "info": "what a file holds",
    "export": "shapes and cameras as PLY, OBJ, animated glTF, USD, CSV or npz",
    "view": "shapes and cameras in the browser: play, turn, colour, compare",
    "report": "one page about a run that opens offline: choices, errors, pictures, player",
    "methods": "the methods, what they assume and what they cost",
    "datasets": "the benchmark sequences that can be read, and which are here",
    "experiment": "the tables and figures of the paper, computed, drawn and judged",
}

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; ``arguments`` defaults to the process's own."""
    previous = signal.getsignal(signal.SIGINT)
    # Python's own answer to Ctrl-C is an exception, which some imports turn into another one. Nothing has been
    # begun yet, so that the process may simply end. Other handlers, and other threads, are the caller's affair.
    ours = previous is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, _leave)
    try:
        from nrsfm.cli.command import run_command
    finally:
        if ours:
            signal.signal(signal.SIGINT, previous)
    return run_command(arguments)


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)
