"""Outputs that appear whole or not at all: write aside, in the same folder, then rename.

A rename within one file system is atomic, so a reader sees the old content or the new one and never a part of
it. Whatever interrupts the writing (an error, Ctrl-C, a full disk), what was written aside is removed.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO

from nrsfm.errors import FileError

_SHOWN = 5  # names listed in a refusal before "..."


def _aside(target: Path) -> Path:
    """A new hidden name beside ``target``; not by ``tempfile``, whose modes ignore the umask."""
    return target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _make_folder(folder: Path, target: Path) -> list[Path]:
    """Create ``folder`` with its parents and return those created, outermost first."""
    missing: list[Path] = []
    probe = folder
    while not probe.exists() and probe != probe.parent:
        missing.append(probe)
        probe = probe.parent
    created: list[Path] = []
    try:
        for new in reversed(missing):
            new.mkdir(exist_ok=True)
            created.append(new)
        if not folder.is_dir():
            raise NotADirectoryError(20, "Not a directory")
    except OSError as error:
        _remove_empty(created)
        raise FileError(f"cannot write '{target}': folder '{folder}': {_reason(error)}") from error
    return created


def _remove_empty(created: list[Path]) -> None:
    for folder in reversed(created):
        with contextlib.suppress(OSError):  # somebody else has put something there: it stays
            folder.rmdir()


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str], *, overwrite: bool = True) -> Iterator[IO[bytes]]:
    """Open a binary file that takes the name ``path`` only when the ``with`` block ends without an exception.

    Parent folders are created. A symbolic link is followed: the file that it points to is replaced.

    Raises
    ------
    FileError
        ``path`` cannot be written, is a folder or a device, or exists and ``overwrite`` is false.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        # Renaming over a folder fails late; renaming over a device such as /dev/null would replace it.
        raise FileError(f"cannot write '{path}': it exists and is not a regular file")
    if target.exists() and not overwrite:
        raise FileError(f"cannot write '{path}': it exists (to replace it: --overwrite, or overwrite=True)")
    created = _make_folder(target.parent, target)
    aside = _aside(target)
    done = False
    try:
        with aside.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(target)
        done = True
    except OSError as error:
        raise FileError(f"cannot write '{path}': {_reason(error)}") from error
    finally:
        if not done:
            aside.unlink(missing_ok=True)
            _remove_empty(created)


def check_output_folder(
    path: str | os.PathLike[str], *, overwrite: bool = False, replaceable: Collection[str] = ("*",)
) -> None:
    """Raise ``FileError`` where :func:`atomic_folder` would refuse ``path`` for what it holds now."""
    if not os.fspath(path):
        raise FileError("cannot write a folder: a name is needed, received ''")
    target = Path(os.path.realpath(path))
    if not os.path.lexists(target):
        return
    if target == Path(os.path.realpath(os.curdir)):
        # The new folder would take its name and leave the caller's shell in the removed one.
        raise FileError(f"cannot write folder '{path}': it is the working folder: name another, such as ./output")
    if not target.is_dir():
        raise FileError(f"cannot write folder '{path}': a file of that name exists")
    try:
        held = sorted(os.listdir(target))
    except OSError as error:
        raise FileError(f"cannot write folder '{path}': {_reason(error)}") from error
    if not held:
        return
    foreign = [n for n in held if not any(fnmatch.fnmatchcase(n, pattern) for pattern in replaceable)]
    if foreign:
        listed = ", ".join(foreign[:_SHOWN]) + (", ..." if len(foreign) > _SHOWN else "")
        raise FileError(f"cannot write folder '{path}': it holds other files, which would be lost: {listed}")
    if not overwrite:
        raise FileError(
            f"cannot write folder '{path}': it holds a finished output (to replace it: --overwrite, or overwrite=True)"
        )


@contextlib.contextmanager
def atomic_folder(
    path: str | os.PathLike[str], *, overwrite: bool = False, replaceable: Collection[str] = ("*",)
) -> Iterator[Path]:
    """Yield a new folder that takes the name ``path`` when the ``with`` block ends without an exception.

    The folder is created at once, so that a path that cannot be written is found before anything is computed.

    Parameters
    ----------
    path
        The folder to make. It may exist if it is empty.
    overwrite
        Replace a folder that is not empty.
    replaceable
        Patterns (as in ``fnmatch``) of the names that may be deleted by overwriting. A folder that holds
        anything else is refused even with ``overwrite``.

    Raises
    ------
    FileError
        ``path`` is refused (see above) or cannot be written.
    """
    check_output_folder(path, overwrite=overwrite, replaceable=replaceable)
    target = Path(os.path.realpath(path))
    created = _make_folder(target.parent, target)
    aside = _aside(target)
    done = False
    try:
        try:
            aside.mkdir()
        except OSError as error:
            raise FileError(f"cannot write folder '{path}': {_reason(error)}") from error
        yield aside
        # Again: the block may have run for minutes, and somebody may have filled the place meanwhile.
        check_output_folder(path, overwrite=overwrite, replaceable=replaceable)
        try:
            _swap(aside, target)
        except OSError as error:
            raise FileError(f"cannot write folder '{path}': {_reason(error)}") from error
        done = True
    finally:
        if not done:
            shutil.rmtree(aside, ignore_errors=True)
            _remove_empty(created)


def _swap(new: Path, target: Path) -> None:
    """Give ``new`` the name ``target``; what was there goes away afterwards, or comes back on failure."""
    if not target.exists():
        new.rename(target)
        return
    old = _aside(target)
    target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
