"""Seconds until a newcomer sees something: importing the package, and the demo."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import quiet, targets
from benchmarks.children import TaskError, environment
from benchmarks.store import ROOT, Context
from benchmarks.tables import Check, table

TITLE = "Start"
_ROUNDS = 5
_SCRIPTS = {
    "bare": "pass",
    "import": "import nrsfm",
    "names": "import nrsfm; [getattr(nrsfm, name) for name in nrsfm.__all__]",
}


def _seconds(command: list[str]) -> float:
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise TaskError(f"{command} ended with {done.returncode}: {done.stderr.strip()[-1000:]}")
    return time.perf_counter() - start


def measure(context: Context) -> dict[str, Any]:
    """Importing in turn with a bare interpreter; one demo."""
    for script in _SCRIPTS.values():  # compiles the modules and warms the file cache
        _seconds(["-c", script])
    watch = quiet.Watch.start()
    rounds = [{name: _seconds(["-c", script]) for name, script in _SCRIPTS.items()} for _ in range(_ROUNDS)]
    times = {name: [one[name] for one in rounds] for name in _SCRIPTS}
    with tempfile.TemporaryDirectory() as folder:
        demo = _seconds(["-m", "nrsfm.cli", "demo", "--out", str(Path(folder) / "demo")])
    return {"seconds": times, "demo": demo, "others": watch.others()}


def _above(values: dict[str, Any], name: str) -> float:
    return median(values["seconds"][name]) - median(values["seconds"]["bare"])


def checks(values: dict[str, Any]) -> list[Check]:
    """Importing and the demo."""
    return [
        Check("`import nrsfm`, above a bare interpreter", _above(values, "import"), targets.IMPORT_SECONDS, " s"),
        Check("`nrsfm demo`, as `make demo` runs it", values["demo"], targets.DEMO_SECONDS, " s"),
    ]


def render(values: dict[str, Any]) -> list[str]:
    """A short table."""
    imported, demo = checks(values)
    rows = [
        ['`python -c "import nrsfm"`, above a bare interpreter', imported.cell()],
        ["the same with every public name used", f"{_above(values, 'names'):.3f} s"],
        ["`nrsfm demo` with its pictures, once", demo.cell()],
    ]
    lines = [f"Importing: medians of {_ROUNDS}. {quiet.sentence(values['others'])}", ""]
    return lines + table(["", "seconds"], rows)
