"""The graph of neighbours and its operators."""

import numpy as np
import pytest

from nrsfm.errors import OptionError
from nrsfm.neighbours import (
    NeighbourOptions,
    Neighbours,
    edges_of_grid,
    edges_of_mesh,
    edges_of_tracks,
    find_neighbours,
    gradient,
    laplacian,
)
from nrsfm.options import build_options


def pairs(edges):
    return {tuple(sorted(edge)) for edge in edges.tolist()}


def image(height, width):
    rows, columns = np.mgrid[:height, :width]
    return np.column_stack([columns.ravel(), rows.ravel()])


def surface(points, frames=6, seed=0):
    """Tracks (F, 2, P) of a turning, gently curved sheet of unit density, and its plane coordinates."""
    rng = np.random.default_rng(seed)
    plane = rng.uniform(-1, 1, (points, 2))
    body = np.column_stack([plane, 0.3 * plane[:, 0] ** 2])
    angles = np.linspace(0, 1, frames)
    rows = np.stack([[[np.cos(a), 0, np.sin(a)], [0, 1, 0]] for a in angles])
    tracks = rows @ body.T
    tracks -= tracks.mean(axis=2, keepdims=True)
    return tracks / np.sqrt(np.mean(tracks**2)), plane


def test_mesh_gives_the_sides_of_its_faces():
    assert pairs(edges_of_mesh(np.array([[0, 1, 2], [2, 1, 3]]), 5)) == {(0, 1), (1, 2), (0, 2), (1, 3), (2, 3)}
    assert pairs(edges_of_mesh(np.array([[0, 1, 2, 3]]), 4)) == {(0, 1), (1, 2), (2, 3), (0, 3)}
    assert pairs(edges_of_mesh(np.array([[0, 1, 1]]), 4)) == {(0, 1)}


def test_whole_numbers_of_a_floating_type_are_taken():
    assert pairs(edges_of_mesh(np.array([[0.0, 1, 2]]), 3)) == {(0, 1), (1, 2), (0, 2)}


@pytest.mark.parametrize("shift", [0, -7, 1000])
def test_grid_joins_pixels_that_share_a_side(shift):
    grid = image(3, 4)
    kept = np.delete(np.arange(12), 5)  # a hole
    order = np.random.default_rng(0).permutation(11)
    grid = grid[kept][order]
    found = pairs(edges_of_grid(grid + shift, 11))
    expected = {(i, j) for i in range(11) for j in range(i + 1, 11) if np.abs(grid[i] - grid[j]).sum() == 1}
    assert found == expected


def test_grid_edges_lead_right_and_down():
    grid = image(3, 4)
    edges = edges_of_grid(grid, 12)
    steps = grid[edges[:, 1]] - grid[edges[:, 0]]
    assert {tuple(step) for step in steps.tolist()} == {(1, 0), (0, 1)}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"faces": np.zeros((3, 2))}, r"'faces' must have shape \(faces, 3 or 4\), received \(3, 2\)"),
        ({"faces": np.array([[1, 2, 60]])}, "from 0 to 59, received 1 to 60"),
        ({"faces": np.array([[0, 1, -1]])}, "received -1 to 1"),
        ({"faces": np.array([[0, 1, 1.5]])}, "'faces' must hold whole numbers"),
        ({"grid": np.zeros((5, 2))}, r"'grid' must have shape \(60, 2\)"),
        ({"grid": np.zeros((60, 2))}, r"a pixel of its own, received one for points \[0, 1\]"),
        ({"grid": np.full((60, 2), np.nan)}, "'grid' must hold whole numbers"),
        ({"grid": image(6, 10), "faces": np.array([[0, 1, 2]])}, "one of them may be given"),
    ],
)
def test_what_does_not_fit_is_refused(options, said):
    tracks, _ = surface(60)
    with pytest.raises(OptionError, match=said):
        find_neighbours(tracks, build_options(NeighbourOptions, options))


def test_nearest_tracks_are_neighbours_of_each_other():
    tracks, _ = surface(200)
    flat = tracks.reshape(12, 200).T
    gaps = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    near = np.argsort(gaps, axis=1)[:, 1:6]
    expected = {tuple(sorted((i, int(j)))) for i in range(200) for j in near[i]}
    assert pairs(edges_of_tracks(tracks, 5)) == expected


def test_points_close_in_one_frame_only_are_not_joined():
    """Two sheets, one behind the other: they coincide in the first frame and part when the camera turns."""
    tracks, _ = surface(120)
    angles = np.linspace(0, 1, 6)
    behind = tracks + np.sin(angles)[:, None, None] * np.array([9.0, 0.0])[:, None]
    both = np.concatenate([tracks, behind], axis=2)
    edges = edges_of_tracks(both - both.mean(axis=2, keepdims=True), 6)
    assert ((edges[:, 0] < 120) == (edges[:, 1] < 120)).all()
    assert find_neighbours(both, NeighbourOptions(neighbours=6)).pieces() >= 2


def test_many_equal_tracks_and_few_points():
    tracks, _ = surface(30)
    tracks[:, :, 20:] = tracks[:, :, 20:21]
    graph = find_neighbours(tracks, NeighbourOptions(neighbours=4))
    assert graph.degrees.min() >= 1
    assert len(edges_of_tracks(tracks[:, :, :4], 8)) == 6
    for operator in (gradient(graph)[0], laplacian(graph)):
        assert np.isfinite(operator.data).all()


@pytest.mark.parametrize("kind", ["mesh", "grid", "tracks"])
def test_operators_see_no_constant_and_their_scale_does_not_depend_on_density(kind):
    """A unit slope on a square of area 4π: |∇u| = 1; u = x² there: Δu = 2, inside."""
    for side in (12, 30):
        grid = image(side, side)
        at = (grid - grid.mean(axis=0)) * np.sqrt(4 * np.pi) / side
        if kind == "grid":
            edges = edges_of_grid(grid, side**2)
        elif kind == "mesh":
            corner = np.flatnonzero((grid < side - 1).all(axis=1))
            edges = edges_of_mesh(np.column_stack([corner, corner + 1, corner + side + 1, corner + side]), side**2)
        else:
            edges = edges_of_tracks(at.T[None], 8)
        graph = Neighbours(side**2, edges, kind)
        rows, owners = gradient(graph)
        inside = ((grid > 2) & (grid < side - 3)).all(axis=1)
        slopes = np.sqrt(np.bincount(owners, weights=(rows @ at[:, 0]) ** 2, minlength=side**2))
        curved = laplacian(graph) @ at[:, 0] ** 2
        assert np.abs(rows @ np.ones(side**2)).max() < 1e-9
        assert np.abs(laplacian(graph) @ np.ones(side**2)).max() < 1e-9
        # Eight neighbours reach further than the four at distance ℓ: the mean of their squared distances is 1.5 ℓ².
        factor = 1.5 if kind == "tracks" else 1.0
        np.testing.assert_allclose(slopes[inside] ** 2, factor, rtol=1e-6)
        np.testing.assert_allclose(curved[inside], 2 * factor, rtol=1e-6)


def test_a_permuted_mesh_is_the_same_graph():
    rng = np.random.default_rng(3)
    faces = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 2], [4, 5, 3]])
    order = rng.permutation(6)
    place = np.argsort(order)
    u = rng.standard_normal(6)
    plain, moved = Neighbours(6, edges_of_mesh(faces, 6), "mesh"), Neighbours(6, edges_of_mesh(place[faces], 6), "mesh")
    np.testing.assert_allclose(laplacian(moved) @ u[order], (laplacian(plain) @ u)[order], atol=1e-12)

    def lengths(graph, values):
        rows, owners = gradient(graph)
        return np.bincount(owners, weights=(rows @ values) ** 2, minlength=6)

    np.testing.assert_allclose(lengths(moved, u[order]), lengths(plain, u)[order], atol=1e-12)


def test_points_of_no_face_have_no_rows():
    graph = Neighbours(5, edges_of_mesh(np.array([[0, 1, 2]]), 5), "mesh")
    u = np.arange(5.0)
    assert (laplacian(graph) @ u)[3:].tolist() == [0, 0]
    assert set(gradient(graph)[1].tolist()) == {0, 1, 2}
    assert graph.pieces() == 3
