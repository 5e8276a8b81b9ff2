import json

import numpy as np
import pytest

from nrsfm.datasets.corruption import drifting, gross_outliers, occlude
from nrsfm.errors import InputError
from nrsfm.repair import RepairOptions, repair
from nrsfm.repair.view import masked_median, require_tied, view_of
from nrsfm.tracks import Tracks


def run(points, visible=None, seed=0, **options):
    return repair(Tracks(points, visible), RepairOptions(**options), np.random.default_rng(seed), lambda fraction: None)


def hide(points, visible):
    return np.where(visible[:, :, None], points, np.nan)


def rms(values, points):
    return np.sqrt(np.mean(values**2)) / np.sqrt(np.mean(np.var(points, axis=1)))


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_tracks_without_gaps_and_outliers_come_back_as_they_are(sheet, rng, noise):
    tracks = Tracks(sheet + noise * rng.standard_normal(sheet.shape))
    for whole in (tracks, Tracks(tracks.points, np.ones(sheet.shape[:2], dtype=bool))):
        repaired = repair(whole, RepairOptions(), rng, lambda fraction: None)
        assert repaired.points is whole.points
        assert repaired.kept.all()
        assert repaired.confidence is None
        assert repaired.warnings == []


def test_a_part_that_moves_by_itself_for_a_moment_is_no_outlier(sheet):
    points = np.array(sheet)
    near = np.linalg.norm(sheet[0] - sheet[0, 112], axis=1) < 0.35
    for f, size in ((10, 0.1), (11, 0.25), (12, 0.3), (13, 0.12)):
        bump = np.exp(-(np.linalg.norm(sheet[0, near] - sheet[0, 112], axis=1) ** 2) / 0.03)
        points[f, near, 1] -= size * bump
    tracks = Tracks(points)
    assert repair(tracks, RepairOptions(), np.random.default_rng(0), lambda fraction: None).points is tracks.points


@pytest.mark.parametrize("kind", ["blocks", "random"])
def test_missing_entries_are_completed_and_measured_ones_untouched(sheet, rng, kind):
    visible = occlude(sheet, 0.3, rng, kind)
    repaired = run(hide(sheet, visible), visible)
    kept = repaired.kept
    seen = visible & kept
    assert np.array_equal(repaired.points[seen], sheet[seen])
    assert np.isfinite(repaired.points[:, kept]).all()
    assert np.isnan(repaired.points[:, ~kept]).all()
    filled = ~visible & kept
    assert rms((repaired.points - sheet)[filled], sheet) < 0.01
    assert np.array_equal(repaired.confidence, visible.astype(np.float32))
    assert repaired.confidence.dtype == np.float32
    assert repaired.report["missing"] == np.count_nonzero(~visible)
    json.dumps(repaired.report)


def test_noisy_tracks_are_completed_to_about_their_noise(sheet, rng):
    visible = occlude(sheet, 0.3, rng)
    noisy = sheet + 0.01 * rng.standard_normal(sheet.shape)
    repaired = run(hide(noisy, visible), visible)
    filled = ~visible & repaired.kept
    assert np.sqrt(np.mean((repaired.points - sheet)[filled] ** 2)) < 0.02


def test_points_that_are_hardly_seen_are_not_invented(sheet, rng):
    visible = occlude(sheet, 0.2, rng, "random")
    visible[:, 7] = np.arange(len(visible)) < 2
    visible[:, 50] = False
    repaired = run(hide(sheet, visible), visible)
    assert list(np.flatnonzero(~repaired.kept)) == [7, 50]
    assert np.isnan(repaired.points[:, [7, 50]]).all()
    assert repaired.report["not_reconstructed"] == 2
    assert any("2 of 225 points" in text for text in repaired.warnings)
    assert run(hide(sheet, visible), visible, least_frames=2).kept[7]


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
def test_gross_outliers_are_found_and_replaced(sheet, share):
    points, wrong = gross_outliers(sheet, share, np.random.default_rng(1))
    size = np.sqrt(np.mean(np.var(sheet, axis=1)))
    clear = wrong & (np.linalg.norm(points - sheet, axis=2) > 0.3 * size)
    repaired = run(points)
    flagged = repaired.confidence == 0
    assert np.mean(flagged[clear]) > 0.98
    assert np.mean(flagged[~wrong]) < 2e-3
    assert np.array_equal(repaired.points[~flagged], points[~flagged])
    assert rms((repaired.points - sheet)[flagged], sheet) < 0.05
    assert repaired.report["outliers"] == np.count_nonzero(flagged)
    assert "outliers" in " ".join(repaired.warnings)
    assert ((repaired.confidence >= 0) & (repaired.confidence <= 1)).all()


def test_drifting_tracks_are_found_from_about_where_they_leave(sheet):
    points, wrong = drifting(sheet, 0.05, np.random.default_rng(2))
    size = np.sqrt(np.mean(np.var(sheet, axis=1)))
    clear = wrong & (np.linalg.norm(points - sheet, axis=2) > 0.3 * size)
    flagged = run(points).confidence == 0
    assert np.mean(flagged[clear]) > 0.9
    assert np.mean(flagged[~wrong]) < 0.01


def test_outliers_among_gaps(sheet, rng):
    visible = occlude(sheet, 0.2, rng)
    points, wrong = gross_outliers(sheet, 0.03, rng, visible)
    repaired = run(hide(points, visible), visible)
    flagged = (repaired.confidence == 0) & visible
    assert np.mean(flagged[wrong]) > 0.9
    assert np.mean(flagged[visible & ~wrong]) < 5e-3


def test_outliers_are_left_alone_on_request(sheet):
    points, _ = gross_outliers(sheet, 0.05, np.random.default_rng(1))
    tracks = Tracks(points)
    assert repair(tracks, RepairOptions(outliers=False), np.random.default_rng(0), print).points is tracks.points


def test_the_answer_moves_with_the_image(sheet):
    visible = occlude(sheet, 0.3, np.random.default_rng(0))
    one = run(hide(sheet, visible), visible)
    for unit, shift in ((1024.0, 512.0), (1 / 1024, 0.0)):
        other = run(hide(sheet * unit + shift, visible), visible)
        assert np.array_equal(one.kept, other.kept)
        np.testing.assert_allclose(other.points[:, one.kept], one.points[:, one.kept] * unit + shift, atol=2e-3 * unit)


def test_the_same_seed_gives_the_same_answer(sheet):
    visible = occlude(sheet, 0.3, np.random.default_rng(0))
    first, second = (run(hide(sheet, visible), visible) for _ in range(2))
    np.testing.assert_array_equal(first.points, second.points)
    assert first.report == second.report


def test_single_precision_and_memory_order_are_kept(sheet, tmp_path):
    visible = occlude(sheet, 0.3, np.random.default_rng(0))
    np.save(tmp_path / "tracks.npy", np.asfortranarray(hide(sheet, visible).astype(np.float32)))
    mapped = np.load(tmp_path / "tracks.npy", mmap_mode="r")
    repaired = run(mapped, visible)
    assert repaired.points.dtype == np.float32
    assert rms((repaired.points - sheet)[~visible & repaired.kept], sheet) < 0.01


def degenerate():
    rng = np.random.default_rng(5)
    flat = rng.standard_normal((12, 2))
    time = np.linspace(0, 1, 8)[:, None]
    still = np.broadcast_to(flat, (8, 12, 2)).copy()
    yield "no motion", still
    yield "a plane that slides", still + time[:, None] * [1.0, 2.0]
    yield "three frames", rng.standard_normal((3, 20, 2))
    yield "few points", rng.standard_normal((10, 6, 2)) * 0.1 + flat[:6]
    yield "duplicates", np.repeat(still, 3, axis=1)
    yield "a line", np.stack([still[:, :, 0], 0 * still[:, :, 0]], axis=2)


@pytest.mark.parametrize(("name", "points"), list(degenerate()))
def test_degenerate_tracks_are_completed_without_fuss(name, points):
    frames, count = points.shape[:2]
    visible = np.ones((frames, count), dtype=bool)
    visible[np.arange(count) % frames, np.arange(count)] = count < 8
    visible[0, 0] = False
    repaired = run(hide(points, visible), visible, least_frames=2)
    assert repaired.kept.all()
    assert np.isfinite(repaired.points).all(), name
    assert np.abs(repaired.points).max() < 10 * np.abs(points).max()
    assert run(points).kept.all()


def test_a_frame_without_points_and_parts_that_share_none_are_refused(sheet):
    visible = np.ones(sheet.shape[:2], dtype=bool)
    visible[4, 3:] = False
    with pytest.raises(InputError, match="received 3 in frame 4"):
        run(hide(sheet, visible), visible)
    visible = np.zeros(sheet.shape[:2], dtype=bool)
    visible[:15, :110] = visible[15:, 110:] = True
    with pytest.raises(InputError, match="15 frames that share fewer with the other 15"):
        run(hide(sheet, visible), visible)


def test_frames_may_hang_together_through_others():
    visible = np.zeros((3, 12), dtype=bool)
    visible[0, :6] = visible[1, 2:10] = visible[2, 6:] = True
    require_tied(visible)
    visible[1, 6] = False
    with pytest.raises(InputError):
        require_tied(visible)


def test_masked_median_is_the_lower_median_of_what_is_seen(rng):
    values, mask = rng.standard_normal((40, 9)), rng.random((40, 9)) < 0.6
    mask[3] = False
    found = masked_median(values, mask)
    assert found[3] == 0
    for row, seen, median in zip(values, mask, found, strict=True):
        if seen.any():
            assert median == np.quantile(row[seen], 0.5, method="lower")


def test_the_view_is_not_moved_by_outliers(sheet, rng):
    clean = view_of(Tracks(sheet), rng)
    points, _ = gross_outliers(sheet, 0.1, rng)
    points[3, 5] = 1e6
    marred = view_of(Tracks(points), rng)
    assert marred.unit == pytest.approx(clean.unit, rel=0.25)
    assert np.abs(marred.offset - clean.offset).max() < 0.2 * clean.unit


def test_the_cost_of_screening_grows_with_the_points_only(data_root):
    import time

    from nrsfm.datasets import load

    tracks = load("face-seq3", data_root).tracks
    start = time.perf_counter()
    repaired = repair(tracks, RepairOptions(), np.random.default_rng(0), lambda fraction: None)
    assert repaired.points is tracks.points
    assert time.perf_counter() - start < 5  # a third of a second on a free core


@pytest.mark.parametrize("name", ["pickup", "back_real126", "walking", "face-seq1"])
def test_real_tracks_that_are_complete_are_left_alone(data_root, name):
    from nrsfm.datasets import load

    options = {"points": 2000} if name.startswith("face-seq") else {}
    tracks = load(name, data_root, **options).tracks
    assert repair(tracks, RepairOptions(), np.random.default_rng(0), lambda fraction: None).points is tracks.points
