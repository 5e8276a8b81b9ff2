"""JSON files: nested lists, alone or by name. Meant for cameras; tracks work but are slow to read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.files.container import NAMELESS, Entry


def read(path: Path) -> dict[str, Entry]:
    """Return the lists of numbers of a JSON file; other values of an object are left out."""
    with path.open(encoding="utf-8-sig") as stream:
        value = json.load(stream)
    if isinstance(value, dict):
        return {str(name): _entry(item) for name, item in value.items() if isinstance(item, list)}
    return {NAMELESS: _entry(value)}


def _entry(value: Any) -> Entry:
    try:
        array = np.array(value)
    except (ValueError, OverflowError):  # lists of unequal length
        array = np.empty(0, dtype=object)
    return Entry(array.shape, str(array.dtype), lambda: array)
