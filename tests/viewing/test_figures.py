"""Every figure, for every kind of input."""

import os
import subprocess
import sys

import numpy as np
import pytest

from nrsfm.errors import FileError, InputError
from nrsfm.viewing import (
    convergence_figure,
    error_figure,
    groups_figure,
    overview_figure,
    save_figure,
    shapes_figure,
    tracks_figure,
)
from nrsfm.viewing.style import DPI, WIDTH, group_colours, house_style
from nrsfm.viewing.tracks import spread_points

KINDS = ["mesh", "points", "sparse", "skeleton", "tiny", "two frames"]


def pixels(figure):
    """The drawn figure (height, width, 3), small."""
    figure.set_dpi(40)
    with house_style():
        figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


def options(case):
    return {"faces": case.faces, "edges": case.edges}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("truth", [True, False])
def test_shapes_and_overview(cases, kind, truth):
    case = cases[kind]
    known = {"truth": case.truth, "truth_rotations": case.rotations} if truth else {}
    panels = len(shapes_figure(case.result, count=2, **known, **options(case)).axes)
    assert panels == 2 * 2 * (2 if truth else 1)
    overview = overview_figure(case.result, case.tracks, **known, **options(case))
    assert len(overview.axes) == 2 * (6 if truth else 4) + (1 if truth else 0)
    assert pixels(overview).std() > 5


@pytest.mark.parametrize("kind", KINDS)
def test_errors_and_groups_and_tracks(cases, kind):
    case = cases[kind]
    assert pixels(error_figure(case.result, case.truth, count=2, unit="mm", **options(case))).std() > 5
    assert pixels(groups_figure(case.result, **options(case))).std() > 5
    assert pixels(tracks_figure(case.tracks)).std() > 2


def test_plain_arrays_without_groups(cases):
    case = cases["mesh"]
    figure = overview_figure(case.truth, case.tracks, rotations=case.rotations)
    assert len(figure.axes) == 2 * 3
    with pytest.raises(InputError, match="groups: labels are needed"):
        groups_figure(case.truth)
    with pytest.raises(InputError, match="truth: true shapes are needed"):
        error_figure(case.truth, None)
    with pytest.raises(InputError, match="tracks: shape"):
        overview_figure(case.truth, case.tracks[:, :50])


def test_the_face_is_drawn_the_right_way_up(cases):
    """Colour by group: the top third of the face red, the rest otherwise; look where the colours land."""
    case = cases["mesh"]
    y = case.truth[0, :, 1]
    for marked, upper in ((y < np.quantile(y, 0.3), True), (y > np.quantile(y, 0.7), False)):
        labels = marked.astype(np.int64)
        figure = groups_figure(case.truth, rotations=case.rotations, faces=case.faces, groups=labels)
        _, colours = group_colours(labels, case.truth.mean(axis=0))
        image = np.asarray(figure.axes[1].get_images()[0].get_array()).astype(float) / 255
        origin, extent = figure.axes[1].get_images()[0].origin, figure.axes[1].get_images()[0].get_extent()
        assert origin == "upper"
        assert extent[2] > extent[3]
        # Shading changes brightness, not hue: compare directions of colour.
        chroma = image - image.mean(axis=2, keepdims=True)
        wanted = colours[1] - colours[1].mean()
        other = colours[0] - colours[0].mean()
        match = (chroma @ wanted > chroma @ other) & (np.abs(chroma).max(axis=2) > 0.03)
        rows = np.nonzero(match)[0].mean() / len(image)
        assert rows < 0.4 if upper else rows > 0.6
    axes = tracks_figure(case.tracks).axes[0]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    assert axes.get_xlim()[0] < axes.get_xlim()[1]


def test_the_skeleton_is_drawn_the_right_way_up(cases):
    case = cases["skeleton"]
    for axes in shapes_figure(case.result, edges=case.edges, count=1).axes:
        assert axes.get_ylim()[0] > axes.get_ylim()[1]


def test_invisible_and_unknown_points(cases):
    from nrsfm.tracks import Tracks

    case = cases["mesh"]
    visible = np.ones(case.tracks.shape[:2], dtype=bool)
    visible[:, ::3] = False
    visible[1] = False
    assert pixels(tracks_figure(Tracks(case.tracks, visible))).std() > 2
    holes = case.truth.copy()
    holes[0] = np.nan
    holes[:, :30] = np.nan
    assert pixels(error_figure(case.result, holes, faces=case.faces, frames=[0, 1])).std() > 5
    pixels(shapes_figure(holes, faces=case.faces, frames=[0, 1]))
    pixels(shapes_figure(np.full((3, 8, 3), np.nan)))
    pixels(shapes_figure(np.zeros((3, 8, 3)), np.zeros((3, 8, 3))))
    pixels(error_figure(np.zeros((3, 500, 3)), np.zeros((3, 500, 3))))


def test_quads_are_drawn_as_two_triangles():
    u, v = (a.ravel() for a in np.meshgrid(np.arange(6.0), np.arange(6.0)))
    shapes = np.stack([np.stack([u, v, 0.1 * u * v], axis=1)] * 3)
    n = np.arange(36).reshape(6, 6)
    quads = np.stack([n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    one, two = (pixels(shapes_figure(shapes, faces=f, count=1)) for f in (quads, triangles))
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    ("history", "panels"),
    [
        ({"energy": [3.0, 1.0], "gap": [1.0, 1e-9], "rank": [5, 4]}, 3),
        ({"history": {"gap": [1.0]}}, 1),
        ({"energy": [], "rank": [3] * 200}, 1),
        ({"energy": [np.nan, 2.0, np.inf, 1.0], "gap": None}, 1),
        ({"energy": [-3.0, -4.0], "gap": [0.0, 0.0]}, 2),
    ],
)
def test_convergence(history, panels):
    figure = convergence_figure(history)
    assert len(figure.axes) == panels
    pixels(figure)


@pytest.mark.parametrize("history", [{}, {"energy": []}, {"energy": "low"}, {"gap": [np.nan]}, [1.0], None])
def test_convergence_needs_numbers(history):
    with pytest.raises(InputError, match=r"^history"):
        convergence_figure(history)


def test_convergence_of_a_reconstruction(cases):
    assert len(convergence_figure(cases["mesh"].result).axes) == 3


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_saved_files_are_whole_and_alone(tmp_path, cases, suffix):
    path = save_figure(convergence_figure(cases["mesh"].result), tmp_path / f"c.{suffix}")
    assert os.listdir(tmp_path) == [path.name]
    data = path.read_bytes()
    if suffix == "png":
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert data[-8:-4] == b"IEND"
        assert int.from_bytes(data[16:20], "big") == round(WIDTH * DPI)
    else:
        assert data.rstrip().endswith(b"%%EOF" if suffix == "pdf" else b"</svg>")


def test_a_failed_save_leaves_the_old_file(tmp_path, cases, monkeypatch):
    figure = convergence_figure(cases["mesh"].result)
    path = tmp_path / "c.png"
    path.write_bytes(b"old")

    def fail(stream, **_):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(FileError, match="No space left"):
        save_figure(figure, path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["c.png"]


@pytest.mark.parametrize("name", ["c.xyz", "c", "c.txt"])
def test_unknown_formats(tmp_path, cases, name):
    with pytest.raises(FileError, match="suffix must be one of"):
        save_figure(convergence_figure(cases["mesh"].result), tmp_path / name)
    assert not os.listdir(tmp_path)


def test_same_input_same_picture(tmp_path, cases):
    case = cases["mesh"]
    one, two = (save_figure(groups_figure(case.result), tmp_path / f"{i}.png").read_bytes() for i in range(2))
    assert one == two


def test_no_global_state_and_no_pyplot():
    code = (
        "import sys, nrsfm.viewing as v; assert 'matplotlib' not in sys.modules\n"
        "import matplotlib as mpl, numpy as np; mpl.rcParams['font.size'] = 17.0; \n"
        "settings = lambda: {k: mpl.rcParams[k] for k in mpl.rcParams if 'backend' not in k}\n"
        "old = settings()\n"
        "f = v.convergence_figure({'energy': [2.0, 1.0]}); v.tracks_figure(np.random.rand(3, 9, 2))\n"
        "v.save_figure(f, sys.argv[1]); assert settings() == old\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", code, f"{folder}/x.png"], check=True)


@pytest.mark.parametrize("count", [1, 2, 10, 50, 400])
def test_group_colours_are_distinct(count):
    rng = np.random.default_rng(0)
    groups = np.concatenate([np.arange(count), rng.integers(0, count, 500)]) * 3 - 7
    labels, colours = group_colours(groups, rng.standard_normal((len(groups), 3)))
    assert labels.tolist() == sorted(set(groups.tolist()))
    assert ((colours >= 0) & (colours <= 1)).all()
    gaps = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 9 * np.eye(count)
    assert gaps.min() > (0.09 if count <= 50 else 0.0) - 1e-9


def test_drawn_points_are_spread():
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 1, (5000, 2)) ** 3  # most in one corner
    chosen = spread_points(positions, 200)
    assert len(chosen) == len(set(chosen)) == 200
    assert np.median(positions[chosen], axis=0).min() > 2 * np.median(positions, axis=0).max()
    assert spread_points(positions[:20], 200).tolist() == list(range(20))


def test_bad_tracks():
    with pytest.raises(InputError, match=r"^tracks"):
        tracks_figure(np.zeros((3, 4, 3)))
    with pytest.raises(InputError, match=r"^frames"):
        tracks_figure(np.zeros((3, 4, 2)), frames=[3])
