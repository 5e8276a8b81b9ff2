"""Measuring, compressing and expanding: exact, in chunks, for any memory layout, within the tolerance."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import nrsfm.compression as compression
from nrsfm.compression import compress, estimate_noise, measure, spectrum, track_coordinates
from nrsfm.errors import InputError


def direct_matrix(points):
    """W (2F, P) centred by rows, by the plain definition, in extended precision where there is one."""
    matrix = points.astype(np.longdouble).transpose(0, 2, 1).reshape(2 * len(points), -1)
    return (matrix - matrix.mean(axis=1, keepdims=True)).astype(np.float64)


def random_points(seed, frames=5, points=60, offset=0.0, rank=None):
    rng = np.random.default_rng(seed)
    rank = min(2 * frames, points) if rank is None else rank
    flat = rng.standard_normal((2 * frames, rank)) @ rng.standard_normal((rank, points))
    return flat.reshape(frames, 2, points).transpose(0, 2, 1) + offset


def random_labels(seed, points, cells):
    rng = np.random.default_rng(seed)
    labels = rng.integers(cells, size=points)
    labels[:cells] = np.arange(cells)
    return labels


def expanded(points, labels, **how):
    """W from its compressed form: the first two rows of 'shapes' are the virtual tracks themselves."""
    compressed = compress(measure(points), labels, **how)
    flat = np.concatenate([compressed.factors, np.zeros_like(compressed.factors[:, :1])], axis=1)
    return compressed, compressed.expand(flat, np.dtype(np.float64))[:, :, :2]


@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 30), st.just(2)), elements=st.floats(-99, 99)),
    st.sampled_from([0.0, 1e4, -3e5]),
)
def test_measure_is_the_definition(points, offset):
    points = points + offset
    matrix = direct_matrix(points)
    scale = np.abs(matrix).max()
    assume(scale > 1e-6)
    measured = measure(points)
    np.testing.assert_allclose(measured.translations, points.mean(axis=1), rtol=1e-12, atol=1e-9)
    rounding = 1e-10 * max(abs(offset), 1.0)  # of the input itself
    np.testing.assert_allclose(
        measured.gram * measured.unit**2, matrix @ matrix.T, rtol=0, atol=matrix.size * (rounding * scale + rounding**2)
    )
    if scale > 1e-3:
        np.testing.assert_allclose(measured.unit, np.sqrt(np.mean(matrix**2)), rtol=1e-5)


@pytest.mark.parametrize("factor", [0.0, 1e-300, 1e-160, 1e-40, 1e40, 1e160, 1e300])
def test_spreads_beyond_floating_point_are_refused(factor):
    with pytest.raises(InputError, match="tracks: points must spread about their mean by 1e-35 to 1e"):
        measure(factor * random_points(0))


@pytest.mark.parametrize("factor", [1e-30, 1e30])
def test_spreads_far_from_one_are_measured(factor):
    points = random_points(0)
    np.testing.assert_allclose(measure(factor * points).gram, measure(points).gram, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_far_away_tracks_lose_nothing(offset):
    """Ten thousand pixels from the origin, the Gram matrix of an object of one pixel is as good as at the origin."""
    points = np.round(random_points(0, 6, 400) * 2**20) / 2**20  # so that adding the offset is exact
    near, far = measure(points), measure(points + offset)
    np.testing.assert_allclose(far.gram, near.gram, rtol=0, atol=1e-11 * np.abs(near.gram).max())
    np.testing.assert_allclose(far.translations, near.translations + offset, rtol=1e-14)


def test_many_points_are_measured_about_their_mean_not_that_of_the_sample():
    """With more points than the provisional offset looks at."""
    points = random_points(1, 3, 5000) + np.where(np.arange(5000) % 19 == 0, 0.0, 50.0)[:, None]
    matrix = direct_matrix(points)
    measured = measure(points)
    np.testing.assert_allclose(measured.gram * measured.unit**2, matrix @ matrix.T, rtol=1e-10, atol=1e-6)
    np.testing.assert_allclose(measured.translations, points.mean(axis=1), rtol=1e-12)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 7),
    st.integers(2, 50),
    st.integers(1, 6),
    st.sampled_from([None, 1, 2, 3]),
)
def test_expansion_of_the_virtual_tracks_is_w(seed, frames, count, cells, rank):
    points = random_points(seed, frames, count, 300.0, rank)
    labels = random_labels(seed, count, min(cells, count))
    compressed, back = expanded(points, labels)
    centred = points - points.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(back, centred, rtol=0, atol=2e-6 * np.abs(centred).max())
    sizes = np.bincount(labels)
    np.testing.assert_array_equal(compressed.sizes, sizes)
    for k, rank_k in enumerate(np.diff(compressed.offsets)):
        assert 1 <= rank_k <= min(2 * frames, sizes[k])
    assert compressed.discarded <= 1e-10


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(3, 40))
def test_the_way_back_is_an_isometry(seed, frames, count):
    """Qᵀ has orthonormal rows, so Gram matrices over virtual and real points agree."""
    points = random_points(seed, frames, count)
    labels = random_labels(seed, count, 2)
    measured = measure(points)
    compressed = compress(measured, labels)
    for k, back in enumerate(compressed.maps):
        rows = back @ measured.columns(np.flatnonzero(labels == k))
        np.testing.assert_allclose(rows @ rows.T, np.eye(len(rows)), atol=1e-6)


LAYOUTS = {
    "float32": lambda a, _: a.astype(np.float32),
    "fortran": lambda a, _: np.asfortranarray(a),
    "point-first": lambda a, _: np.ascontiguousarray(a.transpose(1, 0, 2)).transpose(1, 0, 2),
    "strided": lambda a, _: np.repeat(a, 2, axis=1)[:, ::2],
    "reversed": lambda a, _: a[:, ::-1].copy()[:, ::-1],
}


def as_memmap(array, folder):
    np.save(folder / "points.npy", array)
    return np.load(folder / "points.npy", mmap_mode="r")


LAYOUTS["memory map"] = as_memmap


@pytest.mark.parametrize("layout", LAYOUTS)
def test_memory_layout_does_not_matter(layout, tmp_path):
    points = random_points(4, 5, 70, 500.0).astype(np.float32).astype(np.float64)
    other = LAYOUTS[layout](points, tmp_path)
    other.flags.writeable = False
    labels = random_labels(4, 70, 3)
    reference, result = measure(points), measure(other)
    np.testing.assert_allclose(result.gram, reference.gram, rtol=1e-12, atol=1e-9)
    _, a = expanded(points, labels)
    _, b = expanded(other, labels)
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-7 * np.abs(a).max())
    assert np.shares_memory(result.points, other)


@pytest.mark.parametrize("step", [1, 3, 7, 69, 70, 71])
def test_chunk_borders_do_not_matter(step, monkeypatch):
    points = random_points(5, 4, 70, 100.0)
    labels = random_labels(5, 70, 3)
    reference, whole = measure(points), expanded(points, labels)[1]
    coordinates = track_coordinates(reference, spectrum(reference)[1][:, :3])
    monkeypatch.setattr(compression, "_CHUNK_BYTES", 16 * len(points) * step)
    assert max(c.stop - c.start for c in reference.chunks()) == min(step, 70)
    cut = measure(points)
    np.testing.assert_allclose(cut.gram, reference.gram, rtol=0, atol=1e-12 * np.abs(reference.gram).max())
    np.testing.assert_allclose(expanded(points, labels)[1], whole, rtol=0, atol=1e-9 * np.abs(whole).max())
    again = track_coordinates(cut, spectrum(reference)[1][:, :3])
    np.testing.assert_allclose(again, coordinates, rtol=1e-5, atol=1e-6)


def test_no_copy_of_the_input_is_held(monkeypatch):
    """Beside the answer, the passes need a few chunks of work space, however many points there are."""
    monkeypatch.setattr(compression, "_CHUNK_BYTES", 2**18)
    points = random_points(6, 10, 60_000).astype(np.float32)
    labels = np.arange(60_000) % 20
    tracemalloc.start()
    try:
        measured = measure(points)
        first = tracemalloc.get_traced_memory()[1]
        compressed = compress(measured, labels)
        second = tracemalloc.get_traced_memory()[1]
        answer = compressed.expand(np.concatenate([compressed.factors] * 2, axis=1)[:, :3], np.dtype(np.float32))
        third = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert first < 0.5 * points.nbytes
    assert second < 0.6 * points.nbytes
    assert third < answer.nbytes + 0.6 * points.nbytes


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 0.5), st.integers(1, 4))
def test_tolerance_bounds_what_is_cut(seed, tolerance, cells):
    rng = np.random.default_rng(seed)
    decay = 10.0 ** -np.arange(8.0)
    flat = rng.standard_normal((12, 8)) * decay @ rng.standard_normal((8, 90))
    points = 40 * flat.reshape(6, 2, 90).transpose(0, 2, 1) + 100
    labels = random_labels(seed, 90, cells)
    compressed, back = expanded(points, labels, tolerance=tolerance)
    centred = points - points.mean(axis=1, keepdims=True)
    unit = np.sqrt(np.mean(centred**2))
    lost = np.sum((back - centred) ** 2)
    np.testing.assert_allclose(compressed.discarded, lost / np.sum(centred**2), rtol=1e-3, atol=1e-9)
    for k in range(cells):
        members = labels == k
        cut = np.sqrt(np.mean((back - centred)[:, members] ** 2)) / unit
        # One direction always stays, so a cell smaller than the tolerance is not emptied.
        assert cut <= tolerance * (1 + 1e-6)


def test_tolerance_cuts_as_much_as_it_may():
    rng = np.random.default_rng(0)
    flat = rng.standard_normal((12, 8)) * 10.0 ** -np.arange(8.0) @ rng.standard_normal((8, 90))
    points = flat.reshape(6, 2, 90).transpose(0, 2, 1)
    labels = np.zeros(90, dtype=int)
    ranks = [compress(measure(points), labels, tolerance=t).offsets[-1] for t in (0, 1e-5, 1e-3, 0.05)]
    assert ranks == sorted(ranks, reverse=True)
    assert len(set(ranks)) == 4


def test_noise_shrinks_towards_the_clean_tracks():
    rng = np.random.default_rng(2)
    clean = random_points(2, 10, 400, rank=3)
    clean -= clean.mean(axis=1, keepdims=True)
    noise = 0.2
    noisy = clean + noise * rng.standard_normal(clean.shape)
    unit = measure(noisy).unit
    compressed, back = expanded(noisy, np.zeros(400, dtype=int), noise=noise / unit)
    assert compressed.offsets[-1] == 3
    assert np.linalg.norm(back - clean) < 0.5 * np.linalg.norm(noisy - clean)


def test_a_constant_cell_stays_in_the_answer():
    points = random_points(3, 4, 20)
    points[:, 10:] = points[:, :10].mean(axis=1, keepdims=True)  # a cell without any extent, at the centre
    compressed, back = expanded(points, (np.arange(20) >= 10).astype(int))
    assert np.isfinite(back).all()
    assert len(compressed.sizes) == 2
    np.testing.assert_allclose(back[:, 10:], 0, atol=1e-6)


def surface(frames, side, noise, rng):
    """Tracks of a smoothly bending sheet."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    points = []
    for f in range(frames):
        z = 0.4 * np.sin(2 * x + 0.3 * f) * np.cos(y - 0.2 * f)
        turn = 0.05 * f
        points.append(np.stack([np.cos(turn) * x + np.sin(turn) * z, y], axis=-1).reshape(-1, 2))
    return 100 * (np.array(points) + noise * rng.standard_normal((frames, side * side, 2)))


@pytest.mark.parametrize(("frames", "side"), [(10, 60), (40, 60), (60, 10)])
@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_noise_of_a_bending_sheet(frames, side, noise):
    rng = np.random.default_rng(0)
    measured = measure(surface(frames, side, noise, rng))
    values, vectors = spectrum(measured)
    coordinates = track_coordinates(measured, vectors[:, :10])
    estimate = estimate_noise(measured, values, coordinates, rng) * measured.unit / 100
    assert 0.95 * noise < estimate < 1.10 * noise


def test_noise_of_a_clean_sheet_is_small():
    rng = np.random.default_rng(0)
    measured = measure(surface(40, 60, 0.0, rng))
    values, vectors = spectrum(measured)
    assert estimate_noise(measured, values, track_coordinates(measured, vectors[:, :10]), rng) < 1e-3
