"""The leading eigenpairs of a Gram matrix against its full decomposition."""

import numpy as np
import pytest

from nrsfm.numerics.leading import leading_eigenpairs


def gram_of(rows, columns, rank, noise, seed=0):
    """A Gram matrix of falling signal and white noise."""
    rng = np.random.default_rng(seed)
    signal = rng.standard_normal((rows, rank)) * 0.8 ** np.arange(rank) @ rng.standard_normal((rank, columns))
    data = signal + noise * rng.standard_normal((rows, columns))
    return data @ data.T


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.05])
def test_pairs_that_stand_out_are_those_of_the_full_decomposition(noise):
    gram = gram_of(400, 900, 20, noise)
    values, vectors = np.linalg.eigh(gram)
    values, vectors = values[::-1], vectors[:, ::-1]
    found = leading_eigenpairs(gram, 40, full=0)
    clear = values[:40] > 10 * max(values[60], 1e-12 * values[0])
    assert clear.sum() >= 15
    np.testing.assert_allclose(found.values[clear], values[:40][clear], rtol=1e-8)
    cosines = np.abs(np.sum(found.vectors[:, clear] * vectors[:, :40][:, clear], axis=0))
    np.testing.assert_allclose(cosines, 1.0, atol=1e-8)
    np.testing.assert_allclose(found.vectors.T @ found.vectors, np.eye(40), atol=1e-10)


def test_what_is_left_out_is_the_energy_outside_the_span():
    gram = gram_of(300, 500, 30, 0.05)
    found = leading_eigenpairs(gram, 25, full=0)
    outside = np.eye(300) - found.vectors @ found.vectors.T
    assert found.left_out == pytest.approx(float(np.trace(outside @ gram @ outside)), rel=1e-8)
    assert found.residual < 1e-3


def test_the_number_grows_until_little_enough_is_left_out():
    gram = gram_of(500, 700, 60, 0.0)
    assert len(leading_eigenpairs(gram, 10, full=0).values) == 10
    energy = 1e-9 * float(np.trace(gram))
    more = leading_eigenpairs(gram, 10, energy=energy, full=0)
    assert len(more.values) > 10
    assert more.left_out <= energy


def test_the_number_grows_until_the_noise_is_reached():
    gram = gram_of(500, 700, 30, 0.05)
    edge = (0.05 * (np.sqrt(500) + np.sqrt(700))) ** 2
    found = leading_eigenpairs(gram, 8, energy=0.0, least=edge, full=0)
    assert len(found.values) < 500
    assert found.values[-1] <= edge < found.values[0]
    exact = np.linalg.eigvalsh(gram)[::-1]
    assert abs(np.count_nonzero(found.values > edge) - np.count_nonzero(exact > edge)) <= 1


def test_small_matrices_are_decomposed_in_full():
    gram = gram_of(60, 80, 10, 0.1)
    found = leading_eigenpairs(gram, 5)
    np.testing.assert_array_equal(found.values, np.linalg.eigh(gram)[0][::-1])
    assert found.vectors.shape == (60, 60)
    assert found.rounds == 0


def test_same_answer_every_time():
    gram = gram_of(300, 400, 20, 0.01)
    first, second = leading_eigenpairs(gram, 20, full=0), leading_eigenpairs(gram, 20, full=0)
    np.testing.assert_array_equal(first.vectors, second.vectors)


def test_a_matrix_of_zeros():
    found = leading_eigenpairs(np.zeros((200, 200)), 10, full=0)
    assert not found.values.any()
    assert found.left_out == 0.0
    assert np.isfinite(found.vectors).all()
