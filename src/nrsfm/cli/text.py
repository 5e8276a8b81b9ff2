"""Results as text: plain lines on stdout, the same in a terminal, a pipe and a file; and strict JSON."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np


def columns(lines: Iterable[tuple[str, str]]) -> str:
    """Return ``name  text`` lines with the texts below each other."""
    pairs = list(lines)
    width = max((len(name) for name, _ in pairs), default=0)
    return "\n".join(f"{name:<{width}}  {text}".rstrip() for name, text in pairs)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> str:
    """Return a table whose last columns are wrapped, evenly, so that no line is longer than ``width``.

    The first two columns keep their width.
    """
    cells = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    room = max(width - sum(widths[:2]) - 2 * (len(header) - 1), 12 * len(widths[2:]))
    while sum(widths[2:]) > room:
        widest = max(range(2, len(widths)), key=lambda i: widths[i])
        widths[widest] -= 1
    lines = []
    for number, row in enumerate(cells):
        parts = [textwrap.wrap(text, size) or [""] for text, size in zip(row, widths, strict=True)]
        lines += [
            "  ".join(f"{text:<{size}}" for text, size in zip(line, widths, strict=True)).rstrip()
            for line in zip_longest(*parts, fillvalue="")
        ]
        if number == 0:
            lines.append("  ".join("-" * size for size in widths))
    return "\n".join(lines)


def to_json(value: Any) -> str:
    """Return indented JSON; NumPy numbers become plain ones, and NaN and infinity, which JSON lacks, null."""
    return json.dumps(_strict(value), indent=2, ensure_ascii=False, allow_nan=False)


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, np.ndarray):
        return _strict(value.tolist())
    if isinstance(value, np.generic):
        return _strict(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)
