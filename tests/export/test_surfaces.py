"""Surfaces: what is given arrives, and what is found agrees with meshes that the rule has never seen."""

import numpy as np
import pytest

from nrsfm import datasets
from nrsfm.datasets.synthetic import face_sequence, sheet_sequence
from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.export.surfaces import checked_faces, find_surface
from nrsfm.reconstruction import Reconstruction

from .conftest import COLUMNS, LEFT_OUT, ROWS, bending_sheet


def reconstruction(shapes, rotations):
    return Reconstruction(shapes, rotations, np.zeros((len(shapes), 2)), np.ones(len(shapes)))


def sides(faces):
    pairs = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    return {tuple(pair) for pair in pairs.tolist()}


def agreement(found, true, points):
    """Share of found sides whose ends are at most two true sides apart, and share of true sides found.

    Two sides, not one: which way a cell is cut is not the surface's to say.
    """
    from scipy.sparse import csr_array

    pairs = np.array(sorted(sides(true)))
    both = np.concatenate([pairs, pairs[:, ::-1]]).T
    graph = csr_array((np.ones(both.shape[1]), tuple(both)), shape=(points, points))
    near = (graph @ graph + graph).tocsr()
    ours = np.array(sorted(sides(found)))
    right = np.asarray(near[ours[:, 0], ours[:, 1]]).ravel() > 0
    return right.mean(), len(sides(true) & sides(found)) / len(pairs)


@pytest.mark.parametrize(("make", "least"), [(face_sequence, (0.97, 0.8)), (sheet_sequence, (0.98, 0.65))])
def test_found_triangles_are_those_of_the_built_in_surfaces(make, least):
    sequence = make(frames=30, points=3000)
    surface = find_surface("auto", reconstruction(sequence.shapes, sequence.rotations))
    precision, recall = agreement(surface.faces, sequence.faces, 3000)
    assert precision > least[0]
    assert recall > least[1]
    assert surface.warnings == ()


@pytest.mark.parametrize(("name", "least"), [("face-seq4", (0.95, 0.7)), ("ict-rom99", (0.85, 0.7))])
def test_found_triangles_are_those_of_captured_heads(data_root, name, least):
    sequence = datasets.load(name, data_root)
    surface = find_surface("auto", reconstruction(sequence.shapes, sequence.rotations))
    precision, recall = agreement(surface.faces, sequence.faces, sequence.tracks.n_points)
    assert precision > least[0]
    assert recall > least[1]


def test_a_body_seen_through_is_warned_of(data_root):
    horse = datasets.load("mesh_horse_gallop", data_root)
    surface = find_surface("auto", reconstruction(horse.shapes, horse.rotations))
    assert "hardly one layer" in surface.warnings[0]


def test_what_is_apart_in_space_is_not_joined():
    """Two sheets, one behind the other and to its side: no triangle spans the gap, in the image or in depth."""
    rng = np.random.default_rng(0)
    front = np.column_stack([rng.uniform(-1, 0, 400), rng.uniform(-1, 1, 400), np.zeros(400)])
    behind = np.column_stack([rng.uniform(0, 1, 400), rng.uniform(-1, 1, 400), np.full(400, 3.0)])
    shapes = np.repeat(np.concatenate([front, behind])[None], 3, axis=0)
    faces = find_surface("auto", reconstruction(shapes, np.repeat(np.eye(3)[None], 3, axis=0))).faces
    assert len(faces) > 1200
    assert ((faces < 400).all(axis=1) | (faces >= 400).all(axis=1)).all()


def test_what_comes_apart_later_is_not_joined():
    """A mouth: one sheet in the first frame, two in the last."""
    rows, columns = np.mgrid[:10, :10].astype(float)
    sheet = np.column_stack([columns.ravel(), rows.ravel(), 0.1 * rows.ravel() * columns.ravel() / 9])
    opened = sheet + np.where(rows.ravel() >= 5, 8.0, 0.0)[:, None] * [0, 1, 0]
    shapes = np.stack([sheet, (sheet + opened) / 2, opened])
    faces = find_surface("auto", reconstruction(shapes, np.repeat(np.eye(3)[None], 3, axis=0))).faces
    upper = np.arange(100) < 50
    assert (upper[faces].all(axis=1) | ~upper[faces].any(axis=1)).all()
    assert len(faces) == 2 * 2 * 4 * 9


def facing(result, faces, frame=0):
    """Signed areas in the image: negative where a triangle is anticlockwise to the eye."""
    a, b, c = (result.project()[frame][faces[:, k]] for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


@pytest.mark.parametrize("faces", ["auto", f"grid:{ROWS}x{COLUMNS}"])
def test_found_triangles_face_the_camera_and_avoid_points_without_a_shape(holed, faces):
    surface = find_surface(faces, holed, reference=0)
    assert (facing(holed, surface.faces) < 0).all()
    assert not np.isin(surface.faces, LEFT_OUT).any()
    assert surface.faces.dtype == np.int32


def test_a_grid_has_two_triangles_in_each_cell(result):
    faces = find_surface(f"grid:{ROWS}x{COLUMNS}", result).faces
    assert len(faces) == 2 * (ROWS - 1) * (COLUMNS - 1)
    assert len(sides(faces)) == ROWS * (COLUMNS - 1) + COLUMNS * (ROWS - 1) + (ROWS - 1) * (COLUMNS - 1)


def test_a_mask_keeps_what_is_inside(result):
    mask = np.zeros((480, 640), dtype=bool)
    mask[:, :320] = True
    faces = find_surface("auto", result, mask=mask).faces
    assert 0 < len(faces) < len(find_surface("auto", result).faces)
    assert (result.project()[0][faces][..., 0] < 321).all()
    with pytest.raises(InputError, match="no triangle of frame 0 lies inside"):
        find_surface("auto", result, mask=np.zeros((480, 640), dtype=bool))


def test_quads_become_triangles_and_degenerate_ones_nothing():
    faces = checked_faces(np.array([[0, 1, 2, 3], [4, 5, 6, 6]]), 7)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]


def test_faces_are_read_from_arrays_and_meshes(result, tmp_path):
    import trimesh

    faces = find_surface(f"grid:{ROWS}x{COLUMNS}", result).faces
    np.savez(tmp_path / "mesh ö.npz", faces=faces, other=np.zeros(3))
    np.save(tmp_path / "mesh.npy", faces.astype(float))
    mesh = trimesh.Trimesh(np.repeat(result.shapes[0][:1], ROWS * COLUMNS, axis=0), faces, process=False)
    for name in ("mesh.ply", "mesh.obj", "mesh.off"):
        mesh.export(tmp_path / name)
    for name in ("mesh ö.npz", "mesh.npy", "mesh.ply", "mesh.obj", "mesh.off"):
        found = find_surface(str(tmp_path / name), result)
        np.testing.assert_array_equal(found.faces, faces, err_msg=name)


@pytest.mark.parametrize(
    ("faces", "error", "text"),
    [
        ("grid:5x5", OptionError, "must be the number of points, 48"),
        ("grid:5", OptionError, "written grid:ROWSxCOLS"),
        ("grid:48x1", OptionError, "at least 2"),
        ("atuo", OptionError, "did you mean 'auto'"),
        (np.zeros((0, 3), dtype=int), InputError, r"shape \(faces, 3\)"),
        (np.zeros((4, 2), dtype=int), InputError, r"received \(4, 2\)"),
        (np.array([[0, 1, 48]]), InputError, "from 0 to 47 are needed, received 0 to 48"),
        (np.array([[0, 1, -1]]), InputError, "received -1 to 1"),
        (np.array([[0, 1, 2.5]]), InputError, "whole numbers"),
        ([[LEFT_OUT[0], 1, 2]], InputError, "no face is left of 1"),
        ("missing.npz", FileError, "missing.npz"),
        ("missing.ply", FileError, "no such file"),
        ("faces.xyz", FileError, "extensions .npz"),
    ],
)
def test_faces_that_do_not_fit_are_explained(faces, error, text):
    with pytest.raises(error, match=text):
        find_surface(faces, bending_sheet(holes=True))


def test_a_mesh_with_other_vertices_is_refused(result, tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FileError, match="has 3 vertices: one for each of the 48 points"):
        find_surface(tmp_path / "m.obj", result)
    (tmp_path / "bad.ply").write_text("ply\nformat ascii 1.0\nelement vertex 9\nend_header\n")
    with pytest.raises(FileError, match=r"bad\.ply"):
        find_surface(tmp_path / "bad.ply", result)


def test_points_on_a_line_make_no_surface():
    line = np.zeros((3, 30, 3))
    line[..., 0] = np.arange(30)
    with pytest.raises(InputError, match="on a line"):
        find_surface("auto", reconstruction(line, np.repeat(np.eye(3)[None], 3, axis=0)))


def test_a_mask_without_a_use_is_refused(result):
    for faces in (None, f"grid:{ROWS}x{COLUMNS}"):
        with pytest.raises(OptionError, match="mask"):
            find_surface(faces, result, mask=np.ones((4, 4), dtype=bool))
