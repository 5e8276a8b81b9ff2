"""Scores of tracks against hand-made truth."""

import numpy as np
import pytest

from nrsfm.errors import InputError
from nrsfm.video import score_tracks


def test_known_errors_give_known_scores() -> None:
    truth = np.zeros((3, 4, 2))
    seen = np.ones((3, 4), dtype=bool)
    seen[2, 3] = False
    guess = truth.copy()
    guess[1] += [[0, 0], [0.6, 0], [0, 2], [3, 4]]
    guess[2, 3] = 1000  # hidden: does not count
    guess[2, 0] = np.nan  # a miss
    called = seen.copy()
    called[1, 0], called[2, 3] = False, True
    scores = score_tracks(guess, called, truth, seen, reference=0)
    assert scores.entries == 7
    assert scores.mean == pytest.approx((0.6 + 2 + 5) / 6)
    assert scores.median == pytest.approx(0.3)
    np.testing.assert_allclose(scores.per_frame, [np.nan, 7.6 / 4, 0])
    assert (scores.under_1, scores.under_3, scores.missing) == pytest.approx((4 / 7, 5 / 7, 1 / 7))
    assert (scores.precision, scores.recall, scores.hidden_recall) == pytest.approx((6 / 7, 6 / 7, 0))
    assert "median 0.30 px" in str(scores)


def test_perfect_tracks_score_perfectly() -> None:
    truth = np.random.default_rng(0).uniform(0, 100, (5, 30, 2)).astype(np.float32)
    seen = np.random.default_rng(1).random((5, 30)) < 0.7
    scores = score_tracks(truth, seen, truth, seen)
    assert (scores.mean, scores.under_1, scores.precision, scores.recall, scores.hidden_recall) == (0, 1, 1, 1, 1)
    assert score_tracks(truth, None, truth, seen).precision == pytest.approx(seen.mean())


def test_what_does_not_fit_is_refused() -> None:
    truth, seen = np.zeros((3, 4, 2)), np.ones((3, 4), dtype=bool)
    for arguments, message in (
        ((truth[:2], seen, truth, seen), "tracks: shape"),
        ((truth, seen[:, :3], truth, seen), "visible: bool of shape"),
        ((truth, seen, truth, seen.astype(int)), "true_visible: bool"),
        ((truth, seen, truth, ~seen), "at least one visible entry"),
        ((truth, seen, truth[..., 0], seen), "true_tracks: shape"),
    ):
        with pytest.raises(InputError, match=message):
            score_tracks(*arguments)
    with pytest.raises(InputError, match="reference"):
        score_tracks(truth, seen, truth, seen, reference=3)
