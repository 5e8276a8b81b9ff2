"""What a file is: its name, size and content."""

from __future__ import annotations

import hashlib
import os
from typing import Any


def digest(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return ``path``, size in ``bytes`` and ``sha256`` of a file, read in parts. Raises ``OSError``."""
    with open(path, "rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
        return {"path": os.fspath(path), "bytes": stream.tell(), "sha256": sha256}
