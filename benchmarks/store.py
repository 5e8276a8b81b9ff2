"""Where the numbers are kept between runs, and what they were measured with."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from nrsfm.experiments.machine import machine
from nrsfm.experiments.process import cores

__all__ = [
    "Context",
    "DataAbsentError",
    "code_digest",
    "cores",
    "data_folder",
    "machine",
    "read",
    "say",
    "today",
    "write",
]

ROOT = Path(__file__).resolve().parents[1]
OUTPUT = ROOT / "bench-output"
PAGE = ROOT / "docs" / "benchmarks.md"

# Parts of the package that cannot change a number: a new picture does not make old results stale.
_WITHOUT_NUMBERS = ("cli", "viewing", "experiments", "stages", "export")
_OF_VIDEOS = ("tracking", "video")  # these bear on the section of that name alone
_VIDEO_SECTION = "tracking"


class DataAbsentError(Exception):
    """The folder of the data sets is not there; the message says where it was looked for."""


@dataclasses.dataclass(frozen=True)
class Context:
    """What every section may use: processes for the accuracy runs, a filter of sequences, old results or not."""

    jobs: int = 1
    only: tuple[str, ...] = ()
    fresh: bool = False

    def wanted(self, sequence: str) -> bool:
        """Whether the filter lets a sequence through."""
        return not self.only or any(word in sequence for word in self.only)


def data_folder() -> Path:
    """The folder named by ``NRSFM_DATA``, or ``../shared/data`` beside the repository.

    Raises ``DataAbsentError`` where there is none.
    """
    given = os.environ.get("NRSFM_DATA")
    folder = Path(given) if given else ROOT / ".." / "shared" / "data"
    if not folder.is_dir():
        raise DataAbsentError("no folder of data sets (set NRSFM_DATA)")
    return folder.resolve()


def read(section: str) -> dict[str, Any] | None:
    """What was kept of a section, or ``None``."""
    path = OUTPUT / f"{section}.json"
    if not path.is_file():
        return None
    try:
        kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError:
        say(f"{path.name} is damaged and is ignored")
        return None
    return kept


def write(section: str, values: dict[str, Any]) -> None:
    """Keep the values of a section, with the date, the machine and the code that they belong to."""
    from nrsfm.files.atomic import atomic_file

    kept = {"date": today(), "code": code_digest(section), "machine": machine(), "values": values}
    with atomic_file(OUTPUT / f"{section}.json") as stream:
        stream.write(json.dumps(kept, indent=1, allow_nan=False).encode())


def say(text: str) -> None:
    """Progress, on stderr."""
    print(text, file=sys.stderr, flush=True)


def today() -> str:
    """The date, as YYYY-MM-DD."""
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def code_digest(section: str = "") -> str:
    """Digest of the package's code that bears on a section's numbers, and of the linear algebra under it."""
    import numpy
    import scipy

    digest = hashlib.sha256(f"numpy {numpy.__version__} scipy {scipy.__version__}".encode())
    package = ROOT / "src" / "nrsfm"
    without = _WITHOUT_NUMBERS if section == _VIDEO_SECTION else _WITHOUT_NUMBERS + _OF_VIDEOS
    for path in sorted(package.rglob("*.py")):
        relative = path.relative_to(package)
        if relative.parts[0] not in without:
            digest.update(relative.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]
