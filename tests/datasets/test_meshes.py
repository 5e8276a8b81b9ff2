import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.datasets.meshes import densify
from nrsfm.errors import InputError


def grid(rows, columns, triangles):
    """A flat rows × columns grid of quads, or of twice as many triangles, with its vertices."""
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    faces = np.stack([a, b, c, d], axis=1)
    if triangles:
        faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    y, x = np.mgrid[: rows + 1, : columns + 1]
    return faces, np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)


def area(faces, points):
    corners = points[faces]
    total = 0.0
    for k in range(2, faces.shape[1]):
        total += np.linalg.norm(
            np.cross(corners[:, k - 1] - corners[:, 0], corners[:, k] - corners[:, 0]), axis=1
        ).sum()
    return total / 2


@given(rows=st.integers(1, 4), columns=st.integers(1, 4), triangles=st.booleans(), level=st.integers(0, 3))
def test_splitting_refines_the_same_surface(rows, columns, triangles, level):
    faces, vertices = grid(rows, columns, triangles)
    density = densify(faces, len(vertices), level, None)
    points = density.apply(vertices)
    fine = 2**level
    assert len(points) == density.n_points == (rows * fine + 1) * (columns * fine + 1)
    assert len(density.faces) == len(faces) * 4**level
    np.testing.assert_array_equal(points[: len(vertices)], vertices)
    # Midpoints of a grid are the finer grid: each place once.
    lattice = np.unique(np.round(points[:, :2] * fine).astype(int), axis=0)
    np.testing.assert_allclose(points * fine, np.round(points * fine), atol=1e-12)
    assert len(lattice) == len(points)
    assert area(density.faces, points) == pytest.approx(rows * columns)
    np.testing.assert_array_equal(np.unique(density.faces), np.arange(len(points)))


@given(triangles=st.booleans(), wanted=st.integers(1, 400))
def test_any_number_of_points_can_be_had(triangles, wanted):
    faces, vertices = grid(3, 4, triangles)
    density = densify(faces, len(vertices), 0, wanted)
    points = density.apply(vertices)
    assert points.shape == (wanted, 3)
    assert len(np.unique(points, axis=0)) == wanted
    assert points[:, 0].min() >= 0
    assert points[:, 0].max() <= 4
    if wanted >= len(vertices):
        np.testing.assert_array_equal(points[: len(vertices)], vertices)


@pytest.mark.parametrize(
    ("subdivide", "points"),
    [(-1, None), (1.5, None), (True, None), (0, 0), (0, "9"), (1, 9), (99, None), (0, 10**9)],
)
def test_other_requests_are_refused(subdivide, points):
    faces, vertices = grid(2, 2, True)
    with pytest.raises(InputError, match="received"):
        densify(faces, len(vertices), subdivide, points)
