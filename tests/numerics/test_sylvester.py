"""The Sylvester solver against a dense solve."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from nrsfm.numerics.sylvester import Sylvester


def problem(rng, spread, size=9, points=40):
    basis = np.linalg.qr(rng.standard_normal((size, size)))[0]
    left = (basis * np.geomspace(1, spread, size)) @ basis.T
    chain = np.diff(np.eye(points), axis=0)
    return left, csr_array(10.0 * chain.T @ chain), rng.standard_normal((size, points))


@pytest.mark.parametrize("spread", [1.0, 1.5, 1e-3, 1e-6])
def test_equals_the_dense_solve(spread):
    left, right, constant = problem(np.random.default_rng(0), spread)
    size, points = constant.shape
    whole = np.kron(left, np.eye(points)) + np.kron(np.eye(size), right.toarray())
    expected = np.linalg.solve(whole, constant.reshape(-1)).reshape(size, points)
    found = Sylvester(left, right).solve(constant, tolerance=1e-12)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_a_start_changes_nothing_and_costs_less():
    rng = np.random.default_rng(1)
    left, right, constant = problem(rng, 1e-2)
    system = Sylvester(left, right)
    plain = system.solve(constant, tolerance=1e-11)
    again = system.solve(constant, plain + 1e-3 * rng.standard_normal(plain.shape), tolerance=1e-11)
    np.testing.assert_allclose(again, plain, atol=1e-9 * np.abs(plain).max())


def test_close_shifts_share_a_factorisation():
    rng = np.random.default_rng(2)
    left, right, _ = problem(rng, 1e-2)
    groups = Sylvester(left, right).groups
    assert len(groups) < len(left)
    assert np.concatenate(groups).tolist() == list(range(len(left)))


def test_a_singular_left_side_gives_a_finite_answer():
    left, right, constant = problem(np.random.default_rng(4), 1e-2)
    values, vectors = np.linalg.eigh(left)
    values[0] = 0.0
    assert np.isfinite(Sylvester((vectors * values) @ vectors.T, right).solve(constant)).all()
