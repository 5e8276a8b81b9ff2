"""The default method: exact where it can be, the most likely of its beginnings, no worse than others, never lost."""

from dataclasses import replace

import numpy as np
import pytest

from nrsfm import reconstruct
from nrsfm.datasets.synthetic import face_sequence
from nrsfm.methods.auto import (
    FAR,
    FEW,
    MIDDLE,
    NEAR,
    TELLING,
    Auto,
    AutoOptions,
    _most_likely,
    _Start,
    _worth_following,
    closed_form,
    leading,
    misfit_variance,
    unsteadiness,
    without_noise,
)
from nrsfm.methods.base import Problem
from nrsfm.methods.procrustean_fit import Fit
from nrsfm.methods.procrustean_normal import ProcrusteanNormal
from nrsfm.metrics import shape_error

EXACT = {"tolerance": 0.0, "denoise": False, "noise_level": 0.0}
PLAIN = {"precision": "float64", "perspective": "off", "outliers": False, "deviation": False, "gauge": "method"}


def turned(rng, frames):
    """Rotations (F, 3, 3) anywhere."""
    q = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


def problem_of(shapes, rotations, noise=0.0, seed=0, **more):
    """One cell of all points of shapes (F, 3, P), uncompressed, and its root mean square."""
    tracks = rotations[:, :2] @ shapes
    tracks = tracks + noise * np.random.default_rng(seed).standard_normal(tracks.shape)
    tracks -= tracks.mean(axis=2, keepdims=True)
    unit = np.sqrt(np.mean(tracks**2))
    count = tracks.shape[2]
    return Problem(tracks / unit, np.array([0, count]), np.array([count]), rotations[:, :2], 0.0, **more), unit


def basis_problem(frames, points, basis, seed=0):
    """Shapes without a mean: K basis shapes that count alike."""
    rng = np.random.default_rng(seed)
    coefficients = rng.standard_normal((frames, basis))
    bases = rng.standard_normal((basis, 3, points))
    bases -= bases.mean(axis=2, keepdims=True)
    shapes = np.einsum("fk,kap->fap", coefficients, bases)
    problem, unit = problem_of(shapes, turned(rng, frames))
    return problem, shapes / unit


def solved(problem, monitor=lambda _: None, **options):
    return Auto().solve(problem, AutoOptions(**options), np.random.default_rng(0), monitor)


def error(estimate, truth):
    return np.linalg.norm(estimate - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("frames", "points", "rank"), [(30, 80, 1), (30, 80, 3), (40, 20, 2), (60, 40, 3), (12, 60, 2)]
)
def test_exact_tracks_of_low_rank_give_their_shapes(sequence, frames, points, rank, known):
    """More points than 2F and fewer, many frames and few, cameras given and estimated."""
    data = sequence(frames, points, rank)
    result = reconstruct(data.tracks, rotations=data.rotations if known else None, **PLAIN)
    assert result.method == "auto"
    assert shape_error(result, data.shapes, "none" if known else "per-frame") < 1e-3


def test_what_is_followed_is_what_was_judged_better():
    shapes = np.zeros((2, 3, 4))
    found = {"low rank": shapes, "trajectories": shapes, "closed form": shapes}
    judged = {"low rank": 5.0, "trajectories": 4.0, "closed form": 6.0}

    def followed(names, noisy=False):
        starts = _worth_following({n: found[n] for n in names}, {n: judged[n] for n in names}, 1e-7, noisy=noisy)
        return [(start.name, start.noise) for start in starts]

    assert followed(found) == [("low rank", NEAR), ("closed form", 1e-7)]
    assert followed(found, noisy=True) == [("trajectories", MIDDLE)]
    assert followed(["low rank", "trajectories"]) == [("low rank", noise) for noise in (NEAR, MIDDLE, FAR)]
    found["smooth motion"], judged["smooth motion"] = shapes, 9.0  # never exact: followed only where nothing may be
    assert followed(found) == [("low rank", NEAR), ("closed form", 1e-7)]
    assert followed(["low rank", "smooth motion"])[-1] == ("smooth motion", MIDDLE)


def test_the_number_of_basis_shapes_is_found_by_likelihood():
    problem, shapes = basis_problem(40, 60, 4)
    merged, back = leading(*problem.merged())
    cameras = np.concatenate([merged.rotations, np.cross(merged.rotations[:, :1], merged.rotations[:, 1:])], axis=1)
    unit = np.sqrt(1.5 * np.mean(np.sum(merged.tracks**2, axis=(1, 2))))
    best, judged = closed_form(merged.tracks / unit, cameras, misfit_variance(merged, 1e-3) / unit**2)
    assert max(judged, key=judged.get) == 4
    assert error(unit * best @ back, shapes) < 1e-8


def test_a_fit_the_likelihood_speaks_for_is_returned(sequence):
    data = sequence(noise=0.01)
    chosen = reconstruct(data.tracks, rotations=data.rotations, **PLAIN).diagnostics["chosen"]
    likelihoods = {(name, noise): value for name, noise, value, _ in chosen["likelihoods"]}
    assert len(likelihoods) > 1
    margin = TELLING * len(data.tracks) * chosen["directions"]
    assert likelihoods[chosen["start"], chosen["first_noise"]] >= max(likelihoods.values()) - margin


def fits(*likelihoods, name="x", shapes=None):
    """Fits that began at growing σ², with given likelihoods."""
    model = ProcrusteanNormal(np.zeros((3, 4)), np.zeros((12, 1)), 0.0, 1e-8)
    noises = (1e-5, 1e-4, FAR)
    shapes = [np.ones((2, 3, 4))] * 3 if shapes is None else shapes
    turns = np.broadcast_to(np.eye(3), (len(shapes[0]), 3, 3))
    return [
        (_Start(name, shape, noise), Fit(shape, turns, model, value, 1, "", {}))
        for noise, value, shape in zip(noises, likelihoods, shapes, strict=True)
    ]


def test_without_an_order_a_fit_from_afar_needs_a_margin():
    assert _most_likely(fits(1.0, 2.0, 2.5), 1.0, ordered=False)[0].noise == 1e-4
    assert _most_likely(fits(1.0, 2.0, 3.5), 1.0, ordered=False)[0].noise == FAR
    assert _most_likely(fits(3.0, 2.0, 2.5), 0.0, ordered=False)[0].noise == 1e-5


def test_where_the_likelihood_does_not_tell_the_steadier_fit_is_taken():
    rng = np.random.default_rng(0)
    still = np.linspace(1.0, 2.0, 20)[:, None, None] * rng.standard_normal((1, 3, 4)) + rng.standard_normal((3, 4))
    jerky = still[rng.permutation(20)]
    shapes = [jerky, still, jerky]
    assert unsteadiness(fits(0, 0, 0, shapes=shapes)[1][1]) < 0.1 * unsteadiness(fits(0, 0, 0, shapes=shapes)[0][1])
    assert _most_likely(fits(2.5, 2.0, 1.9, shapes=shapes), 1.0, ordered=True)[0].noise == 1e-4
    assert _most_likely(fits(3.5, 2.0, 1.9, shapes=shapes), 1.0, ordered=True)[0].noise == 1e-5
    exact = fits(2.5, 2.0, 1.9, name="closed form", shapes=shapes)
    assert _most_likely(exact, 1.0, ordered=True)[0].noise == 1e-5


def slow_problem(frames=60, noise=0.05, residual=0.05):
    """A point set that turns and bends slowly, with white noise."""
    rng = np.random.default_rng(1)
    time = np.linspace(0, 2 * np.pi, frames)
    rest, bend = rng.standard_normal((2, 3, 12))
    shapes = rest + 0.3 * np.sin(time)[:, None, None] * bend
    turns = np.zeros((frames, 3, 3))
    turns[:, 0, 0] = turns[:, 2, 2] = np.cos(time)
    turns[:, 0, 2], turns[:, 2, 0], turns[:, 1, 1] = np.sin(time), -np.sin(time), 1
    return problem_of(shapes, turns, noise=noise, residual=residual)[0], problem_of(shapes, turns)[0]


def test_noise_is_smoothed_over_time_and_no_more_than_noise():
    noisy, clean = slow_problem()
    smooth, how = without_noise(noisy)
    before, after = np.linalg.norm(noisy.tracks - clean.tracks), np.linalg.norm(smooth.tracks - clean.tracks)
    assert after < 0.5 * before
    assert how["removed"] < noisy.residual
    assert smooth.residual == pytest.approx(noisy.residual * how["left"])
    assert smooth.residual == pytest.approx(after / np.sqrt(clean.tracks.size), rel=0.5)
    unknown, how = without_noise(replace(noisy, residual=0.01))  # more than the noise would go: nothing goes
    assert how is None
    assert unknown.tracks is noisy.tracks


def test_exact_tracks_that_are_thought_noisy_are_found_out():
    _, clean = slow_problem()
    kept, how = without_noise(replace(clean, residual=1e-3, noise=2e-3))
    assert how is None or how["left"] > 0.5
    assert kept.residual < 1e-4
    assert np.abs(kept.tracks - clean.tracks).max() < 1e-4


def test_smooth_motion_is_used_only_in_order():
    noisy, _ = slow_problem()
    names = [
        {x[0] for x in solved(replace(noisy, ordered=o), closed_form=False).chosen["likelihoods"]}
        for o in (True, False)
    ]
    assert names == [{"low rank", "smooth motion"}, {"low rank"}]


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_face_is_found_at_least_as_well_as_by_the_two_algorithms(noise):
    """A built-in sequence with estimated cameras, clean and with 3% noise."""
    data = face_sequence(40, 300, "fast", noise=noise, seed=3)
    errors = {
        method: shape_error(reconstruct(data.tracks, method, **PLAIN), data.shapes, "per-frame")
        for method in ("auto", "grassmann", "geometry-aware", "bmm")
    }
    assert errors.pop("auto") < (0.95 if noise else 0.5) * min(errors.values())


@pytest.mark.parametrize("frames", [3, 4, 6, 10, FEW - 1, FEW])
def test_few_frames_are_no_worse_than_by_low_rank(sequence, frames):
    data = sequence(frames, 90, 2, noise=0.01)
    mine, other = (reconstruct(data.tracks, method, data.rotations, **PLAIN) for method in ("auto", "bmm"))
    errors = [shape_error(result, data.shapes, "per-frame") for result in (mine, other)]
    assert errors[0] < 1.2 * errors[1]


@pytest.mark.parametrize(("frames", "points"), [(3, 4), (3, 50), (21, 4), (8, 2000)])
def test_the_least_frames_and_points_are_enough(sequence, frames, points):
    data = sequence(frames, points, 2, noise=0.01)
    for rotations in (None, data.rotations):
        result = reconstruct(data.tracks, rotations=rotations, **PLAIN)
        assert np.isfinite(result.shapes).all()
        assert np.linalg.norm(result.project() - data.tracks) < 0.1 * np.linalg.norm(
            data.tracks - data.tracks.mean(1)[:, None]
        )


def flat(data):
    return (data.shapes * [1.0, 1.0, 0.0] @ data.rotations.transpose(0, 2, 1))[..., :2]


DEGENERATE = {
    "flat": flat,
    "rigid": lambda data: (data.shapes[:1] @ data.rotations.transpose(0, 2, 1))[..., :2],
    "no camera rotation": lambda data: data.shapes[..., :2],
    "identical frames": lambda data: np.repeat(data.tracks[:1], 24, axis=0),
    "few places": lambda data: data.tracks[:, np.arange(60) % 5],
    "a constant coordinate": lambda data: data.tracks * [0.0, 1.0],
    "a frame in one place": lambda data: np.where(np.arange(24)[:, None, None] == 3, 7.0, data.tracks),
    "the same frames twice": lambda data: data.tracks[np.arange(24) // 2],
    "nothing but noise": lambda data: np.random.default_rng(0).standard_normal((24, 60, 2)),
}


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("kind", DEGENERATE)
def test_degenerate_tracks_give_finite_shapes(sequence, kind, known):
    data = sequence(24, 60, 2)
    tracks = DEGENERATE[kind](data)
    result = reconstruct(tracks, rotations=data.rotations if known else None, **PLAIN)
    assert np.isfinite(result.shapes).all()
    assert np.isfinite(result.rotations).all()
    # Nothing to recover must not become something large.
    assert np.abs(result.shapes).max() < 20 * np.abs(tracks - tracks.mean(axis=1, keepdims=True)).max()


@pytest.mark.parametrize("frames", [12, 20])
def test_copies_of_points_get_the_same_shapes(sequence, frames):
    """Every point five times over, without compression of either: the same answer for each copy."""
    data = sequence(frames, 24, 2, noise=0.02)
    options = PLAIN | EXACT | {"trajectories": False}
    once = reconstruct(data.tracks, rotations=data.rotations, **options)
    often = reconstruct(np.tile(data.tracks, (1, 5, 1)), rotations=data.rotations, **options)
    np.testing.assert_allclose(often.shapes, np.tile(once.shapes, (1, 5, 1)), atol=1e-4 * np.abs(once.shapes).max())


def test_virtual_points_stand_for_the_real_ones():
    """500 real columns, and the same tracks as 40 virtual ones of one cell: the same shapes."""
    rng = np.random.default_rng(1)
    weights = np.concatenate([np.ones((20, 1)), 0.3 * rng.standard_normal((20, 1))], axis=1)
    shapes = np.einsum("fk,kap->fap", weights, rng.standard_normal((2, 3, 500)))
    problem, _ = problem_of(shapes, turned(rng, 20), noise=0.02)
    left, values, right = np.linalg.svd(problem.tracks.reshape(40, 500), full_matrices=False)
    virtual = Problem((left * values).reshape(20, 2, 40), np.array([0, 40]), np.array([500]), problem.rotations, 0.0)
    real, small = solved(problem), solved(virtual)
    assert real.chosen["start"] == small.chosen["start"]
    assert error(small.shapes @ right, real.shapes) < 1e-5


def test_the_same_call_gives_the_same_answer():
    data = face_sequence(24, 200, "fast", noise=0.02, seed=1)
    first, second = (reconstruct(np.array(data.tracks.points), **PLAIN) for _ in range(2))
    np.testing.assert_array_equal(first.shapes, second.shapes)
    np.testing.assert_array_equal(first.rotations, second.rotations)


def test_float32_tracks_give_nearly_the_same(sequence):
    data = sequence(24, 60, 2, noise=0.02)
    wide, narrow = (
        reconstruct(data.tracks.astype(kind), rotations=data.rotations, **PLAIN) for kind in (np.float64, np.float32)
    )
    assert error(narrow.shapes, wide.shapes) < 1e-3


def test_without_its_parts_it_is_the_reweighted_norm(sequence):
    data = sequence(24, 60, 2, noise=0.05)
    parts = {"closed_form": False, "trajectories": False, "follow": False}
    bare = reconstruct(data.tracks, rotations=data.rotations, **PLAIN, **EXACT, **parts)
    norm = reconstruct(data.tracks, "bmm", data.rotations, **PLAIN, **EXACT, reweight=0.01)
    assert error(bare.shapes, norm.shapes) < 1e-6


@pytest.mark.parametrize("part", ["trajectories", "follow"])
def test_every_part_does_something(part):
    data = face_sequence(30, 300, "fast", noise=0.02, seed=2)
    whole, without = (
        reconstruct(data.tracks, rotations=data.rotations, **PLAIN, **{part: use}) for use in (True, False)
    )
    assert error(without.shapes, whole.shapes) > 1e-4


@pytest.mark.parametrize("frames", [10, 30])
def test_given_cameras_stay(frames):
    data = face_sequence(frames, 300, "fast", noise=0.02, seed=2)
    result = reconstruct(data.tracks, rotations=data.rotations, **PLAIN)
    np.testing.assert_allclose(result.rotations, data.rotations, atol=1e-12)


@pytest.mark.parametrize(
    ("frames", "options"), [(21, {}), (10, {}), (21, {"trajectories": False}), (21, {"follow": False})]
)
def test_progress_only_grows(frames, options):
    data = face_sequence(frames, 90, "fast", seed=2)
    problem, _ = problem_of(data.shapes.transpose(0, 2, 1), data.rotations)
    told = []
    solved(problem, told.append, **options)
    assert told
    assert all(0.0 <= share <= 1.0 for share in told)
    assert (np.diff(told) > -0.2).all()  # the share within one fit is an estimate


def test_cells_are_some_and_few():
    counts = [Auto().cells(AutoOptions(), points, 50) for points in (4, 100, 1_000, 10_000, 1_000_000)]
    assert counts[0] >= 1
    assert counts == sorted(counts)
    assert counts[-1] <= 100
