"""Is this the file, folder or set of images that it was? By sizes and times where they agree, else by content.

Ours. Sizes and times are compared first, because reading a long video only to see that it is the same takes seconds;
where they differ the content decides, so that a copy or a touched file counts as the same.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.errors import FileError
from nrsfm.stages.digest import digest


def identity(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a file, a folder or a pattern of files is: ``path``, ``bytes``, ``stamp`` and ``sha256``.

    ``stamp`` is a digest of names, sizes and times, ``sha256`` one of names and contents (of a single file: of its
    content alone, as ``sha256sum`` prints it).

    Raises
    ------
    FileError
        Nothing is there, or it cannot be read.
    """
    files = _files(path)
    whole = hashlib.sha256()
    size, alone = 0, ""
    try:
        stamp = _stamp(files)
        for name, file in files:
            content = digest(file)
            size += content["bytes"]
            if name:
                whole.update(os.fsencode(name) + b"\0" + bytes.fromhex(content["sha256"]))
            else:
                alone = content["sha256"]
    except OSError as error:
        raise FileError(f"cannot read '{path}': {error.strerror or error}") from error
    return {"path": os.fspath(path), "bytes": size, "stamp": stamp, "sha256": alone or whole.hexdigest()}


def is_same(path: str | os.PathLike[str], kept: Any) -> bool:
    """Return whether what is at ``path`` now has the content that ``kept``, an :func:`identity`, was made of."""
    if not isinstance(kept, dict):
        return False
    try:
        return _stamp(_files(path)) == kept.get("stamp") or identity(path)["sha256"] == kept.get("sha256")
    except (FileError, OSError):
        return False


def is_there(path: str | os.PathLike[str]) -> bool:
    """Return whether ``path`` is a file, a folder, or a pattern that some file fits."""
    try:
        return bool(_files(path)) or Path(path).is_dir()
    except (FileError, OSError, ValueError, NotImplementedError):
        return False


def plain(value: Any) -> Any:
    """Return settings as JSON would give them back; arrays become their shape and digest."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value)
        sha256 = hashlib.sha256(content.tobytes()).hexdigest()
        return {"dtype": str(content.dtype), "shape": list(content.shape), "sha256": sha256}
    if isinstance(value, np.generic):
        return value.item()
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _files(path: str | os.PathLike[str]) -> list[tuple[str, Path]]:
    """Names within ``path`` and files, sorted; a single file has the name ''."""
    target = Path(path)
    if target.is_dir():
        found = sorted(p for p in target.rglob("*") if p.is_file())
        return [(p.relative_to(target).as_posix(), p) for p in found]
    if target.exists():
        return [("", target)]
    # Only the name is a pattern: brackets in the names of folders are what they are.
    matches = sorted(target.parent.glob(target.name)) if target.name and target.parent.is_dir() else []
    if not matches:
        raise FileError(f"cannot read '{path}': there is no such file or folder")
    return [(p.name, p) for p in matches if p.is_file()]


def _stamp(files: list[tuple[str, Path]]) -> str:
    whole = hashlib.sha256()
    for name, file in files:
        state = file.stat()
        whole.update(os.fsencode(name) + f"\0{state.st_size} {state.st_mtime_ns}\n".encode())
    return whole.hexdigest()
