"""The steps of the self-expression problem against generic solvers, and its solution against the closed form.

min over C of λ tr((I − C) Γ (I − C)ᵀ) + μ‖C‖_*, with Γ = V diag(d) Vᵀ. Its optimality condition is
2λ(I − C)Γ ∈ μ ∂‖C‖_*; C = V diag(c) Vᵀ with c = max(0, 1 − μ/(2λd)) meets it: 2λ(1 − c)d equals μ where c > 0, and
is 2λd ≤ μ, a subgradient, where c = 0.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.manifolds.grassmann import projection_kernel
from nrsfm.manifolds.self_expression import SelfExpression, affinity, coefficient_step, nuclear_step


def random_kernel(rng, count, ambient=8, dimension=3):
    return projection_kernel(np.linalg.qr(rng.standard_normal((count, ambient, dimension)))[0])


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.floats(1e-3, 10), st.floats(1e-3, 10))
def test_coefficient_step_is_the_least_squares_minimiser(seed, count, weight, penalty):
    """λ‖L − CL‖² + β/2‖C − J‖² + ⟨L₂, C − J⟩ as one least-squares problem in Cᵀ, with L a Cholesky factor."""
    rng = np.random.default_rng(seed)
    kernel = random_kernel(rng, count) + 1e-6 * np.eye(count)
    auxiliary, multiplier = rng.standard_normal((2, count, count))
    factor = np.linalg.cholesky(kernel)
    rows = np.concatenate([np.sqrt(2 * weight) * factor.T, np.sqrt(penalty) * np.eye(count)])
    wanted = np.concatenate([np.sqrt(2 * weight) * factor.T, np.sqrt(penalty) * (auxiliary - multiplier / penalty).T])
    expected = np.linalg.lstsq(rows, wanted, rcond=None)[0].T
    got = coefficient_step(kernel, auxiliary, multiplier, weight, penalty)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("threshold", [0.1, 1.0, 3.0])
def test_nuclear_step_is_the_convex_minimiser(threshold):
    cvxpy = pytest.importorskip("cvxpy")
    matrix = np.random.default_rng(1).standard_normal((5, 5))
    unknown = cvxpy.Variable((5, 5))
    cost = threshold * cvxpy.normNuc(unknown) + 0.5 * cvxpy.sum_squares(unknown - matrix)
    problem = cvxpy.Problem(cvxpy.Minimize(cost))
    problem.solve(solver=cvxpy.CLARABEL)
    got = nuclear_step(matrix, threshold)
    mine = threshold * np.linalg.norm(got, "nuc") + 0.5 * np.sum((got - matrix) ** 2)
    assert mine <= problem.value * (1 + 1e-7)
    np.testing.assert_allclose(got, unknown.value, atol=1e-3)


def converged(kernel, weight, nuclear_weight, penalty=None, growth=1.0, rounds=3000):
    state = SelfExpression(kernel, weight, nuclear_weight)
    penalty = 2 * weight * np.linalg.eigvalsh(kernel).mean() if penalty is None else penalty
    for _ in range(rounds):
        state.update_coefficients(penalty)
        state.update_auxiliary(penalty)
        gap = state.update_multiplier(penalty)
        penalty *= growth
    return state, gap


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ratio", [0.3, 1.0, 4.0])
def test_the_iteration_reaches_the_closed_form(seed, ratio):
    rng = np.random.default_rng(seed)
    kernel = random_kernel(rng, 6)
    weight = 10.0 ** rng.uniform(-3, 1)
    nuclear = ratio * weight
    values, vectors = np.linalg.eigh(kernel)
    share = np.maximum(0, 1 - nuclear / (2 * weight * np.maximum(values, 1e-12)))
    expected = (vectors * share) @ vectors.T
    state, gap = converged(kernel, weight, nuclear)
    assert gap < 1e-8
    np.testing.assert_allclose(state.coefficients, expected, atol=1e-6)
    np.testing.assert_allclose(state.auxiliary, expected, atol=1e-6)


def test_the_closed_form_is_the_convex_minimum():
    cvxpy = pytest.importorskip("cvxpy")
    kernel = random_kernel(np.random.default_rng(5), 5)
    values, vectors = np.linalg.eigh(kernel)
    unknown = cvxpy.Variable((5, 5))
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    cost = 2.0 * cvxpy.sum_squares(root - unknown @ root) + 3.0 * cvxpy.normNuc(unknown)
    cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver=cvxpy.CLARABEL)
    expected = (vectors * np.maximum(0, 1 - 3.0 / (4.0 * np.maximum(values, 1e-12)))) @ vectors.T
    np.testing.assert_allclose(unknown.value, expected, atol=1e-3)
    np.testing.assert_allclose(converged(kernel, 2.0, 3.0)[0].coefficients, expected, atol=1e-6)


def test_points_in_two_separate_spans_express_only_their_own_kind():
    """Two sets of subspaces in orthogonal spaces: the affinity has two blocks."""
    rng = np.random.default_rng(0)
    points = np.zeros((6, 10, 2))
    points[:3, :5] = np.linalg.qr(rng.standard_normal((3, 5, 2)))[0]
    points[3:, 5:] = np.linalg.qr(rng.standard_normal((3, 5, 2)))[0]
    state, _ = converged(projection_kernel(points), 1.0, 0.5)
    together = state.affinity()
    assert np.abs(together[:3, 3:]).max() < 1e-8
    assert together[:3, :3].min() > 1e-3


def test_affinity_is_symmetric_and_uses_c_until_j_is_alive():
    matrix = np.array([[0.0, -2.0], [4.0, 1.0]])
    np.testing.assert_array_equal(affinity(matrix), [[0, 3], [3, 1]])
    state = SelfExpression(np.eye(2), 1.0, 1.0)
    state.coefficients = matrix
    np.testing.assert_array_equal(state.affinity(), affinity(matrix))
    state.auxiliary = np.eye(2)
    np.testing.assert_array_equal(state.affinity(), np.eye(2))
