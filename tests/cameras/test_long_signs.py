"""Signs of long sequences, for which the products of all pairs of frames are not formed."""

import numpy as np
import pytest

from nrsfm.cameras import signs


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share", [0.05, 0.3, 0.49])
def test_both_ways_give_the_same_signs(sequence, monkeypatch, seed, share):
    data = sequence(frames=60, points=50, rank=3, seed=seed)
    flips = np.where(np.random.default_rng(seed).random(60) < share, -1.0, 1.0)
    turned = signs.apply_signs(data.rotations, flips)
    pairs = signs.consistent_signs(turned, data.factor)
    monkeypatch.setattr(signs, "FEW_FRAMES", 0)
    np.testing.assert_array_equal(signs.consistent_signs(turned, data.factor), pairs)


def test_signs_of_a_long_sequence_are_recovered(sequence):
    data = sequence(frames=signs.FEW_FRAMES + 200, points=40, rank=2, seed=1)
    count = len(data.rotations)
    flips = np.where(np.random.default_rng(0).random(count) < 0.3, -1.0, 1.0)
    found = signs.consistent_signs(signs.apply_signs(data.rotations, flips), data.factor)
    assert abs(np.sum(found * flips)) == count
