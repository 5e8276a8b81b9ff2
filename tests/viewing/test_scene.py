"""Alignment and views behind the pictures."""

import numpy as np
import pytest

from nrsfm.errors import InputError
from nrsfm.metrics import ALIGNMENTS, frame_errors
from nrsfm.viewing.scene import choose_frames, make_scene, turned


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_errors_are_those_of_the_metric(cases, align):
    case = cases["mesh"]
    scene = make_scene(case.result, case.truth, faces=case.faces, frames=range(5), align=align)
    np.testing.assert_allclose(scene.errors, frame_errors(case.result, case.truth, align), rtol=1e-6)


def test_percent_of_size_is_e3d(cases):
    case = cases["mesh"]
    scene = make_scene(case.result, case.truth, frames=[2])
    assert np.sqrt((scene.point_errors()[0] ** 2).mean()) / scene.size == pytest.approx(scene.errors[0])


def test_what_the_camera_sees_is_what_is_drawn(cases):
    case = cases["mesh"]
    centred = case.tracks - case.tracks.mean(axis=1, keepdims=True)
    for cameras in (None, case.rotations):
        scene = make_scene(case.result, case.truth, truth_rotations=cameras, frames=range(5))
        seen = np.einsum("fij,fpj->fpi", scene.views, scene.truth)[..., :2]
        # Without true cameras the estimated ones are used: a little off, but not turned or mirrored.
        np.testing.assert_allclose(seen, centred, atol=1e-6 if cameras is not None else 2.0)
        drawn = np.einsum("fij,fpj->fpi", scene.views, scene.shapes)[..., :2]
        assert np.abs(drawn - centred).mean() < 1.5


def test_a_mirrored_estimate_is_shown_as_it_is(cases):
    case = cases["mesh"]
    mirrored = case.result.mirrored()
    scene = make_scene(mirrored, case.truth, frames=[1])
    depth = (scene.shapes[0] @ scene.views[0].T)[:, 2]
    own = (mirrored.shapes[1] - mirrored.shapes[1].mean(axis=0)) @ mirrored.rotations[1].T
    np.testing.assert_allclose(depth, own[:, 2], atol=1e-3)


def test_unknown_truth_is_left_out(cases):
    case = cases["mesh"]
    valid = np.ones(case.truth.shape[:2], dtype=bool)
    valid[:, :200] = False
    holes = np.where(valid[..., None], case.truth, np.nan)
    by_mask = make_scene(case.result, case.truth, valid=valid, frames=[0, 3])
    by_nan = make_scene(case.result, holes, frames=[0, 3])
    np.testing.assert_allclose(by_mask.errors, by_nan.errors)
    np.testing.assert_allclose(by_mask.errors, frame_errors(case.result, case.truth, "per-frame", valid=valid)[[0, 3]])
    assert np.isnan(by_mask.point_errors()[:, :200]).all()
    assert np.isfinite(by_mask.point_errors()[:, 200:]).all()


def test_turning_to_the_side_brings_the_left_cheek_forward():
    # The object turns its face to the viewer's right, as the face in the pictures does.
    nose = turned(np.eye(3), -55.0) @ (0.0, 0.0, -1.0)
    assert nose[0] > 0.8
    assert abs(nose[1]) < 1e-12
    assert nose[2] < 0


def test_chosen_frames_differ():
    shapes = np.zeros((30, 10, 3))
    shapes[7] += np.random.default_rng(0).standard_normal((10, 3))
    shapes[19] -= 2 * np.random.default_rng(1).standard_normal((10, 3))
    chosen = choose_frames(shapes, 3)
    assert {7, 19} <= set(chosen)
    assert len(chosen) == 3
    assert (np.diff(chosen) > 0).all()
    assert choose_frames(shapes, 50).tolist() == list(range(30))
    assert len(choose_frames(np.full((9, 4, 3), np.nan), 4)) == 4


def test_average_view_of_a_pan_is_the_middle_one(cases):
    from nrsfm.datasets.synthetic import face_sequence

    s = face_sequence(21, 50, "pan90")
    np.testing.assert_allclose(make_scene(s.shapes, rotations=s.rotations).middle, s.rotations[10], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"truth": np.zeros((3, 3, 3))}, "truth"),
        ({"faces": [[0, 1, 900]]}, "faces"),
        ({"faces": [[0, 1]]}, "faces"),
        ({"faces": [[0.5, 1, 2]]}, "faces"),
        ({"edges": [[-1, 2]]}, "edges"),
        ({"frames": [5]}, "frames"),
        ({"frames": []}, "frames"),
        ({"frames": [0.5]}, "frames"),
        ({"align": "procrustes"}, "align"),
        ({"truth_rotations": np.zeros((2, 3, 3))}, "truth_rotations"),
        ({"rotations": np.zeros((5, 9))}, "rotations"),
        ({"valid": np.ones((5, 900))}, "valid"),
    ],
)
def test_bad_arguments(cases, change, word):
    case = cases["mesh"]
    with pytest.raises(InputError, match=f"^{word}") as caught:
        make_scene(case.result, **{"truth": case.truth, **change})
    assert "received" in str(caught.value)
