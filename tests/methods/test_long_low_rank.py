"""What the methods do differently with long sequences, against what they do with others."""

import numpy as np
import pytest

from nrsfm import reconstruct, shape_error
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.methods import auto, get_method, local
from nrsfm.methods.base import Problem


def problem_of(made, cells=3):
    """The tracks of a made sequence, of unit rms, their points dealt out to cells."""
    tracks = np.moveaxis(made.tracks - made.tracks.mean(axis=1, keepdims=True), 2, 1)
    tracks = tracks / np.sqrt(np.mean(tracks**2))
    offsets = np.linspace(0, tracks.shape[2], cells + 1).astype(int)
    return Problem(tracks, offsets, np.diff(offsets), np.ascontiguousarray(made.rotations[:, :2]), 0.0)


def solved(name, problem):
    method = get_method(name)
    return method.solve(problem, method.Options(), np.random.default_rng(0), lambda _: None)


def test_merging_cuts_no_more_than_it_is_told(sequence):
    problem = problem_of(sequence(frames=30, points=70, rank=2, noise=1e-3))
    whole, _ = problem.merged()
    assert np.sum(whole.tracks**2) == pytest.approx(np.sum(problem.tracks**2), rel=1e-12)
    for level in (1e-4, 1e-2):
        cut, back = problem.merged(level)
        assert cut.tracks.shape[2] <= whole.tracks.shape[2]
        lost = problem.tracks - cut.tracks @ back
        assert np.sqrt(np.mean(lost**2)) <= level
    assert cut.tracks.shape[2] < whole.tracks.shape[2]


def test_geometry_aware_with_cut_directions_is_the_same(sequence, monkeypatch):
    problem = problem_of(sequence(frames=40, points=120, rank=3, noise=1e-6))
    usual = solved("geometry-aware", problem)
    assert usual.chosen["cut"] < 1e-9
    monkeypatch.setattr(local, "LONG", 0)
    cut = solved("geometry-aware", problem)
    assert cut.chosen["directions"] < usual.chosen["directions"]
    assert 0.0 < cut.chosen["cut"] <= local.MERGED
    gap = np.linalg.norm(cut.shapes - usual.shapes) / np.linalg.norm(usual.shapes)
    assert gap < 10 * local.MERGED


def test_all_frames_are_key_frames_of_sequences_that_are_not_long():
    np.testing.assert_array_equal(auto.key_frames(auto.LONG), np.arange(auto.LONG))
    keys = auto.key_frames(auto.LONG + 1)
    assert len(keys) == auto.KEY_FRAMES
    assert keys[0] == 0
    assert keys[-1] == auto.LONG
    assert np.all(np.diff(keys) > 0)


@pytest.fixture
def few_keys(monkeypatch):
    """Sequences of more than 50 frames count as long."""
    monkeypatch.setattr(auto, "LONG", 50)
    monkeypatch.setattr(auto, "KEY_FRAMES", 45)


def test_exact_shapes_are_found_from_key_frames(sequence, few_keys):
    made = sequence(frames=90, points=30, rank=2)
    problem = problem_of(made)
    found = solved("auto", problem)
    assert found.chosen["key_frames"] == 45
    size = np.linalg.norm(made.shapes, axis=(1, 2)) / np.linalg.norm(found.shapes, axis=(1, 2))
    shapes = np.swapaxes(found.shapes, 1, 2) * size.mean()
    assert shape_error(shapes, made.shapes, align="per-frame") < 1e-3


def test_shapes_that_begin_on_key_frames_are_as_good(monkeypatch):
    face = face_sequence(frames=56, points=90, noise=0.01)
    given = {"rotations": face.rotations, "deviation": False, "trajectories": False}
    usual = reconstruct(face.tracks, **given)
    assert "key_frames" not in usual.diagnostics["chosen"]
    monkeypatch.setattr(auto, "LONG", 50)
    monkeypatch.setattr(auto, "KEY_FRAMES", 45)
    keyed = reconstruct(face.tracks, **given)
    assert keyed.diagnostics["chosen"]["key_frames"] == 45
    before, after = (shape_error(found.shapes, face.shapes, align="per-frame") for found in (usual, keyed))
    assert after <= 1.05 * before + 1e-4
