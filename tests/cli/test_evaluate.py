import json

import numpy as np
import pytest

from nrsfm.reconstruction import Reconstruction


@pytest.fixture
def result():
    rng = np.random.default_rng(1)
    q, _ = np.linalg.qr(rng.standard_normal((6, 3, 3)))
    return Reconstruction(
        shapes=rng.standard_normal((6, 9, 3)),
        rotations=q * np.sign(np.linalg.det(q))[:, None, None],
        translations=np.zeros((6, 2)),
        scales=np.ones(6),
    )


@pytest.fixture
def saved(result, tmp_path):
    result.save(tmp_path / "r.npz")
    return tmp_path / "r.npz"


def test_the_truth_itself_has_no_error(command, saved):
    code, out, err = command("evaluate", saved, saved, "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert list(found["shape_error"]) == ["none", "global", "per-frame", "similarity"]
    assert max(found["shape_error"].values()) < 1e-6
    assert found["mocap_error"] < 1e-6
    assert found["rotation_error_degrees"] < 1e-4


@pytest.mark.parametrize("where", [0, 1, 2])
def test_table_has_each_score_in_a_line_wherever_the_options_stand(command, saved, where):
    words = [saved, saved]
    words.insert(where, "--truth-frame=object")
    code, out, _ = command("evaluate", *words)
    assert code == 0
    assert [line.split("  ")[0] for line in out.splitlines()] == [
        "3D error e3D, align none",
        "3D error e3D, align global",
        "3D error e3D, align per-frame",
        "3D error e3D, align similarity",
        "mocap error, align global",
        "rotation error",
    ]


def test_truth_in_the_camera_frame(command, result, saved, tmp_path):
    np.savez(tmp_path / "truth.npz", shapes=result.camera_shapes())
    _, out, _ = command("evaluate", saved, tmp_path / "truth.npz", "--truth-frame", "camera", "--json")
    found = json.loads(out)
    assert max(found["shape_error"].values()) < 1e-6
    assert found["rotation_error_degrees"] is None
    _, out, _ = command("evaluate", saved, tmp_path / "truth.npz", "--json")
    assert json.loads(out)["shape_error"]["global"] > 0.1


def test_points_that_are_not_known_do_not_count(command, result, saved, tmp_path):
    valid = np.ones((6, 9), dtype=bool)
    valid[2, 3] = False
    shapes = result.shapes.copy()
    shapes[2, 3] = 1e6
    np.savez(tmp_path / "truth.npz", shapes=shapes, valid=valid)
    code, out, _ = command("evaluate", saved, tmp_path / "truth.npz", "--json")
    assert code == 0
    assert max(json.loads(out)["shape_error"].values()) < 1e-6
    assert json.loads(out)["mocap_error"] is None


def test_points_without_a_shape_are_not_scored_and_it_is_said(command, real_result, tmp_path):
    real_result.save(tmp_path / "r.npz")
    shapes = real_result.shapes.copy()
    shapes[:, 9] = 1e6
    np.savez(tmp_path / "truth.npz", shapes=shapes, rotations=real_result.rotations)
    code, out, err = command("evaluate", tmp_path / "r.npz", tmp_path / "truth.npz", "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert max(found["shape_error"].values()) < 1e-6
    assert found["mocap_error"] < 1e-6
    assert (found["points"], found["scored_points"], found["scored_entries"]) == (10, 9, 54)
    assert found["depth_calibration"]["within_1"] == 1.0
    assert (found["depth_calibration"]["entries"], found["depth_calibration"]["cameras"]) == (54, "true")
    _, out, _ = command("evaluate", tmp_path / "r.npz", tmp_path / "truth.npz")
    assert "  9 of 10 points, 54 of 60 entries" in out
    assert "  100.0 % and 100.0 % (68.3 % and 95.4 % of normal errors)" in out


@pytest.mark.parametrize("frame", ["object", "camera"])
def test_depth_errors_are_compared_with_their_deviations(command, tmp_path, frame):
    rng = np.random.default_rng(2)
    q, _ = np.linalg.qr(rng.standard_normal((6, 3, 3)))
    rotations = q * np.sign(np.linalg.det(q))[:, None, None]
    seen = rng.standard_normal((6, 200, 3))
    wrong = seen + 0.1 * rng.standard_normal((6, 200, 1)) * [0, 0, 1]
    shapes, truth = (np.einsum("fji,fpj->fpi", rotations, array) for array in (wrong, seen))
    result = Reconstruction(shapes, rotations, np.zeros((6, 2)), np.ones(6), depth_deviation=np.full((6, 200), 0.1))
    result.save(tmp_path / "r.npz")
    stored = {"shapes": truth, "rotations": rotations} if frame == "object" else {"shapes": seen}
    np.savez(tmp_path / "truth.npz", **stored)
    _, out, _ = command("evaluate", tmp_path / "r.npz", tmp_path / "truth.npz", "--truth-frame", frame, "--json")
    found = json.loads(out)["depth_calibration"]
    assert found["within_1"] == pytest.approx(0.683, abs=0.05)
    assert found["within_2"] == pytest.approx(0.954, abs=0.03)
    assert found["cameras"] == "true"


def test_nothing_to_score_is_no_fault(command, real_result, tmp_path):
    real_result.save(tmp_path / "r.npz")
    valid = np.zeros((6, 10), dtype=bool)
    valid[:, 9] = True
    np.savez(tmp_path / "truth.npz", shapes=np.ones((6, 10, 3)), valid=valid)
    code, out, _ = command("evaluate", tmp_path / "r.npz", tmp_path / "truth.npz", "--json")
    found = json.loads(out)
    assert (code, found["scored_entries"], found["depth_calibration"]) == (0, 0, None)
    assert found["shape_error"]["global"] is None


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda path: np.savez(path, shapes=np.zeros((6, 8, 3))), "the truth has 6 frames of 8 points"),
        (lambda path: np.savez(path, other=np.zeros(3)), "other"),
        (lambda path: path.write_bytes(b"PK"), "truth.npz"),
        (lambda path: None, "truth.npz"),
    ],
)
def test_wrong_truths_are_explained(command, saved, tmp_path, make, text):
    make(tmp_path / "truth.npz")
    code, out, err = command("evaluate", saved, tmp_path / "truth.npz")
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1


def test_something_else_is_no_reconstruction(command, tracks_file):
    code, _, err = command("evaluate", tracks_file, tracks_file)
    assert code == 2
    assert "is not a reconstruction: translations, scales, about missing" in err
