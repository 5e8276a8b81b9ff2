"""A stand-in for the algorithms, so that the command line is tested alone and in milliseconds."""

import logging
import sys
import types
from dataclasses import dataclass

import numpy as np
import pytest

import nrsfm
from nrsfm.cli import main
from nrsfm.options import option, split_options
from nrsfm.reconstruction import Reconstruction


@dataclass(frozen=True)
class PlainOptions:
    rank: int | None = option(None, "Rank of the shapes.", symbol="K", minimum=1)
    tolerance: float = option(1e-3, "Tolerance of γ in %.", above=0)


@dataclass(frozen=True)
class GroupedOptions(PlainOptions):
    subspaces: int = option(20, "Number of subspaces.", minimum=1)
    spatial: bool = option(True, "Use them.")


@dataclass(frozen=True)
class CameraOptions:
    camera_method: str = option("intersection", "Estimator.", choices=("intersection", "rigid"))
    mirror: bool = option(False, "The other solution.")


@dataclass(frozen=True)
class PipelineOptions:
    shift: float = option(0.0, "Moves the answer.")


def _method(name, options):
    return types.SimpleNamespace(
        name=name,
        title=name.title(),
        year=2012,
        summary="A stand-in.",
        assumes="nothing",
        needs="complete tracks",
        cost="none",
        camera_method="intersection",
        Options=options,
    )


METHODS = {"bmm": _method("bmm", PlainOptions), "auto": _method("auto", GroupedOptions)}
STAGE_OPTIONS = {"cameras": CameraOptions, "run": PipelineOptions}


class FakePipeline:
    """Lifts the tracks to flat shapes; remembers the calls, and can be told to do something else first."""

    def __init__(self):
        self.calls = []
        self.before = lambda: None

    def __call__(self, tracks, method, rotations=None, seed=0, progress=False, **options):
        self.calls.append({"method": method, "rotations": rotations, "seed": seed, **options})
        classes = (METHODS[method].Options, *STAGE_OPTIONS.values())
        built = split_options(classes, options, f"method '{method}'")
        progress("iterating", 0.5)
        self.before()
        points = np.asarray(tracks.points, dtype=np.float64)
        centre = points.mean(axis=1)
        flat = np.zeros((*points.shape[:2], 3), dtype=np.float32)
        flat[..., :2] = points - centre[:, None]
        warnings = ["the camera does not turn: depth could not be determined"]
        for text in warnings:
            logging.getLogger("nrsfm.pipeline").warning(text)
        return Reconstruction(
            shapes=flat,
            rotations=np.stack([np.eye(3)] * len(points)) if rotations is None else rotations,
            translations=centre,
            scales=np.ones(len(points)),
            diagnostics={"warnings": warnings},
            method=method,
            options={key: value for part in built for key, value in vars(part).items()},
        )


@pytest.fixture
def pipeline(monkeypatch):
    fake = FakePipeline()
    methods = types.ModuleType("nrsfm.methods")
    methods.method_names = lambda: list(METHODS)
    methods.get_method = METHODS.__getitem__
    module = types.ModuleType("nrsfm.pipeline")
    module.STAGE_OPTIONS = STAGE_OPTIONS
    for name, value in (("nrsfm.methods", methods), ("nrsfm.pipeline", module)):
        monkeypatch.setitem(sys.modules, name, value)
    monkeypatch.setattr(nrsfm, "reconstruct", fake, raising=False)
    return fake


@pytest.fixture
def tracks_file(tmp_path):
    """Tracks, with the true shapes and cameras in the same file."""
    rng = np.random.default_rng(0)
    shapes = rng.standard_normal((5, 8, 3))
    np.savez(
        tmp_path / "tracks.npz",
        tracks=shapes[..., :2],
        shapes=shapes,
        rotations=np.stack([np.eye(3)] * 5),
    )
    return tmp_path / "tracks.npz"


@pytest.fixture
def real_result():
    """What tracks with holes give: 6 frames of 10 points, one without a shape, deviations of 0.5, two unseen."""
    rng = np.random.default_rng(1)
    q, _ = np.linalg.qr(rng.standard_normal((6, 3, 3)))
    shapes, confidence, deviation = rng.standard_normal((6, 10, 3)), np.ones((6, 10)), np.full((6, 10), 0.5)
    shapes[:, 9], confidence[:, 9], deviation[:, 9] = np.nan, 0.0, np.nan
    confidence[0, :2], confidence[1, 0] = 0.0, 0.01
    return Reconstruction(
        shapes=shapes,
        rotations=q * np.sign(np.linalg.det(q))[:, None, None],
        translations=np.zeros((6, 2)),
        scales=np.ones(6),
        groups=np.array([0, 0, 0, 1, 1, 1, 1, 1, 1, -1]),
        diagnostics={
            "repair": {"missing": 8, "outliers": 1},
            "mirror": {"rule": "nose towards the camera", "decided": True},
        },
        method="auto",
        confidence=confidence,
        depth_deviation=deviation,
    )


@pytest.fixture
def command(capsys):
    """Run ``nrsfm`` in this process: (exit code, stdout, stderr)."""

    def run(*words):
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return code, out, err

    return run
