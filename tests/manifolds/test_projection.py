"""The map Δ: its matrices against the double loop, its eigen-solution against an optimiser on the Stiefel manifold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.manifolds.grassmann import similarity_graph
from nrsfm.manifolds.projection import lower, project, projection_energy, reduced_dimension


def random_points(seed, count, ambient, dimension, spread=1.0):
    rng = np.random.default_rng(seed)
    common = rng.standard_normal((ambient, dimension))
    return np.linalg.qr(common + spread * rng.standard_normal((count, ambient, dimension)))[0]


def by_the_definition(points, dimension):
    """X, Y, start Δ and Λ-energy at the start, by loops over pairs of d×d matrices as the paper writes them."""
    count, ambient, _ = points.shape
    stacked = points.transpose(1, 0, 2).reshape(ambient, -1)
    start = np.linalg.svd(stacked)[0][:, :dimension]
    omega = []
    for basis in points:
        _, upper = np.linalg.qr(start.T @ basis)
        omega.append(basis @ np.linalg.inv(upper))
    graph = similarity_graph(points)
    metric = sum(graph[i].sum() * omega[i] @ omega[i].T for i in range(count))
    start = start / np.sqrt(np.trace(start.T @ metric @ start))
    bending, energy = np.zeros((ambient, ambient)), 0.0
    for i in range(count):
        for j in range(count):
            gap = omega[i] @ omega[i].T - omega[j] @ omega[j].T
            bending += graph[i, j] / 2 * gap @ start @ start.T @ gap
            energy += graph[i, j] / 2 * np.linalg.norm(start.T @ gap @ start) ** 2
    return metric, bending, start, energy


SIZES = [(5, 7, 2, 3), (4, 6, 3, 4), (8, 9, 2, 4), (6, 5, 1, 1)]


@pytest.mark.parametrize(("count", "ambient", "p", "dimension"), SIZES)
def test_the_eigen_solution_is_the_constrained_minimum(count, ambient, p, dimension):
    pymanopt = pytest.importorskip("pymanopt")
    points = random_points(count, count, ambient, p)
    metric, bending, _, energy = by_the_definition(points, dimension)
    result = project(points, similarity_graph(points), dimension, rounds=1)
    delta = result.delta
    np.testing.assert_allclose(delta.T @ metric @ delta, np.eye(dimension) / dimension, atol=1e-7)
    assert np.trace(delta.T @ metric @ delta) == pytest.approx(1, abs=1e-7)
    assert result.energies[0] == pytest.approx(energy, rel=1e-8)

    # Δ = X^(−1/2) Q / √d̃ with Q on the Stiefel manifold, from several starts.
    values, vectors = np.linalg.eigh(metric)
    root = (vectors / np.sqrt(values)) @ vectors.T
    matrix = root @ bending @ root
    manifold = pymanopt.manifolds.Stiefel(ambient, dimension)

    @pymanopt.function.numpy(manifold)
    def cost(q):
        return np.trace(q.T @ matrix @ q) / np.trace(matrix)

    @pymanopt.function.numpy(manifold)
    def gradient(q):
        return 2 * matrix @ q / np.trace(matrix)

    problem = pymanopt.Problem(manifold, cost, euclidean_gradient=gradient)
    optimiser = pymanopt.optimizers.ConjugateGradient(verbosity=0, max_iterations=2000, min_gradient_norm=1e-9)
    rng = np.random.default_rng(0)
    best = min(
        optimiser.run(problem, initial_point=np.linalg.qr(rng.standard_normal((ambient, dimension)))[0]).cost
        for _ in range(2)
    )
    mine = np.trace(delta.T @ bending @ delta) * dimension / np.trace(matrix)
    assert mine <= best + 1e-8
    assert mine >= best - 1e-6  # no better than the minimum: the constraint is really met


@pytest.mark.parametrize(("count", "ambient", "p", "dimension"), SIZES)
def test_a_second_round_uses_the_first_ones_answer(count, ambient, p, dimension):
    points = random_points(count, count, ambient, p)
    once = project(points, similarity_graph(points), dimension, rounds=1)
    twice = project(points, similarity_graph(points), dimension, rounds=2)
    _, omega = lower(points, once.delta)
    degree = similarity_graph(points).sum(axis=1)
    metric = np.einsum("k,kip,kjp->ij", degree, omega, omega)
    scaled = once.delta / np.sqrt(np.trace(once.delta.T @ metric @ once.delta))
    assert twice.energies[0] == once.energies[0]
    assert twice.energies[1] == pytest.approx(projection_energy(omega, similarity_graph(points), scaled), rel=1e-6)
    assert np.trace(twice.delta.T @ metric @ twice.delta) == pytest.approx(1, abs=1e-6)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 9),
    st.integers(2, 14),
    st.integers(1, 5),
    st.integers(1, 14),
    st.sampled_from([0.0, 1e-7, 0.1, 3.0]),
)
def test_projected_points_are_points(seed, count, ambient, p, dimension, spread):
    """Θ orthonormal with the span of ΔᵀΦ, everything finite, also for equal and for few subspaces."""
    p = min(p, ambient)
    dimension = int(np.clip(dimension, p, ambient))
    points = random_points(seed, count, ambient, p, spread)
    result = project(points, similarity_graph(points), dimension)
    assert p <= result.dimension <= dimension
    assert np.isfinite(result.delta).all()
    assert np.isfinite(result.energies).all()
    for theta, basis in zip(result.points, points, strict=True):
        np.testing.assert_allclose(theta.T @ theta, np.eye(p), atol=1e-8)
        image = result.delta.T @ basis
        np.testing.assert_allclose(theta @ (theta.T @ image), image, atol=1e-8 * np.linalg.norm(image))


def test_subspaces_along_the_axes_are_projected_without_overflow():
    """Δ flattens some of them exactly; there is no image, but there is a finite answer."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        ambient, p = int(rng.integers(3, 20)), int(rng.integers(1, 3))
        points = np.stack([np.eye(ambient)[:, rng.permutation(ambient)[:p]] for _ in range(7)])
        result = project(points, similarity_graph(points), p)
        assert np.isfinite(result.delta).all()
        np.testing.assert_allclose(
            result.points.transpose(0, 2, 1) @ result.points, np.broadcast_to(np.eye(p), (7, p, p)), atol=1e-8
        )


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_bases_and_coordinates_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    points = random_points(seed, 5, 8, 2)
    turned = np.linalg.qr(rng.standard_normal((8, 8)))[0] @ points @ np.linalg.qr(rng.standard_normal((5, 2, 2)))[0]
    a = project(points, similarity_graph(points), 4).points
    b = project(turned, similarity_graph(turned), 4).points
    kernels = [np.einsum("iap,jaq->ijpq", x, x) for x in (a, b)]
    np.testing.assert_allclose(*[np.sum(k**2, axis=(2, 3)) for k in kernels], atol=1e-5)


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(2, 12), st.integers(1, 4), st.floats(0.01, 1.0))
def test_reduced_dimension_is_the_least_that_holds_the_share(seed, count, ambient, p, share):
    p = min(p, ambient)
    points = random_points(seed, count, ambient, p)
    energy = np.linalg.svd(points.transpose(1, 0, 2).reshape(ambient, -1), compute_uv=False) ** 2
    got = reduced_dimension(points, share)
    least = next(m for m in range(1, len(energy) + 1) if energy[:m].sum() >= (share - 1e-9) * energy.sum())
    assert got == max(least, p)
    assert got <= ambient


def test_reduced_dimension_of_equal_points_is_p():
    points = np.repeat(random_points(0, 1, 9, 3), 5, axis=0)
    assert reduced_dimension(points, 1.0) == 3
    assert reduced_dimension(points, 0.1) == 3


@pytest.mark.parametrize("seed", range(5))
def test_energy_is_the_double_loop(seed):
    rng = np.random.default_rng(seed)
    points, delta = random_points(seed, 4, 6, 2), rng.standard_normal((6, 3))
    graph = similarity_graph(points)
    expected = 0.0
    for i in range(4):
        for j in range(4):
            gap = points[i] @ points[i].T - points[j] @ points[j].T
            expected += graph[i, j] / 2 * np.linalg.norm(delta.T @ gap @ delta) ** 2
    assert projection_energy(points, graph, delta) == pytest.approx(expected, rel=1e-9)
