"""Measures of single experiments, against what is known of made-up reconstructions."""

import numpy as np
import pytest

from nrsfm.datasets.sequence import Sequence
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.experiments.base import Cell, Data
from nrsfm.experiments.extra_measures import MEASURES, acceleration, fits, gallery, links, yardsticks
from nrsfm.experiments.measures import Measured
from nrsfm.metrics import shape_error
from nrsfm.reconstruction import Reconstruction
from nrsfm.tracks import Tracks


@pytest.fixture(scope="module")
def face():
    return face_sequence(16, 300, camera="fast")


@pytest.fixture
def measured(face, tmp_path):
    def make(shapes=None, rotations=None, sequence=face, known=True, groups=None):
        shapes = sequence.shapes if shapes is None else shapes
        rotations = sequence.rotations if rotations is None else rotations
        result = Reconstruction(
            shapes,
            rotations,
            sequence.tracks.points.mean(axis=1),
            np.ones(len(shapes)),
            groups,
            {"cameras": {"known": known}},
            "bmm",
        )
        return Measured(result, sequence, Cell(Data("x"), "bmm"), 1.0, None, None, tmp_path, "stem")

    return make


def test_the_truth_fits_in_any_object_frame(face, measured):
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    found = fits(measured(face.shapes @ turn, face.rotations @ turn))
    assert found["reprojection"] == pytest.approx(0, abs=1e-9)
    assert found["shape"] == pytest.approx(0, abs=1e-6)


def test_fits_of_a_shape_that_is_too_large(face, measured):
    found = fits(measured(1.1 * face.shapes))
    assert found["reprojection"] == pytest.approx(0.1, rel=1e-6)
    assert found["shape"] == pytest.approx(0.1, rel=1e-6)


def test_yardsticks_are_errors_of_answers_that_lack_something(face, measured):
    found = yardsticks(measured())
    mean = np.broadcast_to((face.shapes - face.shapes.mean(axis=1, keepdims=True)).mean(axis=0), face.shapes.shape)
    assert found["rigid"] == pytest.approx(shape_error(mean, face.shapes, "per-frame"))
    seen = np.einsum("fij,fpj->fpi", face.rotations, face.shapes)
    flat = seen * (1, 1, 0)
    assert found["flat"] == pytest.approx(shape_error(flat, seen, "none"), rel=1e-6)
    assert 30 < found["turn"] < 100


def test_a_tear_shows_in_the_acceleration_at_its_frame_alone(face, measured):
    torn = face.shapes.copy()
    torn[8:, :, 2] += 5.0 * np.sign(torn[:1, :, 0])
    found = acceleration(measured(torn))
    error = np.array(found["error"])
    assert len(error) == 14
    assert set(np.flatnonzero(error > 1e-6)) == {6, 7}  # frames 7 and 8, either side of the border
    assert found["truth"] == acceleration(measured())["truth"]
    assert max(acceleration(measured())["error"]) == pytest.approx(0, abs=1e-12)
    assert len(found["track"]) == len(found["true_track"]) == 16


def test_without_the_true_cameras_there_is_no_common_frame(measured):
    assert acceleration(measured(known=False)) is None


def test_the_gallery_keeps_what_a_picture_needs(face, measured):
    found = gallery(measured(groups=np.arange(300) % 4))
    assert set(found) == {"arrays"}
    with np.load(measured().folder / found["arrays"]) as kept:
        arrays = {name: kept[name] for name in kept.files}
    assert set(arrays) == {"frame", "tracks", "widest", "shape", "truth", "groups", "triangles"}
    frame = int(arrays["frame"])
    np.testing.assert_allclose(arrays["tracks"], face.tracks.points[frame], rtol=1e-5)
    np.testing.assert_allclose(arrays["shape"], arrays["truth"], atol=1e-3)
    # In view coordinates: the average view turns the shape, and keeps its size.
    centred = face.shapes[frame] - face.shapes[frame].mean(axis=0)
    assert np.linalg.norm(arrays["truth"]) == pytest.approx(np.linalg.norm(centred), rel=1e-5)


def test_few_points_without_a_mesh_are_joined_by_lines(measured):
    rng = np.random.default_rng(0)
    shapes = np.tile(rng.standard_normal((20, 3)), (5, 1, 1))
    rotations = np.tile(np.eye(3), (5, 1, 1))
    sequence = Sequence("some", Tracks(shapes[..., :2].copy()), shapes, rotations)
    found = gallery(measured(sequence=sequence))
    with np.load(measured().folder / found["arrays"]) as kept:
        assert "triangles" not in kept.files
        assert len(kept["edges"]) >= 19


def test_lines_join_what_moves_together():
    # Two rods that pass each other: their points come near, but not for long.
    time = np.linspace(-3, 3, 30)[:, None]
    rod = np.linspace(0, 2, 6)[None]
    left = np.stack([rod + 0 * time, 0 * rod + time, 0 * rod + 0 * time], axis=2)
    right = np.stack([rod + 0 * time, 0 * rod - time, 0 * rod + 0 * time + 0.05], axis=2)
    found = links(np.concatenate([left, right], axis=1))
    between = [(a, b) for a, b in found.tolist() if (a < 6) != (b < 6)]
    assert len(between) == 1  # the tree needs one
    assert {(i, i + 1) for i in range(5)} <= {(a, b) for a, b in found.tolist()}


def test_every_measure_is_named():
    assert set(MEASURES) == {"fits", "yardsticks", "acceleration", "gallery"}
