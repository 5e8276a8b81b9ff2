"""What a file is: its name, size and content."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any


def digest(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return ``path``, size in ``bytes`` and ``sha256`` of a file, read in parts. Raises ``OSError``.

    Of a folder (a zarr store) those of the names and contents of all its files.
    """
    if os.path.isdir(path):
        found, size = hashlib.sha256(), 0
        for file in sorted(inner for inner in Path(path).rglob("*") if inner.is_file()):
            own = digest(file)
            found.update(f"{file.relative_to(path).as_posix()} {own['sha256']}\n".encode())
            size += own["bytes"]
        return {"path": os.fspath(path), "bytes": size, "sha256": found.hexdigest()}
    with open(path, "rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
        return {"path": os.fspath(path), "bytes": stream.tell(), "sha256": sha256}
