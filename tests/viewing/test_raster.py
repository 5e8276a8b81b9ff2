"""The rasteriser and the shading: what is in front is seen, up is up, and pixels do not get lost."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nrsfm.viewing.raster import rasterise_discs, rasterise_triangles
from nrsfm.viewing.render import render, surface_triangles
from nrsfm.viewing.style import PAPER, rgb


def picture(width, height, hits):
    image = np.full(width * height, -1)
    image[hits.pixels] = hits.element
    return image.reshape(height, width)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.floats(0.5, 60.0))
@example(seed=265, size=51.57421875)  # a pixel 3e-4 beside an edge: single precision puts it on the other side
def test_triangles_match_a_point_by_point_test(seed, size):
    rng = np.random.default_rng(seed)
    width, height, count = 40, 30, 6
    corners = rng.uniform((0, 0), (width, height), (count, 1, 2)) + rng.uniform(-size, size, (count, 3, 2))
    depth = rng.uniform(0, 10, count)
    flat = np.repeat(depth, 3)  # each triangle at a depth of its own
    xy = corners.reshape(-1, 2)
    got = picture(width, height, rasterise_triangles(xy, flat, np.arange(3 * count).reshape(-1, 3), width, height))
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    want, best, sure = (
        np.full((height, width), -1),
        np.full((height, width), np.inf),
        np.ones((height, width), bool),
    )
    for i, (a, b, c) in enumerate(corners):
        sides = np.stack([(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))])
        length = np.linalg.norm([b - a, c - b, a - c], axis=1)[:, None, None]
        sure &= (np.abs(sides) > 1e-3 * np.maximum(length, 1.0)).all(axis=0)  # pixels on an edge may fall either way
        inside = ((sides > 0).all(axis=0) | (sides < 0).all(axis=0)) & (depth[i] < best)
        want[inside], best[inside] = i, depth[i]
    np.testing.assert_array_equal(got[sure], want[sure])


def test_weights_interpolate():
    xy = np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0]])
    hits = rasterise_triangles(xy, np.zeros(3), np.array([[0, 1, 2]]), 20, 20)
    where = np.stack([hits.pixels % 20 + 0.5, hits.pixels // 20 + 0.5], axis=1)
    np.testing.assert_allclose(hits.weights @ xy, where, atol=1e-3)
    assert len(hits.pixels) == pytest.approx(200, abs=12)


def test_a_grid_of_triangles_has_no_holes():
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-3, 43, 24), np.linspace(-3, 43, 24)))
    n = np.arange(24 * 24).reshape(24, 24)
    a, b, c, d = (x.ravel() for x in (n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    hits = rasterise_triangles(np.stack([u, v], 1), np.zeros(u.size), triangles, 40, 40)
    assert len(hits.pixels) == 1600


def test_discs_have_their_radius_and_the_nearer_one_hides_the_other():
    hits = rasterise_discs(np.array([[20.0, 20.0], [26.0, 20.0]]), np.array([5.0, 1.0]), np.array([8.0, 4.0]), 40, 40)
    image = picture(40, 40, hits)
    assert np.count_nonzero(image == 1) == pytest.approx(np.pi * 16, rel=0.1)
    assert image[20, 14] == 0
    assert image[20, 25] == 1


def test_nothing_to_draw_gives_paper():
    paper = np.round(rgb(PAPER) * 255)
    empty = render(np.full((6, 3), np.nan), np.ones(3), half_size=(1.0, 1.0), pixels_per_unit=10.0)
    np.testing.assert_allclose(empty, np.broadcast_to(paper, empty.shape), atol=1)
    away = render(
        np.full((3, 3), 99.0),
        np.ones(3),
        half_size=(1, 1),
        pixels_per_unit=9.0,
        triangles=np.array([[0, 1, 2]]),
    )
    np.testing.assert_allclose(away, np.broadcast_to(paper, away.shape), atol=1)


@pytest.mark.parametrize("triangles", [True, False])
def test_small_y_is_at_the_top_and_small_x_at_the_left(triangles):
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)))
    points = np.stack([u, v, np.zeros(u.size)], axis=1)
    colours = np.stack([v < 0, u < 0, np.zeros(u.size)], axis=1)  # red above, green at the left
    faces = surface_triangles(points) if triangles else None
    image = render(points, colours, half_size=(1.2, 1.2), pixels_per_unit=40, triangles=faces, strength=0.0)
    middle = image[20:-20, 20:-20].astype(int)
    height, width = middle.shape[:2]
    assert middle[: height // 3, :, 0].min() > 200
    assert middle[-height // 3 :, :, 0].max() < 50
    assert middle[:, : width // 3, 1].min() > 200
    assert middle[:, -width // 3 :, 1].max() < 50


def test_what_is_nearer_hides_what_is_behind():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    points = np.concatenate([square + np.array([0, 0, 5]), square - np.array([0, 0, 5])])
    colours = np.repeat([[1.0, 0, 0], [0, 0, 1.0]], 4, axis=0)  # red far (z = 5), blue near (z = -5)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    image = render(points, colours, half_size=(1, 1), pixels_per_unit=20, triangles=faces, strength=0.0)
    assert (image[..., 2] > 200).all()
    assert (image[..., 0] < 50).all()


def test_light_comes_from_above_left_of_the_viewer():
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61)))
    inside = u**2 + v**2 < 0.98
    ball = np.stack([u, v, -np.sqrt(np.clip(1 - u**2 - v**2, 0, None))], axis=1)[inside]  # bulges towards the viewer
    faces = surface_triangles(np.stack([ball[:, 0], ball[:, 1], 0 * ball[:, 0]], axis=1))
    image = render(ball, np.full(3, 0.7), half_size=(1, 1), pixels_per_unit=50, triangles=faces).sum(axis=2).astype(int)
    assert image[30, 30] > image[70, 70] + 60


def test_points_on_a_sheet_are_joined_and_a_cloud_is_not():
    rng = np.random.default_rng(0)
    flat = np.concatenate([rng.uniform(-1, 1, (300, 2)), 0.05 * rng.standard_normal((300, 1))], axis=1)
    joined = surface_triangles(flat * (1, 1, 0.1))
    assert joined is not None
    assert len(joined) > 400
    assert surface_triangles(rng.standard_normal((300, 3))) is None
    assert surface_triangles(flat[:5]) is None
    assert surface_triangles(np.outer(np.arange(30.0), (1, 1, 1))) is None  # on one line
    flat[:50] = np.nan
    kept = surface_triangles(flat * (1, 1, 0.1))
    assert kept is not None
    assert kept.min() >= 50
