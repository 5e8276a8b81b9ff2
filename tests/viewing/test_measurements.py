"""Pictures of real tracks: points never seen, not believed, without a shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.errors import InputError
from nrsfm.reconstruction import Reconstruction
from nrsfm.tracks import Tracks
from nrsfm.viewing import (
    error_figure,
    groups_figure,
    house_style,
    overview_figure,
    shapes_figure,
    tracks_figure,
    uncertainty_figure,
)
from nrsfm.viewing.figures import colours_of_groups
from nrsfm.viewing.measurements import measurement_picture, measurements_of
from nrsfm.viewing.scene import make_scene
from nrsfm.viewing.style import LOST, OUTLIER, SEEN, UNSEEN, rgb
from nrsfm.viewing.tracks import draw_tracks, track_window

KINDS = ["mesh", "points", "sparse", "skeleton"]


def draw(figure):
    figure.set_dpi(40)
    with house_style():
        figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


def real(case, seed=0):
    """The case as a tracker would give it: (reconstruction, tracks)."""
    rng = np.random.default_rng(seed)
    frames, points = case.tracks.shape[:2]
    visible = rng.random((frames, points)) < 0.8
    lost = rng.random(points) < 0.1
    lost[:5], lost[-2] = False, True
    confidence = np.where(visible & ~lost, 1.0, 0.0)
    confidence[1, :3] = 0.01
    visible[1, :3] = True
    shapes = case.result.shapes.copy()
    shapes[:, lost] = np.nan
    deviation = np.where(lost, np.nan, rng.random((frames, points)))
    r = case.result
    result = Reconstruction(
        shapes, r.rotations, r.translations, r.scales, r.groups, confidence=confidence, depth_deviation=deviation
    )
    return result, Tracks(np.where(visible[..., None], case.tracks, np.nan), visible)


def options(case):
    return {"faces": case.faces, "edges": case.edges}


@pytest.mark.parametrize("kind", KINDS)
def test_every_figure_takes_points_without_a_shape(cases, kind):
    case = cases[kind]
    result, tracks = real(case)
    known = {"truth": case.truth, "truth_rotations": case.rotations}
    for figure in (
        shapes_figure(result, count=2, **known, **options(case)),
        error_figure(result, case.truth, count=2, **options(case)),
        uncertainty_figure(result, count=2, **options(case)),
        groups_figure(result, **options(case)),
        tracks_figure(tracks, result),
        tracks_figure(tracks),
    ):
        assert draw(figure).std() > 2


@pytest.mark.parametrize("kind", KINDS)
def test_the_overview_gains_a_map_and_without_truth_the_deviation(cases, kind):
    case = cases[kind]
    result, tracks = real(case)
    scale, mapped = 1, 1
    overview = overview_figure(result, tracks, **options(case))
    assert len(overview.axes) == 2 * 5 + mapped + scale
    words = " ".join(text.get_text() for text in overview.texts)
    assert "depth deviation" in words
    assert "not reconstructed" in words
    assert "outliers" in words
    with_truth = overview_figure(result, tracks, case.truth, **options(case))
    assert len(with_truth.axes) == 2 * 6 + mapped + scale
    assert "depth deviation" not in " ".join(text.get_text() for text in with_truth.texts)
    assert draw(overview).std() > 5


def test_complete_clean_tracks_have_no_map(cases):
    case = cases["mesh"]
    assert not measurements_of(case.result, case.tracks).remarkable
    assert len(tracks_figure(case.tracks, frames=[1, 3]).axes) == 2
    assert len(tracks_figure(real(case)[1], frames=[1, 3]).axes) == 3


@given(st.integers(1, 9), st.integers(4, 300), st.integers(0, 2**32 - 1))
def test_the_map_shows_each_measurement_once(frames, points, seed):
    """With a row for each point every cell has one colour, and there are as many of each as measurements."""
    rng = np.random.default_rng(seed)
    visible = rng.random((frames, points)) < 0.7
    lost = np.arange(points) >= 4
    lost &= rng.random(points) < 0.2
    confidence = rng.random((frames, points)) * ~lost
    shapes = np.where(lost[:, None], np.nan, rng.standard_normal((frames, points, 3)))
    result = Reconstruction(
        shapes, np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 2)), np.ones(frames), confidence=confidence
    )
    found = measurements_of(result, Tracks(np.zeros((frames, points, 2)), visible))
    picture = measurement_picture(found, rows=points)
    assert picture.shape == (points, frames, 3)
    counts = {
        UNSEEN: ~visible,
        OUTLIER: visible & ~lost & (result.confidence < 0.5),
        LOST: visible & lost,
        SEEN: visible & ~lost & (result.confidence >= 0.5),
    }
    for colour, mask in counts.items():
        drawn = (np.abs(picture - rgb(colour)) < 1e-6).all(axis=2)
        assert np.count_nonzero(drawn) == np.count_nonzero(mask)
    complete = int((visible.all(axis=0) & ~lost).sum())
    assert not (np.abs(picture[:complete] - rgb(UNSEEN)) < 1e-6).all(axis=2).any()  # on top
    coarse = measurement_picture(found, rows=7)
    assert coarse.shape == (min(7, points), frames, 3)
    assert ((coarse >= 0) & (coarse <= 1)).all()


def test_points_hidden_together_lie_together():
    hidden = np.zeros((30, 200), dtype=bool)
    late = np.random.default_rng(0).random(200) < 0.5
    hidden[:10, ~late], hidden[20:, late] = True, True
    found = measurements_of(None, Tracks(np.zeros((30, 200, 2)), ~hidden))
    order = (np.abs(measurement_picture(found, rows=200)[:, 25] - rgb(UNSEEN)) < 1e-6).all(axis=1)
    assert np.count_nonzero(np.diff(order.astype(int))) == 1


def test_the_truth_of_a_lost_point_is_drawn_and_it_is_in_no_error(cases):
    case = cases["mesh"]
    result, _ = real(case)
    lost = ~result.reconstructed
    scene = make_scene(result, case.truth, align="per-frame")
    assert np.isfinite(scene.truth).all()
    assert np.isnan(scene.shapes[:, lost]).all()
    assert np.isnan(scene.point_errors()[:, lost]).all()
    part = make_scene(result.shapes[:, ~lost], case.truth[:, ~lost], rotations=result.rotations, frames=scene.frames)
    np.testing.assert_allclose(scene.errors, part.errors)
    assert scene.size == pytest.approx(part.size)


def test_lost_points_are_in_no_group():
    mean = np.random.default_rng(0).standard_normal((6, 3))
    mean[5] = np.nan
    colours, sizes = colours_of_groups(np.array([0, 0, 1, 1, 1, -1]), mean)
    assert sizes.tolist() == [2, 3]
    assert len(np.unique(colours[:5], axis=0)) == 2


def test_outliers_and_strays_do_not_take_the_window():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 10, (5, 300, 2))
    none = np.zeros((5, 300), dtype=bool)
    clean = track_window(points, none, np.array([4]), np.arange(300), 3)
    points[4, 7] = 1e6
    marked = none.copy()
    marked[4, 7] = True
    told = track_window(points, marked, np.array([4]), np.arange(300), 3)
    assert told.half == pytest.approx(clean.half, rel=0.05)
    assert max(track_window(points, none, np.array([4]), np.arange(300), 3).half) < 3 * max(clean.half)
    assert track_window(points, ~none, np.array([4]), np.arange(300), 3).half == (1.0, 1.0)


def test_an_outlier_is_a_cross_without_a_trail():
    from matplotlib.figure import Figure

    points = np.tile(np.linspace(0, 1, 5)[:, None, None], (1, 4, 2)) + np.arange(4)[:, None]
    odd = np.zeros((5, 4), dtype=bool)
    odd[4, 2] = True
    axes = Figure().add_subplot(xlim=(-1, 6), ylim=(6, -1))
    draw_tracks(axes, points, 4, np.arange(4), np.full((4, 3), 0.5), 1, odd)
    crosses, dots = (c.get_offsets() for c in axes.collections if type(c).__name__ == "PathCollection")
    assert crosses.tolist() == [[3.0, 3.0]]
    assert np.ma.count(dots[:, 0]) == 3


def test_uncertainty_needs_deviations(cases):
    with pytest.raises(InputError, match="depth_deviation: it is needed"):
        uncertainty_figure(cases["mesh"].result)
    with pytest.raises(InputError, match="tracks: shape"):
        measurements_of(real(cases["mesh"])[0], np.zeros((5, 3, 2)))
