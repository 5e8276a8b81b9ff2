"""A folder that stages fill, and the record in it that says which of them are done, of what and with which options.

Ours. A stage works in a hidden folder inside; when it ends, what was there of it and of the stages that build on it
goes, its files take their names one by one by renaming, and then the record says so. ``pending`` in the record names
files on their way in. So whenever the process is killed, every file under its own name is whole, and the record never
calls something done that is not.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from nrsfm.errors import FileError
from nrsfm.files.atomic import atomic_file
from nrsfm.files.locks import alone
from nrsfm.progress import Report, silent
from nrsfm.stages.identity import identity, is_same, plain

RECORD = "stages.json"
"""Name of the record."""

_ASIDE, _END = ".stage-", ".tmp"
_FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes
    ----------
    name
        A word; the record's key.
    work
        Called with the empty folder to fill and a progress callable; returns facts for the record (JSON values).
    settings
        What it does with its inputs: options by name.
    inputs
        Files, folders or patterns outside of the folder that it reads, by name.
    needs
        Names of the stages whose outputs it reads.
    """

    name: str
    work: Callable[[Path, Report], dict[str, Any]]
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    inputs: dict[str, str] = dataclasses.field(default_factory=dict)
    needs: tuple[str, ...] = ()


class StageFolder:
    """The folder and its record; made by :func:`open_stages`."""

    def __init__(self, path: Path, verb: str, version: str) -> None:
        """Read the record."""
        self.path = path
        self._verb, self._version = verb, version
        self._done: dict[str, dict[str, Any]] = {}
        self._pending: list[str] = []
        record = path / RECORD
        if record.exists():
            held = _read(record)
            if held.get("made_by") != verb:
                raise FileError(f"cannot use folder '{path}': its {RECORD} was made by {held.get('made_by')!r}")
            self._done = dict(held["stages"])
            self._pending = list(held["pending"])

    def entry(self, name: str) -> dict[str, Any] | None:
        """Return what the record says of a finished stage: settings, inputs, outputs, seconds, facts."""
        return self._done.get(name)

    def facts(self, name: str) -> dict[str, Any]:
        """Return what a finished stage told; empty where it is not done."""
        facts: dict[str, Any] = self._done.get(name, {}).get("facts", {})
        return facts

    def why(self, stage: Stage) -> str:
        """Return why a stage must be done (again), in words; empty where it is done and nothing has changed."""
        kept = self._done.get(stage.name)
        if kept is None:
            return "not done yet"
        if kept["version"] != self._version:
            return f"made by version {kept['version']}"
        settings = plain(stage.settings)
        changed = [n for n in {**kept["settings"], **settings} if kept["settings"].get(n) != settings.get(n)]
        if changed or kept["settings"].keys() != settings.keys():
            return f"other options: {', '.join(changed)}"
        for name in {**kept["inputs"], **stage.inputs}:
            path = stage.inputs.get(name)
            known = kept["inputs"].get(name)
            if path is None or known is None:
                return f"other inputs: {name}"
            if not is_same(path, known):
                return f"the {name} has changed" if known["path"] == path else f"another {name}"
        if kept["needs"] != self._contents(stage.needs):
            return "what it builds on has changed"
        for name, known in kept["outputs"].items():
            if not is_same(self.path / name, known):
                return f"{name} is missing or was changed"
        return ""

    def run(self, stage: Stage, report: Report = silent) -> None:
        """Do a stage, whether it is done already or not; its files appear when all of them are complete."""
        began = time.perf_counter()
        missing = [name for name in stage.needs if name not in self._done]
        if missing:
            raise ValueError(f"stage {stage.name} needs {', '.join(missing)}")
        inputs = {name: identity(path) for name, path in stage.inputs.items()}
        aside = self.path / f"{_ASIDE}{secrets.token_hex(4)}{_END}"
        try:
            aside.mkdir()
            facts = stage.work(aside, report)
            made = sorted(os.listdir(aside))
            outputs = {name: identity(aside / name) | {"path": name} for name in made}
            self._forget({stage.name}, made)
            for name in made:
                os.replace(aside / name, self.path / name)
        except OSError as error:
            raise FileError(f"cannot write folder '{self.path}': {error.strerror or error}") from error
        finally:
            shutil.rmtree(aside, ignore_errors=True)
        self._done[stage.name] = {
            "version": self._version,
            "settings": plain(stage.settings),
            "inputs": inputs,
            "needs": self._contents(stage.needs),
            "outputs": outputs,
            "facts": plain(facts),
            "seconds": round(time.perf_counter() - began, 3),
        }
        self._pending = []
        self._write()

    def drop(self, name: str) -> None:
        """Remove a stage that is not wanted any more, with its files and what builds on it."""
        if name in self._done:
            self._forget({name}, [])
            self._pending = []
            self._write()

    def _contents(self, names: tuple[str, ...]) -> dict[str, dict[str, str]]:
        """What stages have made, by content."""
        return {
            name: {file: known["sha256"] for file, known in self._done[name]["outputs"].items()}
            for name in names
            if name in self._done
        }

    def _forget(self, names: set[str], coming: list[str]) -> None:
        """Take stages and all that build on them out of the record, then remove their files."""
        while more := {n for n, kept in self._done.items() if n not in names and names & kept["needs"].keys()}:
            names = names | more
        gone = {file for n in names if n in self._done for file in self._done[n]["outputs"]} | set(self._pending)
        for file in coming:
            place = self.path / file
            if place.is_dir() and not place.is_symlink() and file not in gone:
                raise FileError(f"cannot write '{place}': a folder of that name exists, and it is not of this run")
        self._done = {n: kept for n, kept in self._done.items() if n not in names}
        self._pending = sorted(gone | set(coming))
        self._write()
        for file in gone:
            _remove(self.path / file)

    def _write(self) -> None:
        held = {"made_by": self._verb, "format": _FORMAT, "pending": self._pending, "stages": self._done}
        with atomic_file(self.path / RECORD) as stream:
            stream.write(json.dumps(held, indent=1, ensure_ascii=False).encode())

    def clean(self) -> None:
        """Remove what a killed process has left aside."""
        for name in os.listdir(self.path):
            if name.startswith(f".{RECORD}.") or (name.startswith(_ASIDE) and name.endswith(_END)):
                _remove(self.path / name)
        if self._pending:
            for name in self._pending:
                _remove(self.path / name)
            self._pending = []
        self._write()


@contextlib.contextmanager
def open_stages(
    path: str | os.PathLike[str], verb: str, version: str, *, extra: tuple[str, ...] = ()
) -> Iterator[StageFolder]:
    """Open or make a folder for stages, for this process alone.

    Parameters
    ----------
    path
        A folder that is not there, is empty, or holds the record of an earlier run.
    verb
        Whose record it is.
    version
        Of what does the work: stages made by another are done again.
    extra
        Names of files besides the stages', such as a log, that go with the folder if no stage could be finished.

    Raises
    ------
    FileError
        The folder holds something else, its record is damaged, another process works in it, or it cannot be written.
    """
    if not os.fspath(path):
        raise FileError("cannot write a folder: a name is needed, received ''")
    target = Path(os.path.realpath(path))
    try:
        if target.exists() and not target.is_dir():
            raise FileError(f"cannot write folder '{path}': a file of that name exists")
        held = os.listdir(target) if target.exists() else []
        if held and RECORD not in held:
            listed = ", ".join(sorted(held)[:3]) + (", ..." if len(held) > 3 else "")
            raise FileError(f"cannot use folder '{path}': it holds other files and no {RECORD} of {verb}: {listed}")
        made = _make(target)
    except OSError as error:
        raise FileError(f"cannot write folder '{path}': {error.strerror or error}") from error
    try:
        with alone(target, path):
            folder = StageFolder(target, verb, version)
            folder.clean()
            try:
                yield folder
            finally:
                if not any(folder.entry(name) for name in folder._done) and not held:
                    for name in (RECORD, *extra):
                        _remove(target / name)
    finally:
        for new in reversed(made):
            with contextlib.suppress(OSError):  # it holds something
                new.rmdir()


def _make(target: Path) -> list[Path]:
    """Make the folder and its parents; return those that were not there, outermost first."""
    missing = [p for p in (target, *target.parents) if not p.exists()][::-1]
    made: list[Path] = []
    try:
        for new in missing:
            new.mkdir()
            made.append(new)
    except OSError:
        for new in reversed(made):
            with contextlib.suppress(OSError):
                new.rmdir()
        raise
    return made


def _read(path: Path) -> dict[str, Any]:
    rule = f"cannot use folder '{path.parent}': its {RECORD} is damaged (remove the folder to begin again)"
    try:
        held: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{rule}: {error}") from error
    keys = {"version", "settings", "inputs", "needs", "outputs", "facts", "seconds"}
    good = isinstance(held, dict) and held.get("format") == _FORMAT and isinstance(held.get("pending"), list)
    stages = held.get("stages") if good else None
    if not isinstance(stages, dict) or not all(isinstance(k, dict) and keys <= k.keys() for k in stages.values()):
        raise FileError(rule)
    names = [*held["pending"], *(n for kept in stages.values() for n in kept["outputs"])]
    if any(not isinstance(n, str) or Path(n).name != n or n in ("", ".", "..") for n in names):
        raise FileError(rule)  # these names are removed one day: never outside of the folder
    return held


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
