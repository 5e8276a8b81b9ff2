"""One process at a time in a folder."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from nrsfm.errors import FileError


@contextlib.contextmanager
def alone(target: Path, path: str | os.PathLike[str]) -> Iterator[None]:
    """Hold the folder's lock, where the system has such; it goes with the process, however that ends.

    Raises ``FileError`` where another process holds it; ``path`` is the name by which the user knows the folder.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(target, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(f"cannot use folder '{path}': another process is working in it") from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(handle)
