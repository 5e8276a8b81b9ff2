"""The closed form: exact where its assumptions hold, however the problem is put, and finite where they do not."""

import numpy as np
import pytest

from nrsfm.methods.linear_coefficients import largest_basis, linear_coefficients, shapes_of_coefficients

ZERO = 1e-6  # singular values are of order 1 elsewhere


def turned(rng, *size):
    """Rotations (…, 3, 3) anywhere."""
    q = np.linalg.qr(rng.standard_normal((*size, 3, 3)))[0]
    return q * np.linalg.det(q)[..., None, None]


def basis_shapes(frames, basis, points=40, seed=0, cameras=None, narrow=1.0):
    """Tracks (F, 2, P), camera rows (F, 2, 3), shapes (F, 3, P) and coefficients (F, K); ``narrow`` scales depth."""
    rng = np.random.default_rng(seed)
    rows = (turned(rng, frames) if cameras is None else cameras)[:, :2]
    coefficients = rng.standard_normal((frames, basis))
    coefficients[:, 0] += 2.0
    bases = rng.standard_normal((basis, 3, points)) * np.array([1.0, 1.0, narrow])[:, None]
    shapes = np.einsum("fk,kap->fap", coefficients, bases)
    return rows @ shapes, rows, shapes, coefficients


def found(tracks, rows, basis):
    coefficients, _ = linear_coefficients(tracks, rows, basis)
    return shapes_of_coefficients(coefficients, tracks, rows)


def error(estimate, truth):
    return np.linalg.norm(estimate - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("basis", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("extra", [0, 20])
def test_exact_from_nine_frames_for_five_basis_shapes_on(basis, extra):
    """Five equations a frame against 9K unknowns."""
    frames = max(3, -(-9 * basis // 5)) + extra
    tracks, rows, shapes, truth = basis_shapes(frames, basis)
    coefficients, values = linear_coefficients(tracks, rows, basis)
    assert coefficients.shape == (frames, basis)
    assert np.count_nonzero(values < ZERO) == basis
    assert error(shapes_of_coefficients(coefficients, tracks, rows), shapes) < 1e-8
    # One change of basis takes the coefficients to the true ones.
    change = np.linalg.lstsq(coefficients, truth, rcond=None)[0]
    np.testing.assert_allclose(coefficients @ change, truth, atol=1e-7)


def test_weak_basis_shapes_count_as_much_as_strong_ones():
    """Of size 1, 10⁻² and 10⁻⁴: what is small is no solution for being small."""
    rng = np.random.default_rng(1)
    rows = turned(rng, 30)[:, :2]
    coefficients = rng.standard_normal((30, 3))
    bases = rng.standard_normal((3, 3, 40)) * np.array([1.0, 1e-2, 1e-4])[:, None, None]
    shapes = np.einsum("fk,kap->fap", coefficients, bases)
    result = found(rows @ shapes, rows, 3)
    assert error(result, shapes) < 1e-9
    weakest = coefficients[:, 2, None, None] * bases[2]
    others = np.linalg.lstsq(coefficients, result.reshape(30, -1), rcond=None)[0].reshape(3, 3, 40)
    assert error(coefficients[:, 2, None, None] * others[2], weakest) < 1e-6


def test_fewer_basis_shapes_than_there_are_explain_less():
    tracks, rows, shapes, _ = basis_shapes(40, 4)
    errors = [error(found(tracks, rows, k), shapes) for k in (1, 2, 3, 4)]
    assert errors[3] < 1e-8 < 0.1 < min(errors[:3])


def test_the_object_frame_turns_the_shapes():
    tracks, rows, _, _ = basis_shapes(20, 3)
    turn = turned(np.random.default_rng(2))
    plain = found(tracks, rows, 3)
    np.testing.assert_allclose(found(tracks, rows @ turn.T, 3), turn @ plain, atol=1e-8)


def test_the_image_frame_and_the_unit_do_not_matter():
    tracks, rows, shapes, _ = basis_shapes(20, 3)
    angle = np.random.default_rng(3).uniform(0, 6, 20)
    turn = np.stack([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    noisy = tracks + 0.01 * np.random.default_rng(4).standard_normal(tracks.shape)
    plain = found(noisy, rows, 3)
    np.testing.assert_allclose(found(turn @ noisy, turn @ rows, 3), plain, atol=1e-8)
    for unit in (1e-9, 1e6):
        np.testing.assert_allclose(found(unit * noisy, rows, 3) / unit, plain, atol=1e-8)
    assert error(plain, shapes) > 1e-4  # noise was there to be moved about


def test_points_may_be_replaced_by_their_compression():
    tracks, rows, _, _ = basis_shapes(12, 3, points=200)
    noisy = tracks + 0.01 * np.random.default_rng(5).standard_normal(tracks.shape)
    left, values, right = np.linalg.svd(noisy.reshape(24, -1), full_matrices=False)
    small = found((left * values).reshape(12, 2, 24), rows, 3)
    np.testing.assert_allclose(small @ right, found(noisy, rows, 3), atol=1e-9)


@pytest.mark.parametrize(("frames", "basis"), [(3, 2), (4, 3), (6, 5), (10, 8)])
def test_too_few_frames_leave_more_solutions_than_basis_shapes(frames, basis):
    tracks, rows, shapes, _ = basis_shapes(frames, basis)
    _, values = linear_coefficients(tracks, rows, basis)
    assert np.count_nonzero(values < ZERO) > basis
    result = found(tracks, rows, basis)
    assert np.isfinite(result).all()
    assert error(result, shapes) > 0.1
    assert largest_basis(frames, 3 * basis) < basis


def test_the_largest_basis_is_that_of_the_rank_where_frames_are_many():
    assert [largest_basis(90, rank) for rank in (0, 1, 3, 4, 6, 30)] == [0, 1, 1, 2, 2, 10]
    assert [largest_basis(frames, 1000) for frames in (1, 2, 9, 18)] == [0, 1, 5, 10]


def still(frames):
    return np.repeat(turned(np.random.default_rng(6))[None], frames, axis=0)


DEGENERATE = {
    "flat basis shapes": basis_shapes(20, 3, narrow=0.0)[:2],
    "no camera rotation": basis_shapes(20, 3, cameras=still(20))[:2],
    "identical frames": tuple(np.repeat(array[:1], 20, axis=0) for array in basis_shapes(20, 3)[:2]),
    "more basis shapes than points": basis_shapes(30, 9, points=4)[:2],
    "one point moves": (np.eye(20)[:, None, :5] * np.ones((20, 2, 5)), basis_shapes(20, 3)[1]),
    "noise": (np.random.default_rng(7).standard_normal((20, 2, 40)), basis_shapes(20, 3)[1]),
    "zeros": (np.zeros((20, 2, 7)), basis_shapes(20, 3)[1]),
}


@pytest.mark.parametrize("kind", DEGENERATE)
@pytest.mark.parametrize("basis", [1, 3, 11])
def test_degenerate_tracks_give_finite_shapes(kind, basis):
    tracks, rows = DEGENERATE[kind]
    coefficients, values = linear_coefficients(tracks, rows, basis)
    shapes = shapes_of_coefficients(coefficients, tracks, rows)
    assert shapes.shape == (len(tracks), 3, tracks.shape[2])
    for array in (coefficients, values, shapes):
        assert np.isfinite(array).all()


def test_a_camera_that_does_not_turn_leaves_the_image_explained():
    tracks, rows = DEGENERATE["no camera rotation"]
    np.testing.assert_allclose(rows @ found(tracks, rows, 3), tracks, atol=1e-8)
