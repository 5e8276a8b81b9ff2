"""What a run writes beside its result: versions, and its log with the time of every stage."""

from __future__ import annotations

import contextlib
import logging
import platform
import time
from collections.abc import Iterator
from pathlib import Path

from nrsfm.progress import Report

_LIBRARIES = ("numpy", "scipy", "threadpoolctl", "h5py", "matplotlib")


def versions() -> dict[str, str]:
    """Return the versions that a result may depend on."""
    from importlib.metadata import PackageNotFoundError, version

    import nrsfm

    found = {"nrsfm": nrsfm.__version__, "python": platform.python_version(), "platform": platform.platform()}
    for name in _LIBRARIES:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


@contextlib.contextmanager
def log_to(path: Path, *, debug: bool = False, mode: str = "x") -> Iterator[logging.Logger]:
    """Send the package's log, and Python's warnings, to a file for the length of the ``with`` block."""
    handler = logging.FileHandler(path, mode=mode, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    package, warned = logging.getLogger("nrsfm"), logging.getLogger("py.warnings")
    level = package.level
    package.setLevel(logging.DEBUG if debug else logging.INFO)
    for logger in (package, warned):
        logger.addHandler(handler)
    logging.captureWarnings(True)
    try:
        yield package
    finally:
        logging.captureWarnings(False)
        for logger in (package, warned):
            logger.removeHandler(handler)
        package.setLevel(level)
        handler.close()


class Stages:
    """Passes progress on and writes each stage, with its seconds, to the log."""

    def __init__(self, forward: Report, log: logging.Logger) -> None:
        self.seconds: dict[str, float] = {}
        self._forward, self._log = forward, log
        self._stage: str | None = None
        self._since = 0.0

    def __call__(self, stage: str, fraction: float | None = None) -> None:
        """Report progress, as any ``progress`` callable."""
        if stage != self._stage:
            self.close()
            self._stage, self._since = stage, time.perf_counter()
        self._forward(stage, fraction)

    def close(self) -> None:
        """End the stage that runs."""
        if self._stage is not None:
            seconds = time.perf_counter() - self._since
            self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + seconds
            self._log.info("%s: %.2f s", self._stage, seconds)
            self._stage = None


@contextlib.contextmanager
def limited_threads(threads: int | None) -> Iterator[int]:
    """Limit the threads of the numerical libraries, if a number is given, and yield how many they use."""
    # Loaded before the limit is set: a library that is loaded later would not know of it.
    import scipy.linalg  # noqa: F401
    import threadpoolctl

    with threadpoolctl.threadpool_limits(threads):
        yield max((pool["num_threads"] for pool in threadpoolctl.threadpool_info()), default=1)
