"""The gallery, on arrays that are made up."""

import numpy as np
import pytest

from nrsfm.datasets.synthetic import face_sequence
from nrsfm.experiments.base import Scope
from nrsfm.experiments.gallery import Gallery, upright

EXPERIMENT = Gallery()
SEQUENCES = ("face-seq1", "pickup", "back_real126")


@pytest.fixture(autouse=True)
def coarse_panels(monkeypatch):
    monkeypatch.setattr("nrsfm.viewing.panels._PIXELS_PER_INCH", 40)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Arrays of a mesh, of lines, and of points without truth and groups."""
    folder, sequence = tmp_path_factory.mktemp("gallery"), face_sequence(2, 300)
    shape = sequence.shapes[0].astype(np.float32)
    whole = {
        "frame": np.array(3),
        "tracks": shape[:, :2],
        "widest": shape[:, :2],
        "shape": shape,
        "truth": shape,
        "groups": np.arange(300) // 75,
    }
    some = np.arange(0, 300, 8)
    lines = {name: value if name == "frame" else value[some] for name, value in whole.items()}
    lines["edges"] = np.stack([np.arange(len(some) - 1), np.arange(1, len(some))], axis=1)
    lines["truth"] = lines["truth"].copy()
    lines["truth"][3] = np.nan  # not known
    bare = {name: whole[name] for name in ("frame", "tracks", "widest", "shape")}
    arrays = {"face-seq1": whole | {"triangles": sequence.faces}, "pickup": lines, "back_real126": bare}
    found = {}
    for name, values in arrays.items():
        found[name] = str(folder / f"{name}.npz")
        np.savez(found[name], **values)
    return found


def rows(files, error=0.05):
    cells = EXPERIMENT.cells(Scope(False, SEQUENCES))
    return EXPERIMENT.rows(
        cells,
        {
            c.key: {
                "frames": 10,
                "points": 300,
                "errors": {"per-frame": None if c.data.sequence == "back_real126" else error},
                "rotation": None,
                "groups": 4,
                "gallery": files[c.data.sequence],
            }
            for c in cells
        },
    )


def test_a_page_for_each_kind_with_a_row_for_each_sequence(files):
    found = EXPERIMENT.pictures(rows(files))
    assert [picture.name for picture in found] == ["gallery-faces", "gallery-surfaces", "gallery-motion-capture"]
    assert [len(picture.figure.axes) for picture in found] == [6, 4, 6]
    words = [text.get_text() for text in found[1].figure.texts]
    assert {"back", "10 × 300", "frame 3", "no truth", "not known", "none"} <= set(words)


def test_sequences_of_no_kind_are_drawn_too(files):
    found = [row | {"sequence": "something else"} for row in rows(files)[:1]]
    assert [picture.name for picture in EXPERIMENT.pictures(found)] == ["gallery-others"]


def test_upright_turns_and_does_not_mirror(files):
    with np.load(files["pickup"]) as kept:
        arrays = {name: kept[name] for name in kept.files}
    turned = upright(arrays, "pickup")
    np.testing.assert_array_equal(turned["tracks"], arrays["tracks"] * (1, -1))
    np.testing.assert_array_equal(turned["shape"], arrays["shape"] * (1, -1, -1))
    assert upright(arrays, "back_real126") is arrays


@pytest.mark.parametrize(("error", "verdict"), [(0.05, "reproduced"), (0.2, "not reproduced")])
def test_findings_follow_the_numbers(files, error, verdict):
    (finding,) = EXPERIMENT.findings(rows(files, error))
    assert finding.verdict == verdict
    assert ("pickup (.2000)" in finding.text) == (error == 0.2)


def test_some_far_is_in_part(files):
    found = [row | {"e3d": 0.3} if row["sequence"] == "pickup" else row for row in rows(files)]
    (finding,) = EXPERIMENT.findings(found)
    assert finding.verdict == "in part"
    assert "1 of 2 sequences" in finding.text


def test_the_table_has_a_row_for_each(files):
    assert "| face 1 | 10 × 300 | .0500 | – | 4 |" in EXPERIMENT.table(rows(files))


def test_long_sequences_are_cut_and_built_in_ones_are_not_lengthened():
    cells = EXPERIMENT.cells(Scope(False, ("drink", "built-in-face1")))
    assert [cell.data.frames for cell in cells] == [400, None]
