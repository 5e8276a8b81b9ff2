"""Records kept on disk: one small JSON file a cell, named after what its numbers depend on.

That is the cell in words, the code that computes it and the files of its sequence. A record of another state of the
code has another name, so nothing stale is ever read and nothing that is finished is computed again.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
import math
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.experiments import sequences
from nrsfm.experiments.base import Cell, Data, Record
from nrsfm.experiments.measures import is_core

_PACKAGE = Path(__file__).resolve().parents[1]
_WITHOUT_NUMBERS = ("cli", "viewing")
_EXPERIMENT_PARTS = ("measures", "sequences", "worker")  # the rest of this package only asks and draws


class Store:
    """The folder of records; ``root`` is the folder of data sets or ``None``."""

    def __init__(self, folder: Path, root: Path | None) -> None:
        self.folder = folder
        self._root = root

    def stem(self, cell: Cell) -> str:
        """The name of a cell's files, without suffix."""
        return _name(cell.key, code_digest(cell), sequences.digest(cell.data.sequence, self._root))

    def cameras_path(self, data: Data) -> Path:
        """Where the cameras that the intersection method finds for the data are kept."""
        cell = cameras_cell(data)
        words = f"cameras | {cell.key}"
        name = _name(words, code_digest(cell), sequences.digest(data.sequence, self._root))
        return self.folder / f"cameras-{name}.npz"

    def read(self, cell: Cell) -> Record | None:
        """The record, or ``None`` where there is none, or a damaged one."""
        path = self.folder / f"{self.stem(cell)}.json"
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        if not isinstance(kept, dict) or kept.get("key") != cell.key or not isinstance(kept.get("record"), dict):
            return None
        record: Record = kept["record"]
        if "error" not in record and any(name not in record for name in cell.measures):
            return None
        return self._with_paths(record)

    def write(self, cell: Cell, record: Record) -> None:
        """Keep a record, with what it belongs to."""
        from nrsfm.files.atomic import atomic_file

        kept = {
            "key": cell.key,
            "code": code_digest(cell),
            "data": sequences.digest(cell.data.sequence, self._root),
            "machine": platform.node(),
            "record": record,
        }
        with atomic_file(self.folder / f"{self.stem(cell)}.json") as stream:
            stream.write(json.dumps(kept, allow_nan=False).encode())

    def _with_paths(self, record: Record) -> Record | None:
        """Arrays that were kept beside the record, by their path; ``None`` if one of them has gone."""
        found = dict(record)
        for name, value in record.items():
            if isinstance(value, dict) and set(value) == {"arrays"}:
                path = self.folder / str(value["arrays"])
                if not path.is_file():
                    return None
                found[name] = str(path)
        return found

    def resolved(self, record: Record) -> Record:
        """A record as :meth:`read` would give it."""
        return self._with_paths(record) or record


def cameras_cell(data: Data) -> Cell:
    """The reconstruction whose cameras stand for the intersection method: its estimate does not depend on the rest."""
    return Cell(data, "bmm", "own", (("camera_method", "intersection"), ("max_iterations", 1)), ())


def _name(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:20]


def plain(value: Any) -> Any:
    """The value as strict JSON gives it back: plain numbers, ``None`` for NaN and infinity, text for the rest."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def code_digest(cell: Cell) -> str:
    """Digest of the code that bears on a cell's numbers: comments, docstrings and other methods' files do not."""
    from nrsfm.cameras.estimate import PUBLISHED
    from nrsfm.methods import method_names

    method = cell.method if cell.method in method_names() else None
    extra = any(not is_core(name) for name in cell.measures)
    return _digest(method, _camera_method(cell), cell.data.camera_path is not None, extra, tuple(PUBLISHED))


def _camera_method(cell: Cell) -> str | None:
    from nrsfm.methods import get_method, method_names

    if cell.cameras != "own":
        return None
    given = dict(cell.options).get("camera_method")
    if given is not None or cell.method not in method_names():
        return given
    return get_method(cell.method).camera_method


@functools.cache
def _digest(method: str | None, camera: str | None, paths: bool, extra: bool, published: tuple[str, ...]) -> str:
    import scipy

    from nrsfm.methods import get_method, method_names

    def home(name: str) -> str:
        return type(get_method(name)).__module__

    # A method, an estimator that was published with one, and what only such import: they count for the cells that use
    # them. Whatever else there is counts for all: a missing link would let stale numbers pass.
    used = _closure(
        [*([home(method)] if method else []), *([f"nrsfm.cameras.{camera}"] if camera in published else [])]
    )
    single = _closure([*(home(name) for name in method_names()), *(f"nrsfm.cameras.{name}" for name in published)])
    single -= _closure(["nrsfm.pipeline", *(f"nrsfm.experiments.{part}" for part in _EXPERIMENT_PARTS)])
    parts = (*_EXPERIMENT_PARTS, *(["paths"] if paths else []), *(["extra_measures"] if extra else []))
    digest = hashlib.sha256(f"numpy {np.__version__} scipy {scipy.__version__}".encode())
    for module, path in _modules():
        words = module.split(".")
        if words[1:2] and words[1] in _WITHOUT_NUMBERS:
            continue
        if words[1:2] == ["experiments"] and (len(words) < 3 or words[2] not in parts):
            continue
        if module in single and module not in used:
            continue
        # The registry only names the methods, and it changes with each that is added.
        if module != "nrsfm.methods":
            digest.update(module.encode() + b"\0" + _code(path))
    return digest.hexdigest()[:16]


@functools.cache
def _modules() -> tuple[tuple[str, Path], ...]:
    return tuple(_find_modules())


def _find_modules() -> Iterator[tuple[str, Path]]:
    for path in sorted(_PACKAGE.rglob("*.py")):
        relative = path.relative_to(_PACKAGE).with_suffix("")
        words = [word for word in ("nrsfm", *relative.parts) if word != "__init__"]
        yield ".".join(words), path


def _closure(modules: list[str]) -> set[str]:
    """The modules and all of the package that they import, directly or not."""
    homes = dict(_modules())
    found: set[str] = set()
    waiting = [module for module in modules if module in homes]
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        found.add(module)
        for node in _imports(homes[module]):
            if isinstance(node, ast.ImportFrom) and node.module:
                named = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            else:
                named = [alias.name for alias in node.names]
            waiting += [name for name in named if name in homes]
    return found


@functools.cache
def _imports(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    nodes = ast.walk(ast.parse(path.read_bytes()))
    return tuple(node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))


@functools.cache
def _code(path: Path) -> bytes:
    """What a module does: its syntax without comments, layout and docstrings."""
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = node.body[1:]
    return ast.dump(tree).encode()
