"""Tracks of other array libraries: the same answers as of NumPy arrays, in arrays of the same library."""

import numpy as np
import pytest

import nrsfm
from nrsfm.compression import measure
from nrsfm.devices import is_on_device, to_device, to_host, type_of
from nrsfm.errors import InputError
from nrsfm.streaming.on_device import OnDevice
from nrsfm.streaming.stream import Stream

FRAMES, POINTS = 14, 2_600


def strict(array):
    return pytest.importorskip("array_api_strict").asarray(array)


def bending(points=POINTS, noise=0.5, offset=(320, 240)):
    """A sheet that bends and turns: tracks (F, P, 2) float32 in pixels."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, (2, points))
    tracks = np.empty((FRAMES, points, 2))
    for f in range(FRAMES):
        z = 0.5 * np.cos(1.5 * x) + 0.15 * np.sin(0.5 * f) * x * y + 0.1 * np.cos(0.9 * f) * x**2
        angle = 0.9 * np.sin(0.4 * f)
        tracks[f] = 100 * np.stack([np.cos(angle) * x + np.sin(angle) * z, y], axis=1) + offset
    return (tracks + noise * rng.standard_normal(tracks.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def points():
    return bending()


@pytest.fixture(scope="module")
def expected(points):
    return nrsfm.reconstruct(points, "geometry-aware", memory="2GB")  # in blocks, as devices have it


def test_the_same_as_of_numpy(points, expected, library, monkeypatch):
    monkeypatch.setattr("nrsfm.streaming.on_device._BYTES", 700 * 16 * FRAMES)  # several blocks
    given = library(points)
    result = nrsfm.reconstruct(given, "geometry-aware")
    assert type(result.shapes) is type(given)
    assert type(result.depth_deviation) is type(given)
    assert type_of(result.shapes) == np.float32
    assert isinstance(result.rotations, np.ndarray)
    size = np.abs(expected.shapes).max()
    np.testing.assert_allclose(to_host(result.shapes), expected.shapes, atol=1e-4 * size)
    np.testing.assert_allclose(to_host(result.depth_deviation), expected.depth_deviation, rtol=1e-2)
    np.testing.assert_allclose(result.rotations, expected.rotations, atol=1e-6)
    np.testing.assert_array_equal(result.groups, expected.groups)
    assert result.diagnostics["warnings"] == expected.diagnostics["warnings"]


@pytest.mark.parametrize("method", ["csf2", "auto"])
def test_one_cell_and_the_default(points, library, method):
    result = nrsfm.reconstruct(library(points[:, :1200]), method, precision="float64")
    expected = nrsfm.reconstruct(points[:, :1200], method, precision="float64", memory="2GB")
    assert is_on_device(result.shapes)
    assert type_of(result.shapes) == np.float64
    gap = np.abs(to_host(result.shapes) - expected.shapes).max() / np.abs(expected.shapes).max()
    assert gap < 1e-3


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("offset", [(320, 240), (1e5, -1e5)])
def test_sums_and_cells_are_those_of_the_host(kind, offset):
    points = bending(offset=offset).astype(kind)
    here, there = Stream(points, cells=7), OnDevice(strict(points), cells=7)
    one, other = here.measure(3), there.measure(3)
    np.testing.assert_allclose(other.gram, one.gram, atol=1e-6 * np.trace(one.gram))
    np.testing.assert_allclose(other.translations, measure(points).translations, rtol=1e-9)
    first, second = (s.compress(m, noise=0.0, tolerance=0.0) for s, m in ((here, one), (there, other)))
    np.testing.assert_array_equal(first.labels, second.labels)
    np.testing.assert_array_equal(first.sizes, second.sizes)


def test_gradients_are_not_followed(points):
    library = pytest.importorskip("torch")
    result = nrsfm.reconstruct(library.asarray(np.array(points)).requires_grad_(), "bmm")
    assert not result.shapes.requires_grad


def test_few_points_are_worked_on_by_the_host_and_come_back():
    points = bending(300, noise=0.0)
    result = nrsfm.reconstruct(strict(points), "bmm")
    assert is_on_device(result.shapes)
    np.testing.assert_array_equal(to_host(result.shapes), nrsfm.reconstruct(points, "bmm").shapes)
    assert any(text.startswith("device: 300 points of 14 frames are few") for text in result.diagnostics["warnings"])


def test_what_can_be_done_with_the_result(points, tmp_path):
    result = nrsfm.reconstruct(strict(points), "bmm")
    host = result.on_host()
    assert isinstance(host.shapes, np.ndarray)
    assert host.on_host() is host
    for name in ("project", "camera_shapes", "camera_depths"):
        np.testing.assert_array_equal(getattr(result, name)(), getattr(host, name)())
    np.testing.assert_array_equal(to_host(result.mirrored().shapes), host.mirrored().shapes)
    np.testing.assert_array_equal(result.reconstructed, host.reconstructed)
    errors = result.reprojection_errors(nrsfm.Tracks(strict(points)))
    np.testing.assert_array_equal(errors, host.reprojection_errors(nrsfm.Tracks(points)))
    assert nrsfm.shape_error(result, host.shapes) == pytest.approx(0.0, abs=1e-6)
    result.save(tmp_path / "r.npz")
    np.testing.assert_array_equal(nrsfm.load_reconstruction(tmp_path / "r.npz").shapes, host.shapes)


def test_what_is_refused(points, monkeypatch):
    wrong = points.copy()
    wrong[3, 5, 1] = np.nan
    with pytest.raises(InputError, match="the first at frame 3, point 5"):
        nrsfm.reconstruct(strict(wrong), "bmm")
    with pytest.raises(InputError, match="float32 or float64 is needed on a device, received int64"):
        nrsfm.reconstruct(strict(points.astype(np.int64)), "bmm")
    with pytest.raises(InputError, match=r"shape \(frames, points, 2\) is needed"):
        nrsfm.reconstruct(strict(points[..., 0]), "bmm")
    with pytest.raises(InputError, match="visible: tracks on a device must be complete"):
        nrsfm.Tracks(strict(points), np.ones(points.shape[:2], dtype=bool))
    for option in ({"memory": "1GB"}, {"shapes_file": "s.npy"}, {"cluster": "tcp://nowhere:1"}):
        with pytest.raises(InputError, match="tracks on a device are worked on there"):
            nrsfm.reconstruct(strict(points), "bmm", **option)
    monkeypatch.setitem(__import__("sys").modules, "array_api_compat", None)
    with pytest.raises(InputError, match=r"pip install 'nrsfm\[gpu\]'"):
        nrsfm.reconstruct(strict(points), "bmm")


def test_transfers_keep_the_numbers():
    array = np.arange(6.0, dtype=np.float32).reshape(2, 3)
    there = to_device(array.T, strict(array))
    assert is_on_device(there)
    assert not is_on_device(array)
    assert not is_on_device([1.0])
    np.testing.assert_array_equal(to_host(there), array.T)
