"""The file read by pygltflib and trimesh and animated by a few lines of our own, against shapes and tracks.

Tolerances: float32 of numbers of the object's size, 1e-5 of it, where all targets are kept.
"""

import json
import math

import numpy as np
import pygltflib
import pytest
import trimesh
from scipy.spatial.transform import Rotation, Slerp

import nrsfm.export as export
from nrsfm.errors import OptionError
from nrsfm.export.colours import linear

from .conftest import COLUMNS, FRAMES, ROWS, bending_sheet, seen_in_perspective, view, with_perspective

GRID = f"grid:{ROWS}x{COLUMNS}"
TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class File:
    """A glb file: accessors as arrays, and nodes at any time."""

    def __init__(self, path):
        self.tree = pygltflib.GLTF2().load(str(path))
        self.blob = self.tree.binary_blob()
        self.mesh = self.tree.meshes[0]
        self.primitive = self.mesh.primitives[0]

    def array(self, number):
        accessor = self.tree.accessors[number]
        part = self.tree.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        start = (part.byteOffset or 0) + (accessor.byteOffset or 0)
        found = np.frombuffer(self.blob, TYPES[accessor.componentType], accessor.count * width, start)
        return found.reshape(-1, width) if width > 1 else found

    def attribute(self, name):
        return self.array(getattr(self.primitive.attributes, name))

    def animated(self, node, path, time):
        """The value of a node's property at a time, linear between keyframes (turns: spherical)."""
        animation = self.tree.animations[0]
        for channel in animation.channels:
            if (channel.target.node, channel.target.path) == (node, path):
                sampler = animation.samplers[channel.sampler]
                assert sampler.interpolation == "LINEAR"
                times = self.array(sampler.input).astype(float)
                values = self.array(sampler.output).reshape(len(times), -1).astype(float)
                if path == "rotation":
                    return Slerp(times, Rotation.from_quat(values))(np.clip(time, times[0], times[-1])).as_matrix()
                return np.array([np.interp(time, times, column) for column in values.T])
        return {"rotation": np.eye(3), "scale": np.ones(3)}.get(
            path, np.array(self.tree.nodes[node].translation or [0, 0, 0], dtype=float)
        )

    def world(self, time):
        """Points of the surface in the world."""
        shape = self.attribute("POSITION").astype(float)
        if self.primitive.targets:
            weights = self.animated(0, "weights", time)
            for weight, target in zip(weights, self.primitive.targets, strict=True):
                shape = shape + weight * self.array(target["POSITION"])
        turned = (shape * self.animated(0, "scale", time)) @ self.animated(0, "rotation", time).T
        return turned + self.animated(0, "translation", time)

    def seen(self, time):
        """The points in the frame of the camera."""
        return view(self.world(time), self.animated(1, "rotation", time), self.animated(1, "translation", time))


def written(result, path, **options):
    found = export.write(result, path, **{"targets": FRAMES, "faces": GRID, **options})
    return File(path), found


def test_shapes_come_back_at_keyframes_and_between(tmp_path):
    result = bending_sheet(scales=False)
    file, found = written(result, tmp_path / "a b ü.glb", scale=1.0, fps=10, reference=2)
    upright = result.shapes.astype(float) @ result.rotations[2].T * [1, -1, -1]
    for f in range(FRAMES):
        np.testing.assert_allclose(file.world(f / 10), upright[f], atol=1e-3)
    for f in (0.5, 3.25, 5.9):
        low, part = int(f), f % 1
        between = (1 - part) * upright[low] + part * upright[low + 1]
        np.testing.assert_allclose(file.world(f / 10), between, atol=1e-3)
    assert found.truncation["largest"] < 1e-3
    assert found.truncation["targets"] <= FRAMES - 1


def test_the_camera_sees_the_tracks(result, frame, tmp_path):
    file, found = written(result, tmp_path / "x.glb", frame=frame, image_size=(640, 480), reference=3)
    lens, image = file.tree.cameras[0].orthographic, result.project()
    for f in range(FRAMES):
        seen = file.seen(f / 25)
        x, y = seen[:, 0] / lens.xmag, seen[:, 1] / lens.ymag  # from -1 to 1 in the picture
        pixels = np.column_stack([(x + 1) / 2 * 640, (1 - y) / 2 * 480]) - 0.5
        np.testing.assert_allclose(pixels, image[f], atol=1e-2)
        assert (lens.znear < -seen[:, 2]).all()
        assert (-seen[:, 2] < lens.zfar).all()
    assert found.camera == "orthographic"


def test_in_the_reference_frame_both_views_are_the_same(result, tmp_path):
    files = [written(result, tmp_path / f"{frame}.glb", frame=frame, reference=3)[0] for frame in ("object", "camera")]
    np.testing.assert_allclose(files[0].world(3 / 25), files[1].world(3 / 25), atol=1e-6)
    np.testing.assert_allclose(files[0].animated(1, "rotation", 3 / 25), np.eye(3), atol=1e-6)


def test_a_still_camera_between_keyframes_turns_the_short_way(result, tmp_path):
    file, _ = written(result, tmp_path / "x.glb", frame="camera")
    animation = file.tree.animations[0]
    turns = next(
        file.array(animation.samplers[c.sampler].output) for c in animation.channels if c.target.path == "rotation"
    )
    assert (np.sum(turns[1:] * turns[:-1], axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, atol=1e-6)


def test_a_perspective_camera_sees_what_was_seen(frame, tmp_path):
    result = with_perspective(bending_sheet())
    file, found = written(result, tmp_path / "x.glb", frame=frame, image_size=(640, 480), reference=1)
    assert found.camera == "perspective"
    lens = file.tree.cameras[0].perspective
    half = math.tan(lens.yfov / 2)
    for f in range(FRAMES):
        seen = file.seen(f / 25)
        x, y = seen[:, 0] / -seen[:, 2] / (half * lens.aspectRatio), seen[:, 1] / -seen[:, 2] / half
        # The view is symmetric about the principal point (310, 250) and holds the image.
        pixels = np.column_stack([310 + 329.5 * x, 250 - 250.5 * y])
        np.testing.assert_allclose(pixels, seen_in_perspective(result, f), atol=1e-2)


def test_the_largest_side_is_a_metre_unless_told(result, tmp_path):
    _, found = written(result, tmp_path / "x.glb")
    size = np.ptp(result.shapes[0] @ result.rotations[0].T, axis=0).max()
    assert found.unit == pytest.approx(1 / size, rel=1e-3)
    file, _ = written(result, tmp_path / "y.glb", scale=0.01)
    assert np.ptp(file.world(0.0), axis=0)[0] == pytest.approx(
        0.01 * result.scales[0] / result.scales.mean() * 140, rel=0.1
    )


def test_what_is_cut_off_is_told_in_the_file_and_by_the_call(result, tmp_path):
    rng = np.random.default_rng(0)
    import dataclasses

    noisy = dataclasses.replace(result, shapes=result.shapes + rng.standard_normal(result.shapes.shape).astype("f4"))
    file, found = written(noisy, tmp_path / "x.glb", targets=2, scale=1.0)
    cut = file.tree.asset.extras["nrsfm"]["truncation"]
    assert cut == found.truncation
    assert len(file.primitive.targets) == cut["targets"] == 2
    upright = noisy.shapes.astype(float) @ noisy.rotations[0].T * [1, -1, -1]
    growth = noisy.scales / noisy.scales.mean()
    gaps = [np.linalg.norm(file.world(f / 25) / growth[f] - upright[f], axis=1) for f in range(FRAMES)]
    assert cut["rms"] == pytest.approx(np.sqrt(np.mean(np.square(gaps))), rel=1e-3)
    assert cut["largest"] == pytest.approx(np.max(gaps), rel=1e-3)


def test_at_rest_it_shows_the_reference_frame(result, tmp_path):
    file, _ = written(result, tmp_path / "x.glb", reference=4)
    weights = file.animated(0, "weights", 4 / 25)
    np.testing.assert_allclose(file.mesh.weights, weights, atol=1e-6)
    assert min(file.mesh.weights) >= 0
    assert len(file.mesh.extras["targetNames"]) == len(weights)


def test_trimesh_finds_the_same_surface(holed, tmp_path):
    file, found = written(holed, tmp_path / "x.glb", colours="groups")
    scene = trimesh.load(tmp_path / "x.glb", process=False)
    (mesh,) = scene.geometry.values()
    np.testing.assert_allclose(mesh.vertices, file.attribute("POSITION"), atol=1e-6)
    assert len(mesh.faces) == found.faces
    np.testing.assert_array_equal(mesh.faces.ravel(), file.array(file.primitive.indices))


def test_points_have_morph_targets_too(holed, tmp_path):
    file, found = written(holed, tmp_path / "x.glb", faces=None, colours="#204080", scale=1.0)
    kept = np.flatnonzero(holed.reconstructed)
    assert (found.faces, found.left_out, file.primitive.mode, file.primitive.indices) == (0, 2, 0, None)
    np.testing.assert_array_equal(file.attribute("_POINT"), kept)
    np.testing.assert_array_equal(file.attribute("_GROUP"), holed.groups[kept])
    np.testing.assert_allclose(file.attribute("_CONFIDENCE"), holed.confidence.mean(axis=0)[kept], atol=1e-6)
    light = file.attribute("COLOR_0")[:, :3] / 65535
    np.testing.assert_allclose(light, np.tile(linear(np.array([0x20, 0x40, 0x80])), (46, 1)), atol=1e-4)
    assert file.attribute("COLOR_0").shape == (46, 4)


def check_rules(path):
    """Rules of the specification that a reader may rely on, from the bytes up."""
    data = path.read_bytes()
    magic, version, total, length, kind = np.frombuffer(data, "<u4", 5)
    assert (magic, version, total, kind) == (0x46546C67, 2, len(data), 0x4E4F534A)
    assert length % 4 == 0
    tree = json.loads(data[20 : 20 + length])
    size, word = np.frombuffer(data, "<u4", 2, 20 + length)
    assert (size, word) == (tree["buffers"][0]["byteLength"], 0x004E4942)
    blob = data[28 + length :]
    assert len(blob) == size
    assert size % 4 == 0
    indices = [p["indices"] for m in tree["meshes"] for p in m["primitives"] if "indices" in p]
    for number, accessor in enumerate(tree["accessors"]):
        part = tree["bufferViews"][accessor["bufferView"]]
        dtype = np.dtype(TYPES[accessor["componentType"]])
        width = WIDTHS[accessor["type"]]
        assert part["byteLength"] == accessor["count"] * width * dtype.itemsize
        assert part["byteOffset"] % 4 == 0
        assert part["byteOffset"] + part["byteLength"] <= size
        values = np.frombuffer(blob, dtype, accessor["count"] * width, part["byteOffset"]).reshape(-1, width)
        if "min" in accessor:
            assert values.min(axis=0).tolist() == accessor["min"]
            assert values.max(axis=0).tolist() == accessor["max"]
        assert np.isfinite(values.astype(float)).all()
        assert accessor["componentType"] != 5125 or number in indices
    for primitive in tree["meshes"][0]["primitives"]:
        count = tree["accessors"][primitive["attributes"]["POSITION"]]["count"]
        used = [*primitive["attributes"].values(), *(t["POSITION"] for t in primitive.get("targets", []))]
        assert {tree["accessors"][number]["count"] for number in used} == {count}
        for name in [primitive["attributes"]["POSITION"], *(t["POSITION"] for t in primitive.get("targets", []))]:
            assert {"min", "max"} <= tree["accessors"][name].keys()
        if "indices" in primitive:
            assert tree["accessors"][primitive["indices"]]["max"][0] < count
        assert len(tree["meshes"][0].get("weights", [])) == len(primitive.get("targets", []))
    for sampler in tree["animations"][0]["samplers"]:
        times = tree["accessors"][sampler["input"]]
        assert times["min"][0] >= 0
        assert {"min", "max"} <= times.keys()
    return tree


@pytest.mark.parametrize("faces", [None, GRID])
def test_the_rules_of_the_format(holed, faces, frame, tmp_path):
    written(holed, tmp_path / "x.glb", faces=faces, frame=frame, colours="depth")
    check_rules(tmp_path / "x.glb")


def test_large_meshes_have_wider_indices(tmp_path):
    from nrsfm.reconstruction import Reconstruction

    rows, columns = np.mgrid[:256, :257].astype(np.float32)
    shape = np.column_stack([columns.ravel(), rows.ravel(), np.zeros(rows.size)])
    one = Reconstruction(shape[None], np.eye(3)[None], np.zeros((1, 2)), np.ones(1))
    export.write(one, tmp_path / "x.glb", faces="grid:256x257")
    tree = check_rules(tmp_path / "x.glb")
    indices = tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]
    assert (indices["componentType"], indices["max"]) == (5125, [256 * 257 - 1])
    assert "targets" not in tree["meshes"][0]["primitives"][0]


def test_other_axes_are_refused(result, tmp_path):
    with pytest.raises(OptionError, match="y-up for glb"):
        export.write(result, tmp_path / "x.glb", axes="z-up")
