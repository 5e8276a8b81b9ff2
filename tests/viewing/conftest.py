"""Small sequences of every kind that the pictures must cope with."""

from dataclasses import dataclass

import numpy as np
import pytest

from nrsfm.datasets.synthetic import face_sequence
from nrsfm.reconstruction import Reconstruction


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
