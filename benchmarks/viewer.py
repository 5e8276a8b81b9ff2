"""Frames a second that the viewer really draws, in a Chromium without a window: ``python -m benchmarks.viewer``.

A frame counts when its points were drawn and the number of the frame had changed. Processor time is that of the
browser's processes, for each such frame; unlike the rate it hardly depends on what else the machine does.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import quiet
from benchmarks.store import Context, DataAbsentError
from benchmarks.tables import Fact, amount, table
from nrsfm import Reconstruction
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.viewing.viewer import Content, ViewServer, make_content

TITLE = "Viewer"
FRAMES, POINTS, WANTED = 99, 28_880, 30.0
_CASES = {
    "points, one colour": "shape=points&colour=plain&input=0",
    "points, error": "shape=points&colour=error&input=0",
    "surface, one colour": "shape=surface&colour=plain&input=0",
    "surface, error": "shape=surface&colour=error&input=0",
    "surface, error, tracks beside it": "shape=surface&colour=error&input=1",
}
_SETTLED = 9.0  # seconds: the first round uploads every frame, then the picture finds its size
_SECONDS = 8.0
_STATE = """({distinct: nrsfmView.counts.distinct, now: performance.now(),
  size: `${nrsfmView.stage.canvas.width} × ${nrsfmView.stage.canvas.height}`})"""


def measure(_: Context | None = None) -> dict[str, Any]:
    """Play each case for a while."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise DataAbsentError("no playwright to drive a browser with") from None
    place = os.environ.get("NRSFM_CHROMIUM") or shutil.which("chromium")
    if place is None:
        raise DataAbsentError("no Chromium (set NRSFM_CHROMIUM)")
    with ViewServer(_content(), port=0) as server, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=place, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        rows = {name: _play(browser, f"{server.address}#{words}") for name, words in _CASES.items()}
        version = browser.version
        browser.close()
    known = [row["others"] for row in rows.values() if row["others"] is not None]
    found = {"cases": rows, "browser": version, "cores": os.cpu_count()}
    return found | {"others": max(known) if known else None}


def _content() -> Content:
    """The true face with some noise as a reconstruction, so that there is an error to colour."""
    face = face_sequence(frames=FRAMES, points=POINTS)
    shapes = face.shapes + 2.0 * np.random.default_rng(0).normal(size=face.shapes.shape)
    result = Reconstruction(
        shapes.astype(np.float32), face.rotations, np.full((FRAMES, 2), 240.0), np.ones(FRAMES), method="truth"
    )
    return make_content(result, truth=face.shapes, tracks=face.tracks, faces=face.faces, title="benchmark")


def _play(browser: Any, address: str) -> dict[str, Any]:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(address)
    while not page.evaluate(f"globalThis.nrsfmView?.store.frames.size === {FRAMES}"):
        time.sleep(0.1)
    time.sleep(_SETTLED)
    watch, before, used = quiet.Watch.start(), page.evaluate(_STATE), _processor_seconds()
    time.sleep(_SECONDS)
    after, used, others = page.evaluate(_STATE), _processor_seconds() - used, watch.others()
    page.close()
    count = after["distinct"] - before["distinct"]
    return {
        "rate": 1000 * count / (after["now"] - before["now"]),
        "milliseconds": 1000 * used / max(count, 1),
        "size": after["size"],
        "others": None if others is None else max(0.0, round(others - used / _SECONDS, 2)),
    }


def _processor_seconds() -> float:
    """What the processes below this one have used, the browser's; this one excluded."""
    parents, used = {}, {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            fields = (place / "stat").read_text().rpartition(")")[2].split()
            parents[int(place.name)], used[int(place.name)] = int(fields[1]), int(fields[11]) + int(fields[12])
    below = {os.getpid()}
    while more := {child for child, parent in parents.items() if parent in below} - below:
        below |= more
    return sum(used[number] for number in below - {os.getpid()}) / os.sysconf("SC_CLK_TCK")


def checks(values: dict[str, Any]) -> list[Fact]:
    """Whether each case plays in time, to the nearest whole frame a second."""
    return [
        Fact(
            f"view: {POINTS:,} points × {FRAMES} frames, {name}",
            round(one["rate"]) >= WANTED,
            f"{one['rate']:.1f} of {WANTED:g} frames a second",
        )
        for name, one in values["cases"].items()
    ]


def render(values: dict[str, Any]) -> list[str]:
    """One row for each case."""
    rows = [
        [name, check.cell(), f"{one['milliseconds']:.0f} ms", one["size"], amount(one["others"])]
        for (name, one), check in zip(values["cases"].items(), checks(values), strict=True)
    ]
    head = f"Chromium {values['browser']} without a window or a graphics card, {values['cores']} cores, 1280 × 800"
    columns = ["", "frames a second", "processor time per frame", "picture", "cores that others used"]
    return [
        f"{head}; {POINTS:,} points × {FRAMES} frames, {WANTED:g} frames a second asked for.",
        "",
        *table(columns, rows),
    ]


if __name__ == "__main__":
    print("\n".join(render(measure())))
