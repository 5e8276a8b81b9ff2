"""Eight camera paths, on made-up records."""

import pytest

from nrsfm.experiments.base import NOT_COMPARED, Scope
from nrsfm.experiments.camera_motion import CameraMotion
from nrsfm.experiments.paths import path_names
from nrsfm.methods import get_method, method_names

EXPERIMENT = CameraMotion()
SCOPE = Scope(False, ("ict-rom99",), ("bmm", "geometry-aware", "grassmann"))
RIGID = 0.05
WARNING = "the camera hardly turns: 2.0 degrees in all; depth and cameras are poorly determined"


def rows(error, warned):
    cells = EXPERIMENT.cells(SCOPE)
    return EXPERIMENT.rows(
        cells,
        {
            c.key: {
                "errors": {"per-frame": error(c.data.camera_path)},
                "rotation": 1.0,
                "warnings": [WARNING] if warned(c.data.camera_path) else ["which mirror image is shown is arbitrary"],
                "yardsticks": {"rigid": RIGID, "flat": 0.4, "turn": 30.0},
            }
            for c in cells
        },
    )


def breaks_when_still(path):
    return 0.3 if path in ("still", "pan5") else 0.02


def verdicts(found):
    return [finding.verdict for finding in EXPERIMENT.findings(found)]


def test_a_method_with_the_intersection_s_cameras_is_run_once():
    cells = EXPERIMENT.cells(Scope(False, ("ict-rom99",)))
    assert not NOT_COMPARED & {cell.method for cell in cells}
    for method in set(method_names()) - NOT_COMPARED:
        cameras = {cell.cameras for cell in cells if cell.method == method}
        same = get_method(method).camera_method == "intersection"
        assert cameras == ({"own"} if same else {"own", "intersection"})
    assert {cell.data.camera_path for cell in cells} == set(path_names())


@pytest.mark.parametrize(
    ("error", "warned", "expected"),
    [
        (breaks_when_still, lambda path: path in ("still", "pan5"), ["reproduced", "reproduced", "reproduced"]),
        (breaks_when_still, lambda path: False, ["reproduced", "reproduced", "not reproduced"]),
        (breaks_when_still, lambda path: path == "still", ["reproduced", "reproduced", "in part"]),
        (lambda path: 0.02, lambda path: True, ["not reproduced", "not reproduced", "not measured"]),
        (lambda path: 0.3 if path == "shake" else 0.02, lambda path: False, ["reproduced", *["not reproduced"] * 2]),
    ],
)  # fmt: skip
def test_findings_follow_the_numbers(error, warned, expected):
    assert verdicts(rows(error, warned)) == expected


def test_the_silent_are_named_and_false_alarms_counted():
    text = EXPERIMENT.findings(rows(breaks_when_still, lambda path: path != "still"))[2].text
    assert "Of 6 broken runs 3 warned." in text
    assert "BMM on still, Algorithm 1 on still and Algorithm 2 on still" in text
    assert "18 of 18 runs that did not break warned too" in text


def test_broken_is_twice_the_rigid_yardstick():
    found = rows(lambda path: 2.001 * RIGID if path == "turn" else 1.999 * RIGID, lambda path: False)
    assert {row["camera_path"] for row in found if row["broken"]} == {"turn"}


def test_pictures_and_table():
    found = rows(breaks_when_still, lambda path: path == "still")
    shapes, cameras = EXPERIMENT.pictures(found)
    words = [text.get_text() for text in shapes.figure.axes[0].texts]
    assert words.count(".300 ▴") == 3
    assert words.count(".300") == 3
    assert "1.0 ▴" in [text.get_text() for text in cameras.figure.axes[0].texts]
    assert "| BMM | **.3000 1.0° ▴** | **.3000 1.0°** | .0200 1.0° |" in "\n".join(EXPERIMENT.table(found))
