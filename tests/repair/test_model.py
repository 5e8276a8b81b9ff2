import numpy as np

from nrsfm.datasets.corruption import occlude
from nrsfm.repair.cells import learn_cells
from nrsfm.repair.growth import hide_like_missing, learn
from nrsfm.repair.model import Model, Prior, empty_model, fit, grown, infer


def silent(fraction):
    assert 0 <= fraction <= 1


def as_tracks(points, visible):
    tracks = (points - points.mean(axis=1, keepdims=True)).transpose(0, 2, 1)
    tracks = tracks / np.sqrt(np.mean(tracks**2))
    return tracks, np.where(visible[:, None], tracks, 0.0)


def random_model(rng, frames=6, rank=3):
    return Model(
        rng.standard_normal((frames, 2, rank)),
        rng.standard_normal((frames, 2)),
        np.zeros((frames, rank + 1, rank + 1)),
        np.ones(rank),
        0.09,
        np.zeros((0, rank)),
    )


def test_coefficients_are_the_conditional_mean_and_covariance_of_the_joint_gaussian(rng):
    # Independent oracle: w = M b + μ + noise is jointly Gaussian with b; condition on the seen coordinates.
    model = random_model(rng)
    tracks = rng.standard_normal((6, 2, 5))
    seen = rng.random((6, 5)) < 0.6
    prior = Prior(rng.standard_normal(3), np.linalg.inv(np.diag([0.5, 1.0, 2.0])))
    for given in (None, prior):
        mean, covariance = infer(model, np.where(seen[:, None], tracks, 0), seen.astype(float), given)
        centre = np.zeros(3) if given is None else given.mean
        spread = np.eye(3) if given is None else np.linalg.inv(given.precision)
        for j in range(5):
            rows = np.repeat(seen[:, j], 2)
            m = model.loadings.reshape(12, 3)[rows]
            gain = spread @ m.T @ np.linalg.inv(m @ spread @ m.T + 0.09 * np.eye(len(m)))
            gap = tracks[:, :, j].reshape(12)[rows] - model.means.reshape(12)[rows] - m @ centre
            np.testing.assert_allclose(mean[j], centre + gain @ gap, atol=1e-10)
            np.testing.assert_allclose(covariance[j], spread - gain @ m @ spread, atol=1e-10)


def test_the_fit_raises_the_likelihood_of_complete_tracks_to_that_of_the_closed_form(sheet, rng):
    # Without gaps and with many points the posterior of the rows is sharp, and the fixed point is that of probabilistic
    # PCA, known in closed form: noise = mean of the eigenvalues left out (Tipping and Bishop 1999).
    tracks, _ = as_tracks(sheet, np.ones(sheet.shape[:2], dtype=bool))
    tracks = tracks + 0.05 * rng.standard_normal(tracks.shape)
    seen = np.ones((tracks.shape[0], tracks.shape[2]))
    model = grown(empty_model(tracks, seen), tracks, seen, 4)
    model, *_ = fit(model, tracks, seen, robust=False, iterations=300, change=1e-8)
    flat = tracks.reshape(-1, tracks.shape[2])
    values = np.linalg.eigvalsh(np.cov(flat, bias=True))
    np.testing.assert_allclose(model.variance, np.mean(values[:-4]), rtol=0.05)
    basis = np.linalg.qr(model.loadings.reshape(-1, 4))[0]
    top = np.linalg.eigh(np.cov(flat))[1][:, -4:]
    assert np.linalg.svd(basis.T @ top, compute_uv=False).min() > 0.999


def test_exact_tracks_are_completed_exactly(sheet, rng):
    visible = occlude(sheet, 0.4, rng, "random")
    truth, tracks = as_tracks(sheet, visible)
    learned = learn(tracks, visible, None, rng=rng, monitor=silent)
    error = truth - learned.model.predict(learned.model.coefficients)
    assert np.abs(error).max() < 1e-4
    assert np.sqrt(np.mean(error**2)) < 1e-5
    assert learned.model.rank == 6  # the first step that holds the five directions of the sheet


def test_too_large_a_rank_does_little_harm(sheet, rng):
    visible = occlude(sheet, 0.3, rng, "random")
    truth, _ = as_tracks(sheet, visible)
    noisy = truth + 0.02 * rng.standard_normal(truth.shape)
    tracks = np.where(visible[:, None], noisy, 0.0)
    errors = []
    for rank in (9, 20):
        learned = learn(tracks, visible, rank, rng=np.random.default_rng(1), monitor=silent)
        assert learned.model.rank == rank
        error = (truth - learned.model.predict(learned.model.coefficients)).transpose(0, 2, 1)[~visible]
        errors.append(np.sqrt(np.mean(error**2)))
    assert errors[0] < 0.03
    assert errors[1] < 1.3 * errors[0]


def test_student_noise_ignores_a_few_wild_entries(sheet, rng):
    truth, tracks = as_tracks(sheet, np.ones(sheet.shape[:2], dtype=bool))
    tracks = tracks.copy()
    wild = rng.random((tracks.shape[0], tracks.shape[2])) < 0.05
    tracks[np.repeat(wild[:, None], 2, axis=1)] += 3.0
    errors = []
    for robust in (True, False):
        model, seen = empty_model(tracks, np.ones(wild.shape)), np.ones(wild.shape)
        weights = seen
        for rank in (3, 6, 9):
            model = grown(model, tracks, weights, rank)
            model, _, weights, _ = fit(
                model, tracks, seen, robust=robust, iterations=30, change=1e-4, weights=weights if robust else None
            )
        errors.append(np.sqrt(np.mean((truth - model.predict(model.coefficients)) ** 2)))
    assert errors[0] < 0.02 < 0.1 < errors[1]


def test_what_is_held_out_was_seen_and_is_at_most_half_of_a_track(sheet, rng):
    visible = occlude(sheet, 0.3, rng)
    held = hide_like_missing(visible, rng)
    assert held.any()
    assert not (held & ~visible).any()
    assert (held.sum(axis=0) <= visible.sum(axis=0) / 2).all()
    assert (held.sum(axis=1) <= 0.3 * visible.sum(axis=1) + 1).all()


def test_neighbours_tell_what_a_long_gap_hides(sheet, rng):
    # A third of the points is not seen for half of the time: their neighbours are.
    visible = np.ones(sheet.shape[:2], dtype=bool)
    gone = rng.choice(sheet.shape[1], size=sheet.shape[1] // 3, replace=False)
    visible[15:, gone] = False
    truth, _ = as_tracks(sheet, visible)
    tracks = np.where(visible[:, None], truth + 0.03 * rng.standard_normal(truth.shape), 0.0)
    model = learn(tracks, visible, 9, rng=rng, monitor=silent).model
    use = visible.astype(float)
    cells = learn_cells(model, visible.shape[1], lambda: iter([(np.arange(visible.shape[1]), tracks, use)]), rng)
    assert cells is not None
    alone, _ = infer(model, tracks, use)
    joined, _ = infer(model, tracks, use, cells.prior(alone))
    hidden = ~visible
    errors = [np.sqrt(np.mean((truth - model.predict(b)).transpose(0, 2, 1)[hidden] ** 2)) for b in (alone, joined)]
    assert errors[1] < errors[0]
