"""CSF2 recovers sequences whose rank-3 spaces are complementary; its derivatives against finite differences."""

import numpy as np
import pytest

from nrsfm.compression import compress, measure, uncompressed
from nrsfm.methods import get_method
from nrsfm.methods.base import Problem
from nrsfm.methods.csf2 import NestedProjection
from nrsfm.methods.trajectory import dct_basis, motion_matrix
from nrsfm.metrics import camera_frame_error, shape_error
from nrsfm.options import build_options
from nrsfm.pipeline import reconstruct


def complementary_sequence(frames=40, points=30, seed=0):
    """Two shapes with coefficients even and odd in time, under cameras that are even: M₁ᵀM₂ = 0."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    vectors = np.cumsum(rng.standard_normal((frames // 2, 3)), axis=0) * 0.5
    half = Rotation.from_rotvec(vectors).as_matrix()
    rotations = np.concatenate([half, half[::-1]])
    cosines = dct_basis(frames, 6)
    coefficients = np.stack([cosines[:, 0] + 0.1 * cosines[:, 2], 0.5 * cosines[:, 1] - 0.3 * cosines[:, 3]], axis=1)
    shapes = np.einsum("fk,kpi->fpi", coefficients, rng.standard_normal((2, points, 3)))
    shapes -= shapes.mean(axis=1, keepdims=True)
    return (shapes @ rotations.transpose(0, 2, 1))[..., :2], shapes, rotations, coefficients


def solution_of(tracks, rotations, points=False, **options):
    measured = measure(tracks)
    small = uncompressed(measured) if points else compress(measured, np.zeros(measured.count, dtype=int))
    problem = Problem(small.factors, small.offsets, small.sizes, np.ascontiguousarray(rotations[:, :2]), 0.0)
    method = get_method("csf2")
    found = method.solve(problem, build_options(method.Options, options), np.random.default_rng(0), lambda _: None)
    return small.expand(found.shapes, np.dtype(np.float64)), found


def test_recovers_complementary_spaces():
    tracks, shapes, rotations, coefficients = complementary_sequence()
    first, second = (motion_matrix(rotations[:, :2], coefficients[:, k : k + 1]) for k in (0, 1))
    assert np.abs(first.T @ second).max() < 1e-12
    found, solution = solution_of(tracks, rotations, rank=2, basis_size=6, least_gain=1e-14, max_iterations=300)
    assert shape_error(found, shapes, "none") < 1e-6
    assert solution.history["energy"][-1] < 1e-10


def test_chooses_the_number_of_spaces():
    tracks, shapes, rotations, _ = complementary_sequence()
    found, solution = solution_of(tracks, rotations)
    assert solution.chosen["rank"] == 2
    assert shape_error(found, shapes, "none") < 0.01


def nested(seed=0):
    rng = np.random.default_rng(seed)
    rotations = np.linalg.qr(rng.standard_normal((12, 3, 3)))[0][:, :2]
    unknowns = rng.standard_normal((5, 3))
    unknowns /= np.linalg.norm(unknowns, axis=0)
    return NestedProjection(rotations, rng.standard_normal((24, 9)), dct_basis(12, 5)), unknowns


def test_chain_is_the_product_of_complements():
    objective, unknowns = nested()
    chain = objective.at(unknowns)
    residual = objective.flat
    for k in range(3):
        matrix = motion_matrix(objective.rotations, objective.basis @ unknowns[:, k : k + 1])
        np.testing.assert_allclose(chain.bases[k], np.linalg.pinv(matrix) @ residual, atol=1e-10)
        residual = residual - matrix @ np.linalg.pinv(matrix) @ residual
    np.testing.assert_allclose(chain.residuals[-1], residual, atol=1e-12)
    assert chain.energy == pytest.approx(0.5 * np.sum(residual**2))


def test_normal_matrix_and_gradient_are_those_of_the_numerical_jacobian():
    objective, unknowns = nested()
    columns = []
    for k in range(3):
        for i in range(5):
            step = np.zeros_like(unknowns)
            step[i, k] = 1e-6
            ends = [objective.at(unknowns + sign * step).residuals[-1] for sign in (1, -1)]
            columns.append((ends[0] - ends[1]).ravel() / 2e-6)
    jacobian = np.stack(columns, axis=1)
    chain = objective.at(unknowns)
    hessian, gradient = objective.normal(chain)
    np.testing.assert_allclose(hessian, jacobian.T @ jacobian, atol=1e-6 * np.abs(hessian).max())
    np.testing.assert_allclose(gradient, jacobian.T @ chain.residuals[-1].ravel(), atol=1e-6 * np.abs(gradient).max())


def test_more_spaces_explain_more(sequence):
    data = sequence(noise=0.05, rank=3)
    energies = [solution_of(data.tracks, data.rotations, rank=k)[1].history["energy"][-1] for k in (1, 2, 4)]
    assert energies[0] > 1.05 * energies[1] > 1.05**2 * energies[2]


def test_one_cell_compressed_is_all_points(sequence):
    data = sequence(noise=0.05)
    small, _ = solution_of(data.tracks, data.rotations, rank=4, basis_size=10)
    full, _ = solution_of(data.tracks, data.rotations, points=True, rank=4, basis_size=10)
    np.testing.assert_allclose(small, full, rtol=0, atol=1e-5 * np.abs(full).max())


@pytest.mark.parametrize("switch", [{"rank": 1}, {"basis_size": 5}, {"max_iterations": 1}, {"least_gain": 0.5}])
def test_every_option_does_something(switch, sequence):
    data = sequence(noise=0.05, rank=3)
    common = {"rank": 3, "basis_size": 12}
    plain, _ = solution_of(data.tracks, data.rotations, **common)
    other, _ = solution_of(data.tracks, data.rotations, **(common | switch))
    assert np.abs(other - plain).max() > 1e-5 * np.abs(plain).max()


def test_published_number(data_root):
    from nrsfm.datasets import load

    data = load("pickup", data_root)
    result = reconstruct(data.tracks, "csf2", rank=7)
    assert camera_frame_error(result, data.shapes, data.rotations) < 0.0307
