"""Finds the verb and turns what happens into an exit code.

0: done. 2: the input or an option is wrong (one line on stderr). 1: a fault of ours. 130: interrupted.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType

from nrsfm.cli import INTERRUPTED, VERBS
from nrsfm.cli.arguments import Parser
from nrsfm.errors import NrsfmError, OptionError, suggest

DONE, FAULT, WRONG, TERMINATED, READER_GONE = 0, 1, 2, 143, 141


class _Terminated(BaseException):
    """SIGTERM, as an exception, so that what was written aside is removed on the way out."""


def run_command(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; ``arguments`` defaults to the process's own."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        # Option texts hold Greek letters: an ASCII terminal must show something and not crash.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    with _sigterm_as_exception():
        try:
            code = _dispatch(words)
            sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            _say("interrupted")
            return INTERRUPTED
        except _Terminated:
            _say("terminated")
            return TERMINATED
        except BrokenPipeError:
            # The reader (``| head``) has gone: keep the interpreter from flushing into it at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return READER_GONE
        except Exception as error:
            if "--debug" in words:
                raise
            return _explain(error)


def _dispatch(words: list[str]) -> int:
    verb = next((word for word in words if not word.startswith("-")), None)
    if verb is None:
        return _without_verb(words)
    if verb not in VERBS:
        raise OptionError(f"unknown command '{verb}'{suggest(verb, VERBS) or '; see nrsfm --help'}")
    words = list(words)
    words.remove(verb)
    module = importlib.import_module(f"nrsfm.cli.{verb}")
    try:
        code: int = module.run(words)
    except SystemExit:  # argparse ends --help so
        return DONE
    return code


def _without_verb(words: list[str]) -> int:
    from nrsfm import __version__

    listed = "\n".join(f"  {verb:13}{text}" for verb, text in VERBS.items())
    parser = Parser(
        prog="nrsfm",
        usage="nrsfm COMMAND [options]",
        description="Dense non-rigid structure from motion: 2D point tracks to the 3D shape in every frame.",
        epilog=f"commands:\n{listed}\n\nnrsfm COMMAND --help tells more about one of them.",
    )
    parser.add_argument("--version", action="version", version=f"nrsfm {__version__}")
    try:
        parser.parse_strictly(words)
    except SystemExit:  # argparse ends --help and --version so
        return DONE
    raise OptionError(f"a command is needed, one of {', '.join(VERBS)}; see nrsfm --help")


def _explain(error: Exception) -> int:
    """Put the error in one line on stderr and return the exit code that it deserves."""
    if isinstance(error, NrsfmError):
        _say(f"error: {error}")
        return WRONG
    if isinstance(error, OSError):
        where = f" '{error.filename}'" if error.filename else ""
        _say(f"error: the system refused{where}: {error.strerror or error}")
        return WRONG
    if isinstance(error, MemoryError):
        _say(f"error: not enough memory: {error}")
        return FAULT
    _say(f"a fault of nrsfm, not yours: {type(error).__name__}: {error} (--debug shows where)")
    return FAULT


def _say(text: str) -> None:
    print("nrsfm: " + " ".join(text.split()), file=sys.stderr)


@contextlib.contextmanager
def _sigterm_as_exception() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # only there may handlers be set
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise _Terminated

    previous = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
