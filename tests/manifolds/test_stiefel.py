"""The projection onto the motion manifold is the global one, by three oracles; its derivatives are right."""

import numpy as np
import pytest

from nrsfm.manifolds.stiefel import maximise, nearest_motion, polar_rows, tangents, turned


def random_rows(rng, count):
    return polar_rows(rng.standard_normal((count, 2, 3)))


def value(matrix, rows):
    flat = rows.reshape(-1, 6)
    return np.einsum("fi,fij,fj->f", flat, matrix, flat)


def positive(rng, count, rank):
    half = rng.standard_normal((count, 6, rank))
    return half @ half.transpose(0, 2, 1)


def test_turned_rows_stay_orthonormal_and_tangents_are_their_derivative():
    rng = np.random.default_rng(0)
    rows, turns = random_rows(rng, 20), rng.standard_normal((20, 3))
    moved = turned(rows, turns)
    np.testing.assert_allclose(moved @ moved.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (20, 2, 2)), atol=1e-14)
    step = 1e-6
    for axis in range(3):
        change = np.zeros((20, 3))
        change[:, axis] = step
        slope = (turned(rows, change) - turned(rows, -change)) / (2 * step)
        np.testing.assert_allclose(slope, tangents(rows)[:, axis], atol=1e-9)


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_no_dense_search_finds_a_higher_maximum(rank):
    rng = np.random.default_rng(rank)
    matrix = positive(rng, 40, rank)
    found = value(matrix, maximise(matrix))
    dense = random_rows(rng, 20_000).reshape(-1, 6)
    searched = np.max(np.einsum("ni,fij,nj->fn", dense, matrix, dense, optimize=True), axis=1)
    assert np.all(found >= searched * (1 - 1e-12))
    assert np.all(found <= searched * 1.1)


def test_reaches_the_bound_of_the_semidefinite_relaxation():
    """The relaxation's optimum bounds every orthonormal pair from above; where it is reached, the maximum is global."""
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(3)
    matrix = positive(rng, 6, 3)
    found = value(matrix, maximise(matrix))
    x = cvxpy.Variable((6, 6), symmetric=True)
    normal = cvxpy.hstack([x[1, 5] - x[2, 4], x[2, 3] - x[0, 5], x[0, 4] - x[1, 3]])
    rest = np.eye(3) - x[:3, :3] - x[3:, 3:]
    bordered = cvxpy.bmat([[rest, cvxpy.reshape(normal, (3, 1), order="C")], [normal[None, :], np.ones((1, 1))]])
    rules = [
        x >> 0,
        bordered >> 0,
        cvxpy.trace(x[:3, :3]) == 1,
        cvxpy.trace(x[3:, 3:]) == 1,
        cvxpy.trace(x[:3, 3:]) == 0,
    ]
    for a, reached in zip(matrix, found, strict=True):
        bound = cvxpy.Problem(cvxpy.Maximize(cvxpy.trace(a @ x)), rules).solve(solver="CLARABEL")
        assert reached == pytest.approx(bound, rel=1e-5)


def test_a_start_beside_the_maximum_ends_in_it_and_nothing_pulls_there():
    rng = np.random.default_rng(4)
    matrix = positive(rng, 30, 4)
    best = maximise(matrix)
    again = maximise(matrix, turned(best, 0.05 * rng.standard_normal((30, 3))))
    np.testing.assert_allclose(value(matrix, again), value(matrix, best), rtol=1e-12)
    pull = (matrix @ best.reshape(-1, 6, 1)).reshape(best.shape)
    gradient = np.einsum("fjai,fai->fj", tangents(best), pull)
    assert np.abs(gradient).max() < 1e-8 * np.abs(matrix).max()


def test_points_of_the_manifold_are_their_own_projection():
    rng = np.random.default_rng(5)
    rows, weights = random_rows(rng, 25), rng.standard_normal((25, 4))
    found, turned_rows = nearest_motion(weights[:, :, None, None] * rows[:, None])
    np.testing.assert_allclose(
        found[:, :, None, None] * turned_rows[:, None], weights[:, :, None, None] * rows[:, None], atol=1e-9
    )


def test_empty_blocks_keep_orthonormal_rows():
    weights, rows = nearest_motion(np.zeros((3, 2, 2, 3)))
    assert np.all(weights == 0)
    np.testing.assert_allclose(rows @ rows.transpose(0, 2, 1), np.broadcast_to(np.eye(2), (3, 2, 2)), atol=1e-12)
