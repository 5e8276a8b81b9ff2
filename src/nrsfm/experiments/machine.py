"""What numbers were measured on: cores, processor, memory, versions."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from nrsfm.experiments.process import cores


def machine() -> dict[str, Any]:
    """Plain facts of this machine and of the libraries that compute."""
    import numpy
    import scipy
    import threadpoolctl

    from nrsfm import __version__

    libraries = {i["internal_api"]: i["version"] for i in threadpoolctl.threadpool_info() if i["user_api"] == "blas"}
    return {
        "cores": cores(),
        "processor": _processor(),
        "memory_gib": _memory(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "blas": ", ".join(f"{name} {version}" for name, version in libraries.items()),
        "nrsfm": __version__,
    }


def in_words(facts: dict[str, Any]) -> str:
    """The facts as one sentence."""
    memory = f", {facts['memory_gib']:g} GiB memory" if facts["memory_gib"] else ""
    return (
        f"{facts['cores']} cores of {facts['processor']}{memory}, {facts['system']}; nrsfm {facts['nrsfm']}, Python "
        f"{facts['python']}, NumPy {facts['numpy']} with {facts['blas']}, SciPy {facts['scipy']}."
    )


def _memory() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, ValueError, OSError):
        return None  # a system that does not tell


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # not Linux
    return platform.processor() or platform.machine()
