import numpy as np
import pytest

from nrsfm.datasets.corruption import back_facing, drifting, gross_outliers, occlude
from nrsfm.errors import InputError


def sheet(frames=30, side=20):
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    time = np.linspace(0, 1, frames)[:, None]
    return np.stack([x.ravel() * (1 + 0.1 * time), y.ravel() + 0.3 * time], axis=2)


def gap_lengths(visible):
    lengths = []
    for track in visible.T:
        edges = np.diff(np.concatenate([[0], (~track).astype(int), [0]]))
        lengths += list(np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1))
    return np.array(lengths)


@pytest.mark.parametrize("kind", ["blocks", "random"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5])
def test_exactly_the_share_that_was_asked_for_is_hidden(kind, share):
    points = sheet()
    visible = occlude(points, share, np.random.default_rng(0), kind)
    assert visible.shape == points.shape[:2]
    assert np.count_nonzero(~visible) == round(share * visible.size)


def test_the_same_seed_hides_the_same_entries_and_another_does_not():
    masks = [occlude(sheet(), 0.3, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert np.array_equal(masks[0], masks[1])
    assert not np.array_equal(masks[0], masks[2])


def test_masks_do_not_depend_on_the_unit_or_the_place_of_the_image():
    one = occlude(sheet(), 0.3, np.random.default_rng(3))
    other = occlude(sheet() * 1024.0 + 4096.0, 0.3, np.random.default_rng(3))
    assert np.mean(one != other) < 0.01  # rounding may move a point over an edge


def test_blocks_last_and_are_compact_and_leave_something_of_every_frame():
    points = sheet()
    blocks = occlude(points, 0.3, np.random.default_rng(0))
    scattered = occlude(points, 0.3, np.random.default_rng(0), "random")
    assert np.mean(gap_lengths(blocks)) > 2 * np.mean(gap_lengths(scattered))
    assert (~blocks).mean(axis=1).max() <= 0.85

    def alike(visible):  # how often a point and the one beside it on the sheet are both hidden or both seen
        grid = visible.reshape(len(visible), 20, 20)
        return np.mean(grid[:, :, 1:] == grid[:, :, :-1])

    assert alike(blocks) > 0.75 > alike(scattered)


@pytest.mark.parametrize(
    ("points", "share", "kind"),
    [(sheet(), -0.1, "blocks"), (sheet(), 0.9, "blocks"), (sheet(), 0.3, "block"), (np.zeros((3, 4)), 0.3, "blocks")],
)
def test_what_cannot_be_hidden_is_refused(points, share, kind):
    with pytest.raises(InputError):
        occlude(points, share, np.random.default_rng(0), kind)


def sphere():
    t, p = np.meshgrid(np.linspace(0.05, np.pi - 0.05, 12), np.linspace(0, 2 * np.pi, 24, endpoint=False))
    points = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=2).reshape(-1, 3)
    at = np.arange(24 * 12).reshape(24, 12)
    faces = np.stack([at[:, :-1], at[:, 1:], np.roll(at, -1, 0)[:, 1:], np.roll(at, -1, 0)[:, :-1]], axis=2)
    return points, faces.reshape(-1, 4)


def test_the_back_of_a_sphere_is_hidden_whichever_way_its_faces_are_wound():
    points, faces = sphere()
    shapes = np.stack([points + np.array(shift) for shift in ([0, 0, 3], [1, 0, 9])])
    for wound in (faces, faces[:, ::-1], np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])):
        towards = np.where(back_facing(shapes, wound), 1, -1)
        clear = np.abs(points[:, 2]) > 0.2
        assert abs(np.corrcoef(towards[0][clear], np.sign(points[clear, 2]))[0, 1]) > 0.99
    visible = back_facing(shapes, faces, 0.25)
    assert np.count_nonzero(~visible) == round(0.25 * visible.size)


def test_gross_outliers_change_exactly_the_entries_they_tell():
    points = np.asfortranarray(sheet())
    points.flags.writeable = False
    out, wrong = gross_outliers(points, 0.05, np.random.default_rng(0))
    assert np.count_nonzero(wrong) == round(0.05 * wrong.size)
    assert np.array_equal(out[~wrong], points[~wrong])
    assert (out[wrong] != points[wrong]).all()
    assert (out[wrong] < points.max(axis=(0, 1)) + 0.2).all()


def test_gross_outliers_fall_on_visible_entries_only():
    visible = occlude(sheet(), 0.5, np.random.default_rng(0))
    _, wrong = gross_outliers(sheet(), 0.1, np.random.default_rng(1), visible)
    assert not (wrong & ~visible).any()


def test_drifting_tracks_are_right_to_begin_with_and_wrong_to_the_end():
    points = sheet()
    out, wrong = drifting(points, 0.1, np.random.default_rng(0))
    assert 0.1 <= wrong.mean() < 0.1 + 1 / points.shape[1]
    assert np.array_equal(out[~wrong], points[~wrong])
    assert not wrong[: len(wrong) // 2 - 1].any()
    assert np.array_equal(wrong[-1], wrong.any(axis=0))
    assert np.array_equal(np.sort(wrong, axis=0), wrong)  # never right again
    slides = np.array([not (points[-1] == out[-1, p]).all(axis=1).any() for p in np.flatnonzero(wrong[-1])])
    assert 0.3 < slides.mean() < 0.7
