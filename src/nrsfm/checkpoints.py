"""Finished stages of a reconstruction, kept in a folder, so that an interrupted run goes on where it was.

Stages are kept in the order in which they are reached, each in a file of its own that appears whole. A run that begins
again reaches the same stages in the same order and finds them; the random generator is set to what it was after each,
so that the result is the same to the last bit. The folder stays when the run is finished, and may be removed as soon as
the result is safe: one that is lost before it was saved is soon made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from nrsfm.errors import FileError, InputError
from nrsfm.files.atomic import atomic_file
from nrsfm.files.locks import alone
from nrsfm.files.values import load_value, save_value
from nrsfm.streaming.readers import reader_of
from nrsfm.streaming.stored import StoredPoints

T = TypeVar("T")

RUN = "run.json"
_STAGE = re.compile(r"\d{3}-[a-z0-9-]+\.npz")
_LEFT = re.compile(r"\..+\.[0-9a-f]{8}\.tmp")  # what was being written when a process was killed
_STRETCHES, _STRETCH = 64, 16  # of tracks in a file: so many times so many points tell it from others
_WHOLE = 2**28  # bytes of tracks in a file up to which all are read


class Checkpoint:
    """The folder of one run; :func:`checkpoint` opens it. Without a folder nothing is kept.

    ``taken``: names of the stages that were found and not computed again.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._number = 0
        self.taken: list[str] = []

    def kept(
        self,
        name: str,
        compute: Callable[[], T],
        *,
        rng: np.random.Generator | None = None,
        held: Sequence[Any] = (),
    ) -> T:
        """The result of a stage: from its file, or computed and then kept.

        Parameters
        ----------
        name
            Of the stage, in words.
        compute
            Gives the result; what it can be: see :func:`nrsfm.files.values.save_value`.
        rng
            The generator that ``compute`` draws from.
        held
            Objects, such as the tracks, that may be part of the result and are not to be written.
        """
        if self._folder is None:
            return compute()
        self._number += 1
        path = self._folder / f"{self._number:03d}-{re.sub('[^a-z0-9]+', '-', name.lower()).strip('-')}.npz"
        if path.exists():
            value, state = self._found(path, held)
            if rng is not None:
                rng.bit_generator.state = state
            self.taken.append(name)
            result: T = value
            return result
        result = compute()
        save_value(path, (result, None if rng is None else rng.bit_generator.state), held)
        return result

    def _found(self, path: Path, held: Sequence[Any]) -> tuple[Any, Any]:
        try:
            value, state = load_value(path, held)
        except FileError as error:
            raise FileError(f"checkpoint: {error}: remove that file, and the stage is done again") from error
        return value, state


@contextlib.contextmanager
def checkpoint(path: str | None, describe: Callable[[], dict[str, Any]]) -> Iterator[Checkpoint]:
    """The checkpoint in a folder, which is made where there is none.

    Parameters
    ----------
    path
        The folder, or ``None`` to keep nothing.
    describe
        Says what the run is, in plain values: what is found must be of the same.

    Raises
    ------
    InputError
        The folder holds the stages of another run.
    FileError
        It holds other files, cannot be written, or another process is working in it.
    """
    if path is None:
        yield Checkpoint()
        return
    folder = Path(path)
    _require_ours(folder, path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot use checkpoint '{path}': {error.strerror or error}") from error
    with alone(folder, path):
        _require_same(folder, path, json.loads(json.dumps(describe())))
        yield Checkpoint(folder)


def forget(path: str) -> None:
    """Remove a checkpoint whose result is safe; nothing but its own files."""
    folder = Path(path)
    with contextlib.suppress(OSError):
        for entry in folder.iterdir():
            if entry.name == RUN or _STAGE.fullmatch(entry.name):
                entry.unlink()
        folder.rmdir()


def _require_ours(folder: Path, path: str) -> None:
    """Refuse a folder that holds anything but stages, and remove what a killed process was writing."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FileError(f"cannot use checkpoint '{path}': it is not a folder")
    foreign = []
    for entry in sorted(folder.iterdir()):
        if _LEFT.fullmatch(entry.name) and entry.is_file():
            entry.unlink()
        elif entry.name != RUN and not _STAGE.fullmatch(entry.name):
            foreign.append(entry.name)
    if foreign:
        raise FileError(f"cannot use checkpoint '{path}': it holds other files, such as '{foreign[0]}'")


def _require_same(folder: Path, path: str, described: dict[str, Any]) -> None:
    """Refuse the stages of another run; note what this one is where there are none."""
    record = folder / RUN
    if not record.exists():
        if any(folder.iterdir()):
            raise FileError(f"cannot use checkpoint '{path}': its {RUN} is missing (remove the folder to begin again)")
        with atomic_file(record) as stream:
            stream.write(json.dumps(described, indent=1).encode())
        return
    try:
        before = json.loads(record.read_text(encoding="utf-8"))
        names = sorted(before.keys() | described.keys())
    except (OSError, ValueError, AttributeError) as error:
        raise FileError(
            f"cannot use checkpoint '{path}': its {RUN} is damaged (remove the folder to begin again): {error}"
        ) from error
    other = [name for name in names if before.get(name) != described.get(name)]
    if other:
        name = other[0]
        raise InputError(
            f"checkpoint '{path}' is of another run: {name} was {before.get(name)}, received {described.get(name)} "
            "(name another folder, or remove this one)"
        )


def content_of(points: np.ndarray | StoredPoints) -> str:
    """A digest that tells tracks from others: of all bytes in memory, of large files of 64 stretches of points."""
    reader = reader_of(points)
    frames, count, _ = reader.shape
    size = frames * count * 2 * reader.dtype.itemsize
    whole = hashlib.blake2b(f"{reader.shape} {reader.dtype.str}".encode(), digest_size=16)
    if type(points) is np.ndarray:
        for frame in points:
            whole.update(np.ascontiguousarray(frame).data)
        return whole.hexdigest()
    starts, length = np.zeros(1), count
    if size > _WHOLE:
        starts, length = np.linspace(0, count - _STRETCH, _STRETCHES), _STRETCH
    for start in starts.astype(np.int64).tolist():
        whole.update(np.ascontiguousarray(reader.read(start, start + length)).data)
    return whole.hexdigest()
