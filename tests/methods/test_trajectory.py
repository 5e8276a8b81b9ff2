"""The pieces that the trajectory-basis methods share, each against an independent oracle."""

import numpy as np
import pytest

from nrsfm.methods.trajectory import (
    Candidate,
    Fit,
    VariableProjection,
    choose,
    clamped,
    damped_step,
    dct_basis,
    factor_motion,
    motion_matrix,
    project,
    rank_limit,
    shapes_from,
    sharpness,
)


def problem(frames=12, points=9, size=5, rank=2, seed=0):
    """Random rotations, W, Ω and X."""
    rng = np.random.default_rng(seed)
    rotations = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0][:, :2]
    flat = rng.standard_normal((2 * frames, points))
    return rotations, flat, dct_basis(frames, size), np.linalg.qr(rng.standard_normal((size, rank)))[0]


@pytest.mark.parametrize("frames", [1, 2, 7, 40])
def test_cosines_are_those_of_scipy(frames):
    from scipy.fft import dct

    basis = dct_basis(frames, frames)
    np.testing.assert_allclose(basis, dct(np.eye(frames), norm="ortho", axis=0).T, atol=1e-12)
    np.testing.assert_allclose(basis.T @ basis, np.eye(frames), atol=1e-12)


def test_motion_matrix_takes_bases_to_tracks():
    rotations, _, basis, unknowns = problem()
    coefficients = basis @ unknowns
    bases = np.random.default_rng(1).standard_normal((6, 9))
    expected = rotations @ shapes_from(coefficients, bases)
    np.testing.assert_allclose(motion_matrix(rotations, coefficients) @ bases, expected.reshape(24, 9), atol=1e-12)
    direct = coefficients[3, 0] * bases[:3] + coefficients[3, 1] * bases[3:]
    np.testing.assert_allclose(shapes_from(coefficients, bases)[3], direct, atol=1e-12)


@pytest.mark.parametrize("still", [False, True])
def test_projection_is_the_pseudoinverse(still):
    """Also where the camera rests and M has rank 2K only: then the least depth, none, is taken."""
    rotations, flat, basis, unknowns = problem()
    if still:
        rotations = np.repeat(rotations[:1], len(rotations), axis=0)
    matrix = motion_matrix(rotations, basis @ unknowns)
    bases, residual = project(rotations, basis @ unknowns, flat)
    np.testing.assert_allclose(bases, np.linalg.pinv(matrix, rcond=1e-9) @ flat, atol=1e-10)
    np.testing.assert_allclose(residual, flat - matrix @ bases, atol=1e-12)
    assert factor_motion(matrix)[0].shape[1] == (4 if still else 6)


def numerical_jacobian(function, unknowns, step=1e-6):
    columns = []
    for index in np.ndindex(unknowns.shape):
        move = np.zeros_like(unknowns)
        move[index] = step
        columns.append((function(unknowns + move) - function(unknowns - move)).ravel() / (2 * step))
    return np.stack(columns, axis=1)


def test_gradient_is_exact():
    rotations, flat, basis, unknowns = problem()
    objective = VariableProjection(rotations, flat, basis)
    _, gradient = objective.normal(objective.at(unknowns))
    numeric = numerical_jacobian(lambda x: np.array([objective.at(x).energy]), unknowns)[0]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-7)


def test_normal_matrix_is_the_part_of_the_jacobian_orthogonal_to_m():
    """The exact derivative of (I − MM⁺)W has a part inside the range of M, which Kaufman leaves out."""
    rotations, flat, basis, unknowns = problem()
    objective = VariableProjection(rotations, flat, basis)
    point = objective.at(unknowns)
    exact = numerical_jacobian(lambda x: objective.at(x).residual, unknowns).reshape(24, 9, -1)
    outside = exact - np.einsum("ab,bnj->anj", point.span @ point.span.T, exact)
    outside = outside.reshape(-1, unknowns.size)
    hessian, _ = objective.normal(point)
    np.testing.assert_allclose(hessian, outside.T @ outside, rtol=1e-5, atol=1e-6 * np.abs(hessian).max())
    assert np.abs(exact.reshape(outside.shape) - outside).max() > 0.1


def test_minimise_only_goes_down_and_ends_where_the_gradient_is_zero():
    rotations, flat, basis, _ = problem(frames=30, points=9)
    objective = VariableProjection(rotations, flat, basis)
    fit = objective.minimise(np.eye(5, 2), iterations=500, tolerance=1e-14)
    assert fit.energies == sorted(fit.energies, reverse=True)
    assert fit.reason != "iteration limit"
    hessian, gradient = objective.normal(objective.at(fit.unknowns))
    assert np.abs(gradient).max() < 1e-4 * np.trace(hessian)
    np.testing.assert_allclose(fit.unknowns.T @ fit.unknowns, np.eye(2), atol=1e-12)
    seen = (rotations @ fit.shapes).reshape(flat.shape)
    assert 0.5 * np.sum((flat - seen) ** 2) == pytest.approx(fit.energies[-1], rel=1e-10)


def test_damped_step_of_an_indefinite_or_zero_matrix_is_finite():
    matrix = np.diag([1.0, -1e-3, 0.0])
    assert np.isfinite(damped_step(matrix, np.ones(3), 1e-9)).all()
    np.testing.assert_array_equal(damped_step(np.zeros((3, 3)), np.ones(3), 1.0), 0)


def test_sharpness_of_exact_shapes_is_their_norm_and_grows_when_depth_is_invented():
    rotations, _, _, _ = problem(frames=20)
    rng = np.random.default_rng(2)
    shapes = np.repeat(rng.standard_normal((1, 3, 9)), 20, axis=0)
    flat = (rotations @ shapes).reshape(40, 9)
    norm, log = sharpness(rotations, flat, shapes)
    values = np.linalg.svd(shapes.reshape(20, -1), compute_uv=False)
    assert norm == pytest.approx(values.sum() / np.linalg.norm(flat), rel=1e-6)
    depth = np.cross(rotations[:, 0], rotations[:, 1])[:, :, None] * rng.standard_normal((20, 1, 9))
    worse = sharpness(rotations, flat, shapes + depth)
    assert worse[0] > 1.2 * norm
    assert worse[1] > log
    assert sharpness(rotations, 0 * flat, 0 * shapes) == (0.0, 0.0)


def test_choose_takes_the_sharpest_of_those_with_nearly_the_least_norm():
    fit = Fit(1, np.zeros((2, 3, 1)), np.eye(1), [0.0], "")
    made = [Candidate(fit, norm, log) for norm, log in ((1.0, 5.0), (1.02, 4.0), (1.1, 1.0))]
    assert choose(made) is made[1]


@pytest.mark.parametrize(
    ("frames", "points", "size", "expected"), [(30, 90, 30, (20, 20)), (30, 9, 30, (20, 3)), (30, 90, 4, (4, 4))]
)
def test_rank_limit(frames, points, size, expected):
    assert rank_limit(frames, points, size) == expected


def test_clamped_says_so():
    assert clamped(3, 5, "rank", "5 frames") == (3, [])
    assert clamped(7, 5, "rank", "5 frames") == (5, ["rank 7 is more than 5 frames allow: 5 is used"])
