"""The output folder of a run, read again: what a report is made from."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from nrsfm.errors import FileError
from nrsfm.reconstruction import Reconstruction, load_reconstruction
from nrsfm.stages.run_folder import CONFIG, LOG, METRICS, RECONSTRUCTION

_LOG_END = 40_000  # characters of a long log that are shown


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """One finished run: its folder, its result, and what stands beside it (empty or ``None`` where it does not)."""

    folder: Path
    result: Reconstruction
    config: dict[str, Any]
    metrics: dict[str, Any] | None
    log: str

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name or str(self.folder)


def read_run(folder: str | os.PathLike[str]) -> Run:
    """Read an output folder.

    Raises
    ------
    FileError
        There is no such folder, it has no reconstruction, or one of its files is damaged.
    """
    place = Path(folder)
    if not place.exists():
        raise FileError(f"cannot read '{folder}': there is no such folder")
    if not place.is_dir():
        raise FileError(f"cannot read '{folder}': the folder of a finished run is needed, received a file")
    if not (place / RECONSTRUCTION).is_file():
        raise FileError(f"cannot read '{folder}': a finished run holds {RECONSTRUCTION}, and this folder does not")
    result = load_reconstruction(place / RECONSTRUCTION)
    config, metrics = _object(place / CONFIG), _object(place / METRICS)
    try:
        log = (place / LOG).read_text(encoding="utf-8", errors="replace") if (place / LOG).is_file() else ""
    except OSError as error:
        raise FileError(f"cannot read '{place / LOG}': {error.strerror or error}") from error
    if len(log) > _LOG_END:
        log = f"… {len(log) - _LOG_END:,} characters left out\n" + log[-_LOG_END:]
    return Run(place, result, config or {}, metrics, log)


def _object(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"cannot read '{path}': it is damaged: {error}") from error
    if not isinstance(value, dict):
        raise FileError(f"cannot read '{path}': a JSON object is needed, received a {type(value).__name__}")
    return value
