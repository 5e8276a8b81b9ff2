"""What every registered method must do, whatever it assumes: facts, invariances, repeatability, refusals."""

import numpy as np
import pytest

from nrsfm.cameras import CameraOptions
from nrsfm.errors import InputError, OptionError
from nrsfm.methods import get_method, method_names
from nrsfm.methods.base import Needs
from nrsfm.metrics import frame_errors
from nrsfm.pipeline import reconstruct

METHODS = method_names()
EXACT = {"tolerance": 0.0, "denoise": False, "noise_level": 0.0, "precision": "float64"}
CLOSE = 1e-5


def close(result, expected, limit=CLOSE):
    """Shapes equal to rounding, in units of the largest coordinate."""
    np.testing.assert_allclose(result, expected, rtol=0, atol=limit * np.abs(expected).max())


@pytest.fixture(scope="module")
def data(sequence):
    """Few points, moderate noise: no method's assumptions hold exactly."""
    return sequence(frames=24, points=60, rank=2, noise=0.01)


@pytest.fixture(scope="module")
def plain(data):
    """What each method makes of the data with known cameras, computed once."""
    kept = {}

    def result(method, **options):
        key = method, tuple(options.items())
        if key not in kept:
            kept[key] = reconstruct(data.tracks, method, data.rotations, **(EXACT | options))
        return kept[key]

    return result


def test_names():
    wanted = ["auto", "bmm", "grassmann", "geometry-aware", "pta", "csf1", "csf2", "ksta", "mp"]
    wanted += ["dv", "ds", "smsr", "rbmm", "organic", "em-pnd"]
    assert [name for name in wanted if name in METHODS] == METHODS


@pytest.mark.parametrize("method", METHODS)
def test_facts(method):
    found = get_method(method)
    assert found.name == method
    assert 1990 < found.year < 2030
    for text in (found.title, found.summary, found.assumes, found.cost):
        assert isinstance(text, str)
        assert text.strip() == text
        assert text
    assert isinstance(found.needs, Needs)
    assert found.needs.every_point or not found.needs.neighbours
    assert found.camera_method in CameraOptions.__dataclass_fields__["camera_method"].metadata["choices"]


@pytest.mark.parametrize("method", METHODS)
def test_tracks_are_explained_and_the_shape_is_found(method, data, plain):
    """A rigid shape that bends a little, cameras known: nobody may miss it by far."""
    result = plain(method)
    assert np.isfinite(result.shapes).all()
    assert frame_errors(result, data.shapes, "none").mean() < 0.3
    seen = np.einsum("fij,fpj->fpi", result.rotations, result.shapes)[..., :2] * result.scales[:, None, None]
    seen += result.translations[:, None]
    spread = np.sqrt(np.mean((data.tracks - data.tracks.mean(axis=1, keepdims=True)) ** 2))
    assert np.sqrt(np.mean((seen - data.tracks) ** 2)) < 0.3 * spread


@pytest.mark.parametrize("method", METHODS)
def test_order_of_the_points_does_not_matter(method, data, plain):
    order = np.random.default_rng(1).permutation(data.tracks.shape[1])
    moved = reconstruct(data.tracks[:, order], method, data.rotations, **EXACT)
    close(moved.shapes, plain(method).shapes[:, order])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0.0), (37.0, 1e4)])
def test_units_do_not_matter(method, scale, shift, data, plain):
    moved = reconstruct(scale * data.tracks + shift, method, data.rotations, **EXACT)
    close(moved.shapes / scale, plain(method).shapes)
    np.testing.assert_allclose(moved.translations, scale * plain(method).translations + shift, rtol=1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_turning_the_image_does_not_matter(method, data, plain):
    """All images turned by one angle, and the cameras with them: the same object."""
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    moved = reconstruct(data.tracks @ turn[:2, :2].T, method, turn @ data.rotations, **EXACT)
    close(moved.shapes, plain(method).shapes)


@pytest.mark.parametrize("method", METHODS)
def test_same_input_same_output(method, data, plain):
    again = reconstruct(np.asfortranarray(data.tracks), method, data.rotations, **EXACT)
    close(again.shapes, plain(method).shapes, 1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_own_cameras_follow_units_and_order_of_points(method, data):
    """With its own estimator: the object as the cameras see it, since the object frame itself is a convention."""

    def seen(tracks):
        result = reconstruct(tracks, method, **EXACT)
        assert result.diagnostics["cameras"]["method"] == get_method(method).camera_method
        return np.einsum("fij,fpj->fpi", result.rotations, result.shapes) * result.scales[:, None, None]

    order = np.random.default_rng(2).permutation(data.tracks.shape[1])
    first, moved = seen(data.tracks), seen(37.0 * data.tracks[:, order] + 5.0)
    close(moved / 37.0, first[:, order], 1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_float32_and_read_only_tracks_are_taken(method, data, plain):
    tracks = data.tracks.astype(np.float32)
    tracks.setflags(write=False)
    result = reconstruct(tracks, method, data.rotations, **EXACT)
    close(result.shapes, plain(method).shapes, 5e-3)


@pytest.mark.parametrize("method", METHODS)
def test_history_is_complete_and_finite(method, plain):
    found = plain(method).diagnostics
    assert found["iterations"] >= 1
    assert found["stop_reason"]
    lengths = {len(values) for values in found["history"].values()}
    assert len(lengths) <= 1
    for values in found["history"].values():
        assert np.isfinite(values).all()


@pytest.mark.parametrize("method", METHODS)
def test_least_frames_are_enough_and_one_fewer_is_refused(method, data):
    needs = get_method(method).needs
    least = needs.least_frames
    assert np.isfinite(reconstruct(data.tracks[:least], method, data.rotations[:least]).shapes).all()
    if least > 3:
        with pytest.raises(InputError, match=f"method '{method}' needs at least {least} frames, received {least - 1}"):
            reconstruct(data.tracks[: least - 1], method, data.rotations[: least - 1])


@pytest.mark.parametrize("method", METHODS)
def test_frames_without_an_order_are_refused_where_the_order_is_used(method, data):
    if get_method(method).needs.frame_order:
        with pytest.raises(InputError, match=f"method '{method}' needs frames that follow one another"):
            reconstruct(data.tracks, method, data.rotations, ordered=False)
    else:
        order = np.random.default_rng(3).permutation(len(data.tracks))
        options = EXACT | {"ordered": False}
        options |= {"temporal": False} if method == "grassmann" else {}
        plain = reconstruct(data.tracks, method, data.rotations, **options)
        mixed = reconstruct(data.tracks[order], method, data.rotations[order], **options)
        close(mixed.shapes, plain.shapes[order], 1e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["planar", "still points", "no turn", "two places"])
def test_degenerate_tracks_give_an_answer_or_one_clear_line(method, kind, data):
    tracks = data.tracks.copy()
    if kind == "planar":
        tracks = data.tracks[:1] + 0 * tracks
        tracks = tracks * np.linspace(0.5, 1, len(tracks))[:, None, None]
    elif kind == "still points":
        tracks[:, :30] = tracks[:1, :30]
    elif kind == "no turn":
        tracks = np.repeat(tracks[:1], len(tracks), axis=0)
    else:
        tracks[:, 10:] = tracks[:, 9:10]
    try:
        result = reconstruct(tracks, method)
    except InputError:
        return
    assert np.isfinite(result.shapes).all()
    assert np.isfinite(result.rotations).all()


@pytest.mark.parametrize(
    ("wrong", "near"), [("grasmann", "grassmann"), ("BMM", ""), ("geometry_aware", "geometry-aware")]
)
def test_unknown_methods_name_the_nearest(wrong, near):
    with pytest.raises(OptionError, match="method must be one of") as caught:
        get_method(wrong)
    assert near in str(caught.value).split("received")[1]
    assert repr(wrong) in str(caught.value)
