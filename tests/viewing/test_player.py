"""The numbers of the player of reports: what is packed comes back, and is off by no more than is said."""

import itertools

import numpy as np
import pytest

from nrsfm import Reconstruction
from nrsfm.viewing import player
from nrsfm.viewing.player import codec, parts
from nrsfm.viewing.player.bundle import bundle
from nrsfm.viewing.viewer.colours import Scale


def unpacked(packed):
    """Shapes (F, N, 3) as the script mixes them, about the box's centre and over half its side."""
    found = codec.read(packed.about["parts"], packed.data)
    about = packed.about
    base = about["reach"] * (found["base"] / 32767.5 - 1)
    shapes = np.repeat(base[None], about["frames"], axis=0)
    for k, factor in enumerate(about["factors"]):
        shapes += (found["weights"][:, k] * factor)[:, None, None] * found[f"mode {k}"]
    return shapes.transpose(0, 2, 1), found


@pytest.mark.parametrize("name", ["mesh", "points", "sparse", "skeleton", "tiny", "two frames"])
def test_what_is_packed_comes_back_as_exactly_as_is_said(cases, name):
    case = cases[name]
    packed = player.pack(case.result, faces=case.faces, edges=case.edges)
    shapes, found = unpacked(packed)
    true = np.asarray(case.result.shapes, dtype=float)
    low, high = true.min(axis=(0, 1)), true.max(axis=(0, 1))
    gaps = np.linalg.norm(shapes * packed.about["half"] + (low + high) / 2 - true[:, packed.points], axis=2)
    assert np.sqrt(np.mean(gaps**2)) == pytest.approx(packed.rms, rel=0.02, abs=1e-6 * packed.size)
    assert gaps.max() == pytest.approx(packed.largest, rel=0.02, abs=1e-6 * packed.size)
    assert packed.rms < 2e-3 * packed.size
    assert sorted(packed.points.tolist()) == list(range(true.shape[1]))
    np.testing.assert_allclose(found["rotations"].reshape(-1, 3, 3), case.result.rotations, atol=1e-6)
    if case.faces is not None:
        assert turns(packed.points[found["faces"].T]) == turns(case.faces)
    if case.edges is not None:
        assert turns(np.sort(packed.points[found["edges"].T])) == turns(case.edges)


def turns(faces):
    """Triangles, or lines, whichever corner they begin with."""
    return sorted(tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in faces)


def test_points_without_a_shape_and_their_triangles_are_left_out(cases):
    case = cases["mesh"]
    shapes = case.result.shapes.copy()
    shapes[:, :5] = np.nan
    lost = Reconstruction(shapes, case.result.rotations, case.result.translations, case.result.scales)
    packed = player.pack(lost, faces=case.faces)
    assert set(packed.points.tolist()) == set(range(5, shapes.shape[1]))
    found = codec.read(packed.about["parts"], packed.data)
    assert turns(packed.points[found["faces"].T]) == turns(case.faces[(case.faces >= 5).all(axis=1)])


def test_scales_keep_their_order_and_what_is_not_known(cases):
    result = cases["points"].result
    frames, points = result.shapes.shape[:2]
    steps = np.random.default_rng(0).integers(0, 255, (frames, points), dtype=np.uint8)
    steps[2, 7] = 255
    packed = player.pack(result, scales={"error": Scale(steps, 0.0, 4.0)})
    levels = codec.read(packed.about["parts"], packed.data)["error"]
    top = packed.about["levels"]
    for f, i in itertools.product(range(frames), range(0, points, 97)):
        level = int(levels[f, list(packed.points).index(i)])
        assert abs(level * 254 / (top - 1) - int(steps[f, i])) <= 254 / top, (f, i)
    assert levels[2, list(packed.points).index(7)] == top
    assert (levels == top).sum() == 1
    assert packed.about["rows"] == ["error"]


def test_more_points_than_allowed_are_thinned_and_have_no_surface(cases):
    case = cases["mesh"]
    packed = player.pack(case.result, faces=case.faces, most_points=100)
    assert len(packed.points) == len(set(packed.points.tolist())) == 100
    assert packed.about["triangles"] == 0


@pytest.mark.parametrize(
    ("dtype", "along"),
    [
        (np.float32, ""),
        *itertools.product((np.uint8, np.int8, np.uint16, np.int16, np.uint32), ("", "rows", "columns")),
    ],
)
def test_the_codec_loses_nothing(dtype, along):
    rng = np.random.default_rng(1)
    if dtype is np.float32:
        array = rng.normal(size=(3, 17)).astype(dtype)
    else:
        limits = np.iinfo(dtype)
        array = rng.integers(limits.min, limits.max, (3, 17), dtype=dtype, endpoint=True)
        array[0, :4] = limits.min, limits.max, limits.min, limits.max  # the differences overflow
    writer = codec.Writer()
    writer.add("first", np.arange(5, dtype=np.uint8))
    writer.add("array", array, along)
    found = codec.read(writer.parts, writer.finish())
    np.testing.assert_array_equal(found["array"], array)
    assert found["array"].dtype == dtype


def test_modules_come_after_what_they_need_and_once():
    modules = {
        "a": 'import { b } from "./b.js";\nimport { c } from "./c.js";\nb(c);\n',
        "b": 'import { c } from "./c.js";\nexport function b() { return c; }\n',
        "c": "export const c = 1;\n",
    }
    text = bundle("a", modules.__getitem__)
    places = [text.index(f"const from_{name} =") for name in "cba"]
    assert places == sorted(places)
    assert text.count("const c = 1;") == 1
    assert "const { c } = from_c;" in text
    assert "import" not in text
    assert "export" not in text


@pytest.mark.parametrize(
    "text", ['import x from "./c.js";\n', "export default 1;\n", 'const x = import("./c.js");\n', "export { x };\n"]
)
def test_other_forms_of_modules_are_refused(text):
    with pytest.raises(ValueError, match="not known"):
        bundle("a", {"a": text, "c": ""}.__getitem__)


def test_a_module_that_needs_itself_is_refused():
    with pytest.raises(ValueError, match="needs itself"):
        bundle("a", {"a": 'import { b } from "./b.js";\n', "b": 'import { a } from "./a.js";\n'}.__getitem__)


def test_the_players_script_is_whole_and_shares_the_viewers_drawing():
    text = parts.script()
    assert all(f"const from_{name} =" in text for name in ("stage", "normals", "order", "matrix", "pointers", "player"))
    assert "</script" not in text
