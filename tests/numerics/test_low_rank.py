"""The threshold through the Gram matrix against the singular value decomposition of S♯ itself."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nrsfm.numerics.low_rank import threshold_over_frames


def stacked(shapes):
    """S♯ (3N, F): one frame per column."""
    return shapes.reshape(len(shapes), -1).T


@st.composite
def random_shapes(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames, points = draw(st.integers(1, 9)), draw(st.integers(1, 12))
    rank = draw(st.integers(1, 9))
    flat = rng.standard_normal((frames, rank)) @ rng.standard_normal((rank, 3 * points))
    return flat.reshape(frames, 3, points)


@settings(max_examples=80)
@given(random_shapes(), st.floats(0, 1.2), st.sampled_from([None, 0.01, 0.3, 2.0]))
def test_threshold_is_that_of_the_svd(shapes, share, reweight):
    left, values, right = np.linalg.svd(stacked(shapes), full_matrices=False)
    threshold = share * values[0]
    cut = threshold if reweight is None else threshold * reweight * values[0] / (values + reweight * values[0])
    expected = (left * np.maximum(values - cut, 0)) @ right
    got, kept = threshold_over_frames(shapes, threshold, reweight)
    np.testing.assert_allclose(stacked(got), expected, rtol=0, atol=1e-6 * values[0])
    size = min(len(values), len(kept))
    np.testing.assert_allclose(kept[:size], np.maximum(values - cut, 0)[:size], rtol=0, atol=1e-6 * values[0])
    np.testing.assert_allclose(kept[size:], 0, atol=1e-6 * values[0])


def test_a_large_threshold_leaves_nothing():
    shapes = np.random.default_rng(0).standard_normal((4, 3, 7))
    got, kept = threshold_over_frames(shapes, 1e3)
    assert not got.any()
    assert not kept.any()


def test_zero_shapes():
    got, kept = threshold_over_frames(np.zeros((4, 3, 7)), 0.1, 0.01)
    assert not got.any()
    assert not kept.any()


def test_reweighting_spares_the_large_values():
    shapes = np.random.default_rng(0).standard_normal((6, 3, 20))
    values = np.linalg.svd(stacked(shapes), compute_uv=False)
    _, plain = threshold_over_frames(shapes, 0.3 * values[0])
    _, reweighted = threshold_over_frames(shapes, 0.3 * values[0], 0.01)
    assert np.all(reweighted >= plain)
    assert reweighted[0] > 0.99 * values[0] > plain[0]
