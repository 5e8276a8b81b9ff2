"""The errors a caller can act on. Every one of them is an ``NrsfmError``.

The message is one line that names the thing, where it was found, the rule, and the value received.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class NrsfmError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(NrsfmError, ValueError):
    """An array or an argument breaks a stated rule."""


class OptionError(InputError):
    """An option or a method is unknown, or its value is out of range."""


class FileError(NrsfmError, ValueError):
    """A file cannot be read as what it claims to be, or an output cannot be written."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x' or 'y'?"`` with the nearest known names, or an empty string."""
    near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    if not near:
        return ""
    return "; did you mean " + " or ".join(f"'{n}'" for n in near) + "?"
