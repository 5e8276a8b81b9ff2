"""Small sequences of every kind that the pictures must cope with."""

import io
import os
import shutil
import time
from dataclasses import dataclass

import numpy as np
import pytest

from nrsfm.datasets.synthetic import face_sequence
from nrsfm.reconstruction import Reconstruction

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@dataclass
class Case:
    tracks: np.ndarray
    truth: np.ndarray
    rotations: np.ndarray
    result: Reconstruction
    faces: np.ndarray | None = None
    edges: np.ndarray | None = None


def make_case(frames: int, points: int, *, faces: bool = True, edges: bool = False) -> Case:
    sequence = face_sequence(frames, points)
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    estimate = (sequence.shapes + rng.standard_normal(sequence.shapes.shape)) @ turn
    result = Reconstruction(
        shapes=estimate.astype(np.float32),
        rotations=sequence.rotations @ turn,
        translations=np.zeros((frames, 2)),
        scales=np.ones(frames),
        groups=rng.integers(0, 4, points),
        method="bmm",
        diagnostics={"history": {"energy": [3.0, 2.0, 1.5], "gap": [1.0, 1e-3, 1e-6], "rank": [9, 6, 4]}},
    )
    lines = np.stack([np.arange(points - 1), np.arange(1, points)], axis=1) if edges else None
    return Case(
        sequence.tracks.points,
        sequence.shapes,
        sequence.rotations,
        result,
        sequence.faces if faces else None,
        lines,
    )


@pytest.fixture(autouse=True)
def coarse_panels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few pixels per panel: the tests look at what is drawn, not at how finely."""
    monkeypatch.setattr("nrsfm.viewing.panels._PIXELS_PER_INCH", 40)
    monkeypatch.setattr("nrsfm.viewing.animation.panels._FINER", 1)
    for name in ("_PIXELS", "_LARGE", "_POSTER"):
        monkeypatch.setattr(f"nrsfm.viewing.report.pictures.{name}", 80)


@pytest.fixture(scope="session")
def cases() -> dict[str, Case]:
    return {
        "mesh": make_case(5, 900),
        "points": make_case(5, 900, faces=False),
        "sparse": make_case(6, 120, faces=False),
        "skeleton": make_case(6, 41, faces=False, edges=True),
        "tiny": make_case(4, 5, faces=False),
        "two frames": make_case(2, 60),
    }


@pytest.fixture(scope="module")
def browser():
    """A running browser, or a skip that says what is not there."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="PLAYWRIGHT ABSENT: viewer and report are not tested in a browser"
    )
    place = os.environ.get("NRSFM_CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if place is None:
        pytest.skip(
            "NO BROWSER: no Chromium on this machine (set NRSFM_CHROMIUM), viewer and report are not tested in one"
        )
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=place, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        yield running
        running.close()


def until(page, condition, seconds=20.0):
    """Wait until it holds; the page's own policy forbids what playwright waits with."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        assert time.monotonic() < end, f"not within {seconds:g} s: {condition}"
        time.sleep(0.05)


def settle(page):
    """Wait until what was asked for is drawn."""
    page.evaluate(
        "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 120))))"
    )


def picture(page, selector="[data-part=canvas]"):
    """What an element of the page looks like, (H, W, 3) int."""
    from PIL import Image

    with Image.open(io.BytesIO(page.locator(selector).screenshot())) as shot:
        return np.asarray(shot.convert("RGB")).astype(int)
