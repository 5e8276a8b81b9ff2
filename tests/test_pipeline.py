"""``reconstruct`` from end to end: determinism, reprojection, degenerate and bad input, generated input of both."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nrsfm
from nrsfm.affine import Stages
from nrsfm.compression import measure
from nrsfm.errors import InputError, NrsfmError, OptionError
from nrsfm.metrics import shape_error

METHODS = ["bmm", "grassmann", "geometry-aware"]
QUICK = {"max_iterations": 60}


def turning_cameras(frames, step=0.3):
    a, b = step * np.arange(frames), 0.5 * np.sin(0.7 * np.arange(frames))
    zero, one = np.zeros(frames), np.ones(frames)
    yaw = np.stack([np.cos(a), zero, np.sin(a), zero, one, zero, -np.sin(a), zero, np.cos(a)], axis=1)
    pitch = np.stack([one, zero, zero, zero, np.cos(b), -np.sin(b), zero, np.sin(b), np.cos(b)], axis=1)
    return pitch.reshape(-1, 3, 3) @ yaw.reshape(-1, 3, 3)


def with_value(tracks, value):
    spoiled = tracks.copy()
    spoiled[2, 5] = value
    return spoiled


def bending(frames=12, points=40, noise=0.0, seed=0):
    """Tracks, shapes and cameras of a cloud with one smooth bending mode."""
    rng = np.random.default_rng(seed)
    bases = rng.standard_normal((2, points, 3))
    weights = np.stack([np.ones(frames), 0.4 * np.cos(0.6 * np.arange(frames))], axis=1)
    shapes = 100 * np.einsum("fk,kpi->fpi", weights, bases)
    shapes -= shapes.mean(axis=1, keepdims=True)
    rotations = turning_cameras(frames)
    tracks = (shapes @ rotations.transpose(0, 2, 1))[:, :, :2] + np.array([320.0, 240.0])
    return tracks + 100 * noise * rng.standard_normal(tracks.shape), shapes, rotations


def reprojected(result):
    shapes = result.shapes.astype(np.float64)
    seen = np.einsum("fij,fpj->fpi", result.rotations[:, :2], shapes)
    return result.scales[:, None, None] * seen + result.translations[:, None]


def distance(result, points):
    """Relative root mean square of the reprojection residual."""
    points = np.asarray(points, dtype=np.float64)
    return np.linalg.norm(reprojected(result) - points) / np.linalg.norm(points - points.mean(axis=1, keepdims=True))


def assert_sound(result, points):
    frames, count = points.shape[:2]
    assert result.shapes.shape == (frames, count, 3)
    assert result.rotations.shape == (frames, 3, 3)
    assert result.translations.shape == (frames, 2)
    assert result.scales.shape == (frames,)
    for array in (result.shapes, result.rotations, result.translations, result.scales):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(
        result.rotations @ result.rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (frames, 3, 3)), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(result.rotations), 1, atol=1e-9)
    assert np.all(result.scales > 0)
    if result.groups is not None:
        assert result.groups.shape == (count,)
        np.testing.assert_array_equal(np.unique(result.groups), np.arange(result.groups.max() + 1))
    json.dumps(result.diagnostics, allow_nan=False)
    json.dumps(result.options, allow_nan=False)
    assert result.diagnostics["stop_reason"] != "not finite"
    assert np.isfinite(distance(result, points))


@pytest.mark.parametrize("method", METHODS)
def test_clean_tracks_are_reprojected_and_recovered(method):
    tracks, shapes, rotations = bending(20, 60)
    result = nrsfm.reconstruct(tracks, method, reweight=0.01)
    assert_sound(result, tracks)
    assert distance(result, tracks) < 1e-3
    assert shape_error(result, shapes, "per-frame") < 0.02
    known = nrsfm.reconstruct(tracks, method, rotations, reweight=0.01)
    assert distance(known, tracks) < 1e-3
    assert shape_error(known, shapes, "none") < 0.01


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", [0, 7])
def test_same_input_and_seed_same_output(method, seed):
    tracks, *_ = bending(noise=0.05, points=150)
    first, second = (nrsfm.reconstruct(tracks, method, seed=seed, **QUICK) for _ in range(2))
    for name in ("shapes", "rotations", "translations", "scales"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    if first.groups is not None:
        np.testing.assert_array_equal(first.groups, second.groups)
    assert first.options == second.options
    assert first.diagnostics["history"] == second.diagnostics["history"]


@pytest.mark.parametrize("kind", ["float32", "fortran", "read-only", "memory map", "Tracks", "point-first"])
def test_any_array_is_taken(kind, tmp_path):
    tracks, *_ = bending(noise=0.02)
    tracks = tracks.astype(np.float32).astype(np.float64)
    np.save(tmp_path / "tracks.npy", tracks)
    given_tracks = {
        "float32": lambda: tracks.astype(np.float32),
        "fortran": lambda: np.asfortranarray(tracks),
        "read-only": lambda: np.broadcast_to(tracks, tracks.shape),
        "memory map": lambda: np.load(tmp_path / "tracks.npy", mmap_mode="r"),
        "Tracks": lambda: nrsfm.Tracks(tracks, np.ones(tracks.shape[:2], dtype=bool)),
        "point-first": lambda: np.ascontiguousarray(tracks.transpose(1, 0, 2)).transpose(1, 0, 2),
    }[kind]()
    expected, result = (nrsfm.reconstruct(t, "bmm", **QUICK) for t in (tracks, given_tracks))
    np.testing.assert_allclose(result.shapes, expected.shapes, atol=1e-3 * np.abs(expected.shapes).max())


@pytest.mark.parametrize("method", METHODS)
def test_compressed_is_as_good_as_not_compressed(method):
    """Through ``reconstruct``: one cell per point is no compression at all, and one cell is the most there is."""
    tracks, _, rotations = bending(8, 40, noise=0.05)
    options = {"tolerance": 0.0, "denoise": False, "noise_level": 0.0, "precision": "float64"}
    cells = ({}, {}) if method == "bmm" else ({"spatial_cells": 1}, {"spatial_cells": 40})
    few, many = (nrsfm.reconstruct(tracks, method, rotations, **options, **c) for c in cells)
    if method != "bmm":
        assert many.diagnostics["compression"]["virtual_points"] == 40
        assert few.diagnostics["compression"]["virtual_points"] <= 16
    np.testing.assert_allclose(few.shapes, many.shapes, rtol=0, atol=1e-6 * np.abs(many.shapes).max())


@pytest.mark.parametrize("method", METHODS)
def test_denser_tracks_give_the_same_shapes(method):
    """Every point ten times over: the same answer for each copy, by the same defaults."""
    tracks, _, rotations = bending(8, 40, noise=0.05)
    options = {"noise_level": 0.0, "tolerance": 0.0, "precision": "float64"}
    once = nrsfm.reconstruct(tracks, method, rotations, **options)
    often = nrsfm.reconstruct(np.tile(tracks, (1, 10, 1)), method, rotations, **options)
    np.testing.assert_allclose(
        often.shapes, np.tile(once.shapes, (1, 10, 1)), rtol=0, atol=1e-6 * np.abs(once.shapes).max()
    )


@pytest.mark.parametrize("method", METHODS)
def test_scales_of_the_frames_are_part_of_the_reprojection(method):
    tracks, *_ = bending(20, 60)
    sizes = 1 + 0.3 * np.sin(0.5 * np.arange(20))
    tracks = tracks * sizes[:, None, None]
    result = nrsfm.reconstruct(tracks, method, scales="free", reweight=0.01)
    assert_sound(result, tracks)
    assert np.std(result.scales) > 0.05
    assert distance(result, tracks) < 1e-3


def test_known_cameras_of_both_forms():
    tracks, _, rotations = bending()
    full, rows = (nrsfm.reconstruct(tracks, "bmm", r) for r in (rotations, rotations[:, :2]))
    np.testing.assert_array_equal(full.shapes, rows.shapes)
    np.testing.assert_allclose(full.rotations, rotations, atol=1e-12)
    assert full.diagnostics["cameras"] == {"known": True}


BAD_CAMERAS = {
    "mirror": lambda r: r * np.array([1.0, 1.0, -1.0])[:, None],
    "scaled": lambda r: 1.1 * r,
    "short": lambda r: r[:-1],
    "flat": lambda r: r[0],
    "NaN": lambda r: np.where(np.arange(len(r))[:, None, None] == 2, np.nan, r),
    "complex": lambda r: r.astype(complex),
    "ragged": lambda r: [r[0], r[1][:2]],
    "text": lambda r: "identity",
}


@pytest.mark.parametrize("kind", BAD_CAMERAS)
def test_bad_cameras_are_refused(kind):
    tracks, _, rotations = bending()
    with pytest.raises(InputError, match="rotations"):
        nrsfm.reconstruct(tracks, "bmm", BAD_CAMERAS[kind](rotations))


def flat(rotations):
    cloud = 100 * np.random.default_rng(0).standard_normal((30, 3)) * np.array([1.0, 1.0, 0.0])
    return (cloud @ rotations.transpose(0, 2, 1))[:, :, :2]


TRACKS, SHAPES, ROTATIONS = bending()
DEGENERATE = {
    "identical frames": (np.repeat(TRACKS[:1], 6, axis=0), True),
    "planar rigid shape": (flat(ROTATIONS), True),
    "no camera rotation": (SHAPES[:, :, :2], True),
    "sideways motion only": (np.stack([TRACKS[0] + 5.0 * f for f in range(6)]), True),
    "one point moves": (np.where(np.arange(60).reshape(5, 6, 2) == 13, 1.0, 0.0), True),
    "duplicate points": (np.repeat(TRACKS[:, :5], 6, axis=1), False),
    "constant x": (TRACKS * np.array([0.0, 1.0]), False),
    "one frame without extent": (np.where(np.arange(12)[:, None, None] == 3, 7.0, TRACKS), False),
    "three frames": (TRACKS[:3], False),
    "four points": (TRACKS[:, :4], False),
    "three frames of four points": (TRACKS[:3, :4], False),
    "whole numbers": (np.round(TRACKS).astype(np.int64), False),
    "far away": (TRACKS + 1e9, False),
    "tiny": (TRACKS * 1e-30, False),
    "huge": (TRACKS * 1e30, False),
    "nothing but noise": (np.random.default_rng(0).standard_normal((6, 30, 2)), False),
}


@pytest.mark.parametrize("method", ["auto", *METHODS])
@pytest.mark.parametrize("kind", DEGENERATE)
def test_degenerate_input_finishes_finite(kind, method):
    tracks, undetermined = DEGENERATE[kind]
    result = nrsfm.reconstruct(tracks, method)
    assert_sound(result, tracks)
    if undetermined:
        assert any(word in " ".join(result.diagnostics["warnings"]) for word in ("determined", "depth"))


@pytest.mark.parametrize("kind", DEGENERATE)
def test_degenerate_input_with_known_cameras(kind):
    tracks, _ = DEGENERATE[kind]
    result = nrsfm.reconstruct(tracks, "geometry-aware", turning_cameras(len(tracks)), **QUICK)
    assert_sound(result, tracks)


def test_more_basis_shapes_than_the_data_allow():
    result = nrsfm.reconstruct(TRACKS, "bmm", camera_rank=20)
    assert_sound(result, TRACKS)
    assert any("20" in text for text in result.diagnostics["warnings"])


@pytest.mark.parametrize("cells", [1, 39, 40, 5000])
@pytest.mark.parametrize("method", METHODS[1:])
def test_more_cells_than_points(method, cells):
    result = nrsfm.reconstruct(TRACKS, method, ROTATIONS, spatial_cells=cells, **QUICK)
    assert_sound(result, TRACKS)
    assert result.diagnostics["compression"]["cells"] <= 40


BAD = {
    "two dimensions": (np.zeros((6, 8)), "shape"),
    "three coordinates": (np.zeros((6, 8, 3)), "shape"),
    "empty": (np.zeros((0, 8, 2)), "at least one"),
    "two frames": (TRACKS[:2], "at least 3 frames are needed, received 2"),
    "three points": (TRACKS[:, :3], "at least 4 points are needed, received 3"),
    "all equal": (np.full((6, 8, 2), 3.0), "all equal"),
    "equal in each frame": (np.repeat(TRACKS[:, :1], 8, axis=1), "all equal"),
    "NaN": (with_value(TRACKS, np.nan), "frame 2, point 5"),
    "infinite": (with_value(TRACKS, np.inf), "frame 2, point 5"),
    "complex": (TRACKS.astype(complex), "complex128"),
    "objects": (TRACKS.astype(object), "object"),
    "booleans": (TRACKS > 0, "bool"),
    "text": ("face.npz", "dtype"),
    "None": (None, "object"),
    "beyond floating point": (TRACKS * 1e200, "spread"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_tracks_are_refused_in_one_line(kind):
    tracks, text = BAD[kind]
    with pytest.raises(InputError, match=text) as caught:
        nrsfm.reconstruct(tracks)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"method": "geometry-awere"}, "did you mean 'geometry-aware'"),
        ({"spatial_cell": 3}, "'spatial_cell' is not an option.*did you mean 'spatial_cells'"),
        ({"method": "bmm", "spatial_cells": 3}, "'spatial_cells' is not an option of method 'bmm'"),
        ({"gamma": 0}, "'gamma' must be greater than 0"),
        ({"gamma": float("inf")}, "'gamma' must be a finite number"),
        ({"tau": 1.5}, "'tau' must be at most 1"),
        ({"growth": 1.0}, "'growth' must be greater than 1"),
        ({"spatial_cells": 2.5}, "whole number"),
        ({"precision": "float16"}, "one of float32, float64"),
        ({"noise_level": -1.0}, "'noise_level' must be at least 0"),
        ({"denoise": "no"}, "true or false"),
        ({"camera_method": "rigit"}, "did you mean 'rigid'"),
    ],
)
def test_bad_options_are_refused_with_the_nearest_name(options, text):
    with pytest.raises(OptionError, match=text):
        nrsfm.reconstruct(TRACKS, **({"method": "geometry-aware"} | options))


@pytest.mark.parametrize("options", [{"camera_path": "orbit"}, {"camera_method": "smoothest"}])
def test_cameras_that_use_the_order_of_frames_are_refused_without_one(options):
    with pytest.raises(InputError, match="needs frames that follow one another in time"):
        nrsfm.reconstruct(TRACKS, ordered=False, **options)


def test_a_method_gets_what_it_declares_to_need(monkeypatch):
    """Every real point, in order; a refusal of what is too little; cameras that it moved are returned."""
    from nrsfm.methods import bmm
    from nrsfm.methods.base import Needs

    seen = {}

    def solve(self, problem, options, rng, monitor):
        seen["problem"] = problem
        solution = solve_before(self, problem, options, rng, monitor)
        solution.rotations, solution.scales = problem.rotations[:, ::-1], np.full(len(TRACKS), 2.0)
        return solution

    solve_before = bmm.Bmm.solve
    monkeypatch.setattr(bmm.Bmm, "solve", solve)
    monkeypatch.setattr(bmm.Bmm, "needs", Needs(every_point=True, least_frames=6, least_points=9))
    result = nrsfm.reconstruct(TRACKS, "bmm", ROTATIONS, precision="float64")
    problem = seen["problem"]
    assert problem.cameras_known
    centred = TRACKS - TRACKS.mean(axis=1, keepdims=True)
    ratio = centred.transpose(0, 2, 1) / problem.tracks
    np.testing.assert_allclose(ratio, ratio[0, 0, 0])
    np.testing.assert_allclose(result.rotations[:, 0], ROTATIONS[:, 1])
    np.testing.assert_allclose(result.scales, 2.0)
    with pytest.raises(InputError, match="method 'bmm' needs at least 6 frames, received 5"):
        nrsfm.reconstruct(TRACKS[:5], "bmm")
    with pytest.raises(InputError, match="method 'bmm' needs at least 9 points, received 8"):
        nrsfm.reconstruct(TRACKS[:, :8], "bmm")


@pytest.mark.parametrize("seed", [-1, 1.5, "0", None, True])
def test_bad_seeds_are_refused(seed):
    with pytest.raises(InputError, match="seed"):
        nrsfm.reconstruct(TRACKS, seed=seed)


def test_options_are_recorded_and_precision_is_kept():
    result = nrsfm.reconstruct(TRACKS, "grassmann", ROTATIONS, seed=3, precision="float64", temporal=False, gamma=0.02)
    assert result.shapes.dtype == np.float64
    assert result.method == "grassmann"
    assert {"seed": 3, "temporal": False, "gamma": 0.02}.items() <= result.options.items()
    again = {k: v for k, v in result.options.items() if k != "seed"}
    np.testing.assert_array_equal(
        nrsfm.reconstruct(TRACKS, "grassmann", ROTATIONS, seed=3, **again).shapes, result.shapes
    )
    assert nrsfm.reconstruct(TRACKS, "bmm", ROTATIONS, **QUICK).shapes.dtype == np.float32


def test_mirror_gives_the_other_solution():
    """R → D R D and S → S D with D = diag(1, 1, −1): another shape, the same tracks."""
    tracks, *_ = bending()
    one = nrsfm.reconstruct(tracks, "bmm", precision="float64", **QUICK)
    other = nrsfm.reconstruct(tracks, "bmm", precision="float64", mirror=True, **QUICK)
    flip = np.array([1.0, 1.0, -1.0])
    size = np.abs(one.shapes).max()
    np.testing.assert_allclose(other.shapes, one.shapes * flip, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(other.rotations, one.rotations * flip[:, None] * flip, atol=1e-9)
    np.testing.assert_allclose(other.project(), one.project(), rtol=0, atol=1e-9 * np.abs(one.project()).max())
    reports = [r.diagnostics["cameras"]["mirror"] for r in (one, other)]
    assert reports[0]["flip"] != reports[1]["flip"]


def test_a_stage_that_goes_on_after_one_inside_it_is_told_again():
    told: list[tuple[str, float | None]] = []
    stages = Stages(lambda stage, share: told.append((stage, share)))
    with stages("outer"), stages("inner") as advance:
        advance(0.5)
    assert told == [("outer", None), ("inner", None), ("inner", 0.5), ("outer", None)]


def test_progress_is_told_the_stages_in_order():
    told = []
    nrsfm.reconstruct(TRACKS, "bmm", progress=lambda stage, share: told.append((stage, share)))
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages == [
        *("repair", "reading tracks", "cameras", "compression", "bmm", "object frame", "mirror", "expansion"),
        *("deviation", "perspective"),
    ]
    assert all(share is None or 0 <= share <= 1 for _, share in told)


@pytest.mark.parametrize("method", METHODS)
def test_the_input_is_not_changed(method):
    tracks, _, rotations = bending(noise=0.02)
    before = tracks.copy(), rotations.copy()
    nrsfm.reconstruct(tracks, method, rotations, **QUICK)
    np.testing.assert_array_equal(tracks, before[0])
    np.testing.assert_array_equal(rotations, before[1])
    assert tracks.flags.writeable


def test_noise_given_is_noise_used():
    tracks, _, rotations = bending(noise=0.05, points=200)
    result = nrsfm.reconstruct(tracks, "bmm", rotations, noise_level=4.0, **QUICK)
    assert result.diagnostics["noise"] == pytest.approx(4.0)
    estimated = nrsfm.reconstruct(tracks, "bmm", rotations, **QUICK).diagnostics["noise"]
    assert estimated == pytest.approx(5.0, rel=0.15)


def test_compression_report_adds_up():
    tracks, _, rotations = bending(points=300, noise=0.05)
    report = nrsfm.reconstruct(tracks, METHODS[1], rotations, spatial_cells=5, **QUICK).diagnostics["compression"]
    assert report["points"] == sum(report["sizes"]) == 300
    assert report["virtual_points"] == sum(report["ranks"])
    assert report["cells"] == len(report["ranks"]) == len(report["sizes"]) == 5
    assert 0 <= report["discarded"] < 0.1


@st.composite
def legal_tracks(draw):
    """Small tracks of every awkward kind that is still legal."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames, count = draw(st.integers(3, 8)), draw(st.integers(4, 20))
    rank = draw(st.integers(1, 2 * frames))
    flat_tracks = rng.standard_normal((2 * frames, rank)) @ rng.standard_normal((rank, count))
    points = flat_tracks.reshape(frames, 2, count).transpose(0, 2, 1)
    if draw(st.booleans()):
        points = np.round(points, draw(st.integers(0, 2)))
    if draw(st.booleans()):
        points[:, rng.integers(count)] = points[:, rng.integers(count)]
    if draw(st.booleans()):
        points[rng.integers(frames)] = points[rng.integers(frames)]
    if draw(st.integers(0, 9)) == 0:
        points[..., rng.integers(2)] = 1.0
    if draw(st.integers(0, 9)) == 0:
        points[rng.integers(frames)] = 0.0
    points = points * 10.0 ** draw(st.sampled_from([-12, 0, 0, 2, 9])) + draw(st.sampled_from([0.0, 0.0, 300.0]))
    return points.astype(draw(st.sampled_from([np.float32, np.float64])))


def options_of(method):
    """Any options, in and out of the sensible range."""
    common = {
        "gamma": st.sampled_from([None, 1e-6, 0.01, 1.0, 100.0]),
        "reweight": st.sampled_from([0.0, 1e-4, 0.01, 5.0]),
        "noise_level": st.sampled_from([None, 0.0, 0.1, 1e3]),
        "denoise": st.booleans(),
        "tolerance": st.sampled_from([0.0, 1e-4, 0.1]),
        "camera_rank": st.sampled_from([None, 1, 2, 50]),
        "camera_method": st.sampled_from(["intersection", "rigid"]),
        "mirror": st.booleans(),
    }
    spatial = {
        "spatial": st.booleans(),
        "spatial_cells": st.sampled_from([None, 1, 3, 7, 500]),
        "spatial_dimension": st.sampled_from([None, 1, 4, 90]),
        "grouping": st.booleans(),
        "spatial_groups": st.sampled_from([None, 1, 2, 90]),
        "regroup_every": st.sampled_from([1, 5]),
    }
    own = {
        "bmm": {},
        "grassmann": spatial
        | {
            "temporal": st.booleans(),
            "temporal_cells": st.sampled_from([1, 3, 99]),
            "temporal_kind": st.sampled_from(["consecutive", "kmeans"]),
            "temporal_dimension": st.sampled_from([None, 1, 50]),
            "temporal_groups": st.sampled_from([None, 1, 2, 50]),
        },
        "geometry-aware": spatial
        | {
            "projection": st.booleans(),
            "tau": st.sampled_from([1e-6, 0.97, 1.0]),
            "lower_dimension": st.sampled_from([None, 1, 5, 999]),
        },
    }[method]
    return st.fixed_dictionaries({}, optional=common | own)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=70, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_legal_input_and_options_finish_finite(method, data):
    points = data.draw(legal_tracks())
    options = data.draw(options_of(method))
    known = turning_cameras(len(points)) if data.draw(st.booleans()) else None
    if not any((frame != frame[0]).any() for frame in points):  # drawn without any extent
        with pytest.raises(InputError, match="all equal"):
            nrsfm.reconstruct(points, method, known, max_iterations=25, **options)
        return
    assert_sound(nrsfm.reconstruct(points, method, known, max_iterations=25, **options), points)


@st.composite
def broken_calls(draw):
    """A good call with one thing spoiled."""
    tracks, options = TRACKS[:5, :8].copy(), {}
    kind = draw(st.sampled_from(["value", "shape", "dtype", "option", "name", "camera"]))
    if kind == "value":
        tracks[draw(st.integers(0, 4)), draw(st.integers(0, 7)), draw(st.integers(0, 1))] = draw(
            st.sampled_from([np.nan, np.inf, -np.inf])
        )
    elif kind == "shape":
        tracks = draw(
            st.sampled_from([tracks[0], tracks[:2], tracks[:, :3], tracks[..., :1], tracks[None], tracks[:0], tracks.T])
        )
    elif kind == "dtype":
        tracks = draw(st.sampled_from([tracks.astype(t) for t in (complex, object, str, bool)] + [None, "a", {}, 3]))
    elif kind == "option":
        known = {f.name: f for stage in nrsfm.pipeline.STAGE_OPTIONS.values() for f in dataclasses.fields(stage)}
        name = draw(st.sampled_from(sorted(known)))
        options[name] = draw(st.sampled_from([[], {}, 1j, "??", object()]))
    elif kind == "name":
        options[draw(st.text("abcdefgh_", min_size=3, max_size=9))] = 1
    else:
        options["rotations"] = draw(
            st.sampled_from([np.eye(3), np.zeros((5, 3, 3)), np.ones((4, 3, 3)), "x", 5, np.full((5, 2, 3), np.nan)])
        )
    return tracks, options


@settings(max_examples=150)
@given(broken_calls())
def test_any_broken_call_is_refused_as_ours(call):
    tracks, options = call
    with pytest.raises(NrsfmError) as caught:
        nrsfm.reconstruct(tracks, **options)
    assert str(caught.value)
    assert "\n" not in str(caught.value)


def test_translations_are_the_means_of_the_points():
    result = nrsfm.reconstruct(TRACKS, "bmm")
    np.testing.assert_allclose(result.translations, TRACKS.mean(axis=1), rtol=1e-6)
    np.testing.assert_allclose(result.translations, measure(TRACKS).translations, rtol=1e-6)


@pytest.mark.parametrize("line", ["constant x", "constant y", "diagonal", "one place"])
def test_frames_whose_points_lie_on_a_line_are_named(line):
    tracks = TRACKS.copy()
    tracks[4:] = {
        "constant x": np.stack([np.full_like(tracks[4:, :, 0], 5.0), tracks[4:, :, 1]], axis=2),
        "constant y": np.stack([tracks[4:, :, 0], np.full_like(tracks[4:, :, 0], 5.0)], axis=2),
        "diagonal": np.stack([tracks[4:, :, 0], 2 * tracks[4:, :, 0] + 1], axis=2),
        "one place": np.full_like(tracks[4:], 7.0),
    }[line]
    result = nrsfm.reconstruct(tracks, "bmm", **QUICK)
    expected = f"in {len(tracks) - 4} of {len(tracks)} frames (the first is frame 4) all points lie on one line"
    assert any(expected in text for text in result.diagnostics["warnings"])
    assert not any("on one line" in text for text in nrsfm.reconstruct(TRACKS, "bmm").diagnostics["warnings"])


def test_known_cameras_that_do_not_turn_are_warned_of():
    still = np.repeat(np.eye(3)[None], len(TRACKS), axis=0)
    result = nrsfm.reconstruct(TRACKS, "bmm", rotations=still)
    assert any("hardly turn" in text for text in result.diagnostics["warnings"])
    turning = nrsfm.reconstruct(TRACKS, "bmm", rotations=turning_cameras(len(TRACKS)))
    assert not turning.diagnostics["warnings"]


@pytest.mark.parametrize("factor", [1e200, 1e-200])
def test_the_size_of_tracks_out_of_range_is_named(factor):
    with pytest.raises(nrsfm.errors.InputError, match=rf"received \d.*e[+-]{'1[89]|20'}"):
        nrsfm.reconstruct(TRACKS / np.abs(TRACKS).max() * factor)


# The stages about the affine reconstruction.


def with_holes(tracks, missing=0.2, seed=0):
    """Tracks in which entries are not seen, NaN there; point 7 in one frame only, point 9 in two."""
    visible = np.random.default_rng(seed).random(tracks.shape[:2]) >= missing
    visible[:, [7, 9]] = False
    visible[0, 7] = visible[:2, 9] = True
    return nrsfm.Tracks(np.where(visible[:, :, None], tracks, np.nan), visible)


@pytest.mark.parametrize("method", ["auto", "bmm", "grassmann"])
def test_missing_entries_are_completed_and_points_seen_too_rarely_left_out(method):
    points, shapes, _ = bending(30, 80)
    tracks = with_holes(points)
    result = nrsfm.reconstruct(tracks, method)
    kept = np.ones(80, dtype=bool)
    kept[[7, 9]] = False
    np.testing.assert_array_equal(result.reconstructed, kept)
    assert np.isfinite(result.shapes[:, kept]).all()
    assert np.isnan(result.shapes[:, ~kept]).all()
    assert shape_error(result, shapes, "per-frame") < 0.02
    assert np.nanmax(result.reprojection_errors(tracks)) < 1e-2 * np.ptp(points)
    assert result.confidence.shape == (30, 80)
    np.testing.assert_array_equal(result.confidence > 0, tracks.visible & kept)
    assert np.isfinite(result.depth_deviation[:, kept]).all()
    assert np.isnan(result.depth_deviation[:, ~kept]).all()
    assert result.diagnostics["repair"]["not_reconstructed"] == 2
    assert result.diagnostics["repair"]["missing"] == tracks.n_missing
    assert any("2 of 80 points are seen in fewer than" in text for text in result.diagnostics["warnings"])
    if method == "grassmann":
        np.testing.assert_array_equal(result.groups >= 0, kept)
    json.dumps(result.diagnostics, allow_nan=False)


def test_hidden_coordinates_are_never_used():
    tracks = with_holes(bending(30, 80)[0])
    spoiled = np.where(tracks.visible[:, :, None], tracks.points, 1e6)
    first, second = (
        nrsfm.reconstruct(t, "bmm", perspective="off") for t in (tracks, nrsfm.Tracks(spoiled, tracks.visible))
    )
    np.testing.assert_array_equal(first.shapes, second.shapes)


def test_frames_that_nothing_ties_together_are_refused():
    visible = np.ones(TRACKS.shape[:2], dtype=bool)
    visible[:6, 20:] = visible[6:, :20] = False
    with pytest.raises(InputError, match="all frames must be tied together"):
        nrsfm.reconstruct(nrsfm.Tracks(TRACKS, visible))
    visible[:] = True
    visible[5, 3:] = False
    with pytest.raises(InputError, match="at least 4 points must be seen in every frame, received 3 in frame 5"):
        nrsfm.reconstruct(nrsfm.Tracks(TRACKS, visible))


def test_outliers_are_found_told_and_do_little_harm():
    points, shapes, _ = bending(30, 150, noise=0.002)
    rng = np.random.default_rng(1)
    wrong = rng.random(points.shape[:2]) < 0.03
    spoiled = points + wrong[:, :, None] * 60.0 * rng.standard_normal(points.shape)
    clean, repaired, as_it_is = (
        nrsfm.reconstruct(tracks, "bmm", perspective="off", outliers=outliers)
        for tracks, outliers in ((points, True), (spoiled, True), (spoiled, False))
    )
    assert clean.confidence is None
    assert clean.diagnostics["repair"]["outliers"] == 0
    assert as_it_is.confidence is None
    assert np.mean(repaired.confidence[wrong] < 0.5) > 0.9  # some moved by a pixel or two only
    assert np.mean(repaired.confidence[~wrong] < 0.5) < 0.01
    assert repaired.diagnostics["repair"]["outliers"] == pytest.approx(wrong.sum(), rel=0.1)
    assert any("outliers" in text for text in repaired.diagnostics["warnings"])
    errors = [shape_error(result, shapes, "per-frame") for result in (clean, repaired, as_it_is)]
    assert errors[1] < 1.15 * errors[0]
    assert errors[2] > 5 * errors[0]


INTRINSICS = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def near():
    """Tracks of a camera as far away as its focal length of 800 pixels, of an object about 500 in size; its truth."""
    _, shapes, rotations = bending(24, 60)
    seen = shapes @ rotations.transpose(0, 2, 1)
    seen[..., 2] += 800.0
    image = seen @ INTRINSICS.T
    return image[..., :2] / image[..., 2:], shapes, rotations


def depth_agreement(result, shapes, rotations):
    """Correlation of the depths with the true ones: −1 for the wrong mirror image."""
    true = np.einsum("fpj,fj->fp", shapes, rotations[:, 2])
    return np.corrcoef(result.camera_depths().ravel(), true.ravel())[0, 1]


@pytest.mark.parametrize("known", [INTRINSICS, None])
def test_perspective_is_undone_and_shows_which_mirror_image_is_right(near, known):
    tracks, shapes, rotations = near
    affine = nrsfm.reconstruct(tracks, "bmm", perspective="off")
    right, other = (nrsfm.reconstruct(tracks, "bmm", intrinsics=known, mirror=mirror) for mirror in (False, True))
    report = right.diagnostics["perspective"]
    assert report["undone"]
    assert report["focal"] == pytest.approx(800.0, rel=1e-9 if known is not None else 0.1)
    assert shape_error(right, shapes, "similarity") < 0.1 * shape_error(affine, shapes, "similarity")
    assert right.diagnostics["mirror"]["rule"] == ("perspective" if known is None else "intrinsics")
    assert right.diagnostics["mirror"]["decided"]
    assert not any("mirror image" in text for text in right.diagnostics["warnings"])
    assert depth_agreement(right, shapes, rotations) > 0.99
    assert depth_agreement(other, shapes, rotations) < -0.99
    flip = np.array([1.0, 1.0, -1.0])
    np.testing.assert_allclose(other.shapes, right.shapes * flip, rtol=0, atol=1e-4 * np.abs(right.shapes).max())
    for result in (right, other):
        json.dumps([result.diagnostics, result.options], allow_nan=False)


def test_perspective_off_takes_the_tracks_as_they_are(near):
    result = nrsfm.reconstruct(near[0], "bmm", perspective="off", intrinsics=INTRINSICS)
    assert result.diagnostics["perspective"] == {"undone": False, "reason": "off"}
    assert result.diagnostics["mirror"]["rule"] not in ("perspective", "intrinsics")


def test_orthographic_tracks_show_no_perspective():
    for noise in (0.0, 0.05):
        report = nrsfm.reconstruct(bending(24, 60, noise)[0], "bmm").diagnostics
        assert not report["perspective"]["undone"]
        assert report["mirror"] == report["cameras"]["mirror"]


@pytest.mark.parametrize("options", [{}, {"mirror": True}, {"intrinsics": INTRINSICS}, {"gauge": "mean"}])
def test_known_cameras_are_left_alone(near, options):
    """Neither perspective, nor the object frame, nor the mirror moves them."""
    tracks, shapes, rotations = near
    result = nrsfm.reconstruct(tracks, "bmm", rotations, **options)
    np.testing.assert_allclose(result.rotations, rotations, atol=1e-9)
    assert depth_agreement(result, shapes, rotations) > 0.9
    undone = "intrinsics" in options
    assert result.diagnostics["perspective"]["undone"] == undone
    assert shape_error(result, shapes, "none") < (0.01 if undone else 0.2)
    ignored = any("mirror is ignored" in text for text in result.diagnostics["warnings"])
    assert ignored == ("mirror" in options)


@pytest.mark.parametrize("gauge", ["auto", "method", "cameras", "mean", "even", "steady"])
def test_the_object_frame_changes_nothing_that_is_seen(gauge):
    tracks, *_ = bending(30, 60, noise=0.01)
    options = {"precision": "float64", "perspective": "off", "deviation": False}
    plain, result = (nrsfm.reconstruct(tracks, "bmm", gauge=g, **options) for g in ("method", gauge))
    size = np.abs(plain.shapes).max()
    np.testing.assert_allclose(result.camera_shapes(), plain.camera_shapes(), rtol=0, atol=1e-9 * size)
    assert result.diagnostics["gauge"]["chosen"] in ("method", "cameras", "mean", "even", "steady")
    assert gauge in ("auto", result.diagnostics["gauge"]["chosen"])
    turned = np.abs(result.rotations - plain.rotations).max()
    assert turned > 0.01 if gauge in ("mean", "even") else turned < 2.0


def test_depths_get_a_deviation_unless_told_otherwise():
    tracks, *_ = bending(noise=0.02)
    result, without = (nrsfm.reconstruct(tracks, "bmm", perspective="off", deviation=d) for d in (True, False))
    assert result.depth_deviation.shape == tracks.shape[:2]
    assert (result.depth_deviation > 0).all()
    assert without.depth_deviation is None
    assert without.diagnostics["uncertainty"] is None
    assert "deviation" not in without.diagnostics["seconds"]
    np.testing.assert_array_equal(result.shapes, without.shapes)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("method", ["auto", "bmm"])
def test_the_cameras_see_the_shapes_where_the_points_are(method, known):
    """points[f] ≈ scales[f] · (rotations[f] @ shapes[f].T)[:2].T + translations[f] of complete orthographic tracks."""
    points, _, rotations = bending(20, 60)
    result = nrsfm.reconstruct(points, method, rotations if known else None)
    assert_sound(result, points)
    for f, shape in enumerate(result.shapes.astype(np.float64)):
        seen = result.scales[f] * (result.rotations[f] @ shape.T)[:2].T + result.translations[f]
        np.testing.assert_allclose(seen, points[f], rtol=0, atol=1e-3 * np.ptp(points))
    assert result.confidence is None
    assert result.reconstructed.all()


def test_options_of_every_stage_are_recorded():
    options = {"gauge": "mean", "outliers": False, "perspective": "off", "deviation": False, "least_frames": 5}
    result = nrsfm.reconstruct(TRACKS, "bmm", **options)
    assert options.items() <= result.options.items()
    declared = {f.name for stage in nrsfm.pipeline.STAGE_OPTIONS.values() for f in dataclasses.fields(stage)}
    assert declared <= result.options.keys()
