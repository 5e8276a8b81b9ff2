"""The iteration that all three methods share: its steps against dense solves, its minimum against a convex solver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.methods.base import LowRankOptions, LowRankState, Problem, run_iterations, solve_global


def random_problem(seed, frames=4, points=5, noise=0.0):
    rng = np.random.default_rng(seed)
    rotations = np.ascontiguousarray(np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0][:, :2])
    tracks = rotations @ rng.standard_normal((frames, 3, points))
    tracks -= tracks.mean(axis=2, keepdims=True)
    tracks /= np.sqrt(np.mean(tracks**2))
    return Problem(tracks, np.array([0, points]), np.array([points]), rotations, noise)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(2, 8), st.floats(1e-6, 1e3))
def test_shape_step_is_the_dense_linear_solve(seed, frames, points, beta):
    """S = (RᵀR + βI)⁻¹(β(S♯ + L₁/β) + RᵀW), frame by frame, with a general solver."""
    rng = np.random.default_rng(seed)
    problem = random_problem(seed, frames, points)
    state = LowRankState.start(problem, LowRankOptions(beta=beta))
    state.beta = beta
    state.low_rank, state.multiplier = rng.standard_normal((2, *state.shapes.shape))
    low_rank, multiplier = state.low_rank.copy(), state.multiplier.copy()
    state.update_shapes()
    for f, rows in enumerate(problem.rotations):
        system = rows.T @ rows + beta * np.eye(3)
        right = beta * (low_rank[f] + multiplier[f] / beta) + rows.T @ problem.tracks[f]
        expected = np.linalg.solve(system, right)
        np.testing.assert_allclose(state.shapes[f], expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_array_equal(state.low_rank, low_rank)
    np.testing.assert_array_equal(state.multiplier, multiplier)


@pytest.mark.parametrize("reweight", [0.0, 0.05])
def test_low_rank_step_and_multiplier_step(reweight):
    rng = np.random.default_rng(0)
    problem = random_problem(0, 5, 6)
    state = LowRankState.start(problem, LowRankOptions(gamma=0.1, reweight=reweight))
    state.beta = 0.3
    state.multiplier = 0.1 * rng.standard_normal(state.shapes.shape)
    before = state.multiplier.copy()
    left, values, right = np.linalg.svd((state.shapes - before / 0.3).reshape(5, -1).T, full_matrices=False)
    cut = state.gamma / 0.3 * (reweight * values[0] / (values + reweight * values[0]) if reweight else 1.0)
    expected = ((left * np.maximum(values - cut, 0)) @ right).T.reshape(state.shapes.shape)
    state.update_low_rank()
    np.testing.assert_allclose(state.low_rank, expected, atol=1e-7)
    assert state.rank == np.count_nonzero(values > cut)
    gap = state.update_multiplier()
    np.testing.assert_allclose(state.multiplier, before + 0.3 * (state.low_rank - state.shapes), atol=1e-12)
    assert gap == pytest.approx(np.sqrt(np.mean((state.low_rank - state.shapes) ** 2)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("gamma", [0.02, 0.1, 0.3])
def test_the_global_model_reaches_the_convex_minimum(seed, gamma):
    """½‖W − RS‖² + γ‖S♯‖_* against a conic solver."""
    cvxpy = pytest.importorskip("cvxpy")
    problem = random_problem(seed)
    frames, _, points = problem.tracks.shape
    unknown = cvxpy.Variable((frames, 3 * points))  # S♯ᵀ, one frame per row
    fit = 0
    for f, rows in enumerate(problem.rotations):
        seen = rows @ cvxpy.reshape(unknown[f], (3, points), order="C")
        fit += 0.5 * cvxpy.sum_squares(problem.tracks[f] - seen)
    weight = gamma * np.sqrt(points)
    reference = cvxpy.Problem(cvxpy.Minimize(fit + weight * cvxpy.normNuc(unknown)))
    reference.solve(solver=cvxpy.CLARABEL)
    solution = solve_global(problem, LowRankOptions(gamma=gamma), lambda _: None)

    def cost(shapes):
        residual = problem.tracks - problem.rotations @ shapes
        return 0.5 * np.sum(residual**2) + weight * np.linalg.norm(shapes.reshape(frames, -1), "nuc")

    assert cost(solution.shapes) <= reference.value * (1 + 1e-4)
    assert cost(solution.shapes) >= reference.value * (1 - 1e-6)
    assert solution.history["energy"][-1] == pytest.approx(cost(solution.shapes), rel=1e-4)


def test_stop_reasons():
    problem = random_problem(1, 6, 20)

    def reason(**options):
        solution = solve_global(problem, LowRankOptions(**options), lambda _: None)
        assert solution.iterations == len(solution.history["gap"])
        return solution.stop_reason

    assert reason() == "gap"
    assert reason(max_iterations=7) == "iteration limit"
    assert reason(beta=1.0, beta_max=1.0, gap=1e-300) == "largest penalty"


def test_not_finite_is_reported_not_looped():
    problem = random_problem(1, 6, 20)
    state = LowRankState.start(problem, LowRankOptions())
    assert run_iterations(state, lambda _: float("nan"), lambda _: None) == (1, "not finite")


@pytest.mark.parametrize("reweight", [0.0, 0.01])
def test_default_penalty_starts_where_the_threshold_is_the_largest_value(reweight):
    problem = random_problem(2, 6, 20)
    state = LowRankState.start(problem, LowRankOptions(reweight=reweight))
    largest = np.linalg.norm(problem.initial_shapes.reshape(6, -1), 2)
    assert state.gamma / state.beta * (reweight or 1.0) == pytest.approx(largest)


def test_monitor_rises_to_one():
    told = []
    solve_global(random_problem(3, 6, 20), LowRankOptions(), told.append)
    assert all(0 <= share <= 1 for share in told)
    assert told[-1] > 0.8


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(2, 25))
def test_merged_problem_is_the_same_up_to_an_isometry(seed, frames, points):
    problem = random_problem(seed, frames, points)
    merged, back = problem.merged()
    assert merged.tracks.shape[2] <= min(2 * frames, points)
    assert merged.points == problem.points
    np.testing.assert_allclose(merged.tracks @ back, problem.tracks, atol=1e-10)
    np.testing.assert_allclose(back @ back.T, np.eye(len(back)), atol=1e-9)
