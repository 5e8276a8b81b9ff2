"""Animations: that they loop, show what they should, and keep to their size."""

import numpy as np
import pytest
from PIL import Image

from nrsfm import Reconstruction, Tracks
from nrsfm.errors import FileError, InputError
from nrsfm.viewing import animation
from nrsfm.viewing.animation import Animation, make_animation, schedule, write_animation

PACE = (2, 70)


@pytest.mark.parametrize(("frames", "most"), [(1, 20), (2, 20), (3, 20), (30, 20), (500, 27)])
def test_the_end_meets_the_beginning(frames, most):
    order, places = schedule(frames, most)
    chosen = sorted(set(order.tolist()))
    assert (chosen[0], chosen[-1]) == (0, frames - 1)
    assert len(chosen) == min(frames, most)
    rank = np.searchsorted(chosen, order)
    assert np.abs(np.diff(np.append(rank, rank[0]))).max(initial=0) <= 1  # one step at a time, around the end too
    assert len(order) >= most
    np.testing.assert_allclose(places, np.arange(len(order)) / len(order))


@pytest.mark.parametrize("name", ["mesh", "points", "sparse", "skeleton", "tiny", "two frames"])
def test_every_kind_of_shape_is_drawn_beside_its_tracks(cases, name):
    case = cases[name]
    made = make_animation(case.result, tracks=Tracks(case.tracks), faces=case.faces, edges=case.edges, pace=PACE)
    count, height, width, _ = made.pictures.shape
    assert (count, height % 2, width % 2, made.delay) == (len(schedule(len(case.tracks), 2)[0]), 0, 0, 70)
    assert width <= 700
    paper = made.pictures[0, 2, 2].astype(int)
    inked = np.abs(made.pictures.astype(int) - paper).sum(axis=3) > 60
    middle = inked.any(axis=(0, 1)).nonzero()[0]
    gap = np.flatnonzero(np.diff(middle) > 10)
    assert len(gap) >= 1  # two panels with a gap between them
    assert inked[:, :, : width // 3].any(axis=(1, 2)).all()
    assert inked[:, :, -width // 3 :].any(axis=(1, 2)).all()
    assert not inked[:, :, 0].any()
    assert not inked[:, 0].any()
    assert np.abs(made.pictures[1].astype(int) - made.pictures[0]).mean() > 0.1  # it moves


def test_colours_and_doubted_measurements_are_seen(cases):
    case = cases["mesh"]
    frames, points = case.result.shapes.shape[:2]
    green = np.tile(np.array([[20, 200, 40]], dtype=np.uint8), (points, 1))
    confidence = np.ones((frames, points), dtype=np.float32)
    confidence[0, ::2] = 0.0
    doubted = Reconstruction(
        case.result.shapes, case.result.rotations, case.result.translations, case.result.scales, confidence=confidence
    )
    plain = make_animation(case.result, tracks=Tracks(case.tracks), faces=case.faces, pace=PACE).pictures[0]
    shown = make_animation(doubted, tracks=Tracks(case.tracks), faces=case.faces, colours=green, pace=PACE).pictures[0]

    def share(image, colour, away):
        return (np.abs(image.astype(int) - colour).max(axis=2) < away).mean()

    assert share(shown, (20, 190, 40), 70) > 0.05 > share(plain, (20, 190, 40), 70)
    assert share(shown, (200, 85, 61), 40) > 2 * share(plain, (200, 85, 61), 40)


def smooth(count=6, height=120, width=400):
    y, x = np.mgrid[:height, :width]
    waves = [127 + 120 * np.sin((x + 9 * k) / 30 + y / 25)[..., None] * [1.0, 0.6, 0.3] for k in range(count)]
    return Animation(np.array(waves).astype(np.uint8), 70)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_files_loop_and_hold_the_pictures(tmp_path, suffix):
    from PIL import Image, ImageSequence

    made, path = smooth(), tmp_path / f"ä b{suffix}"
    size, (width, height), _ = write_animation(made, path)
    assert size == path.stat().st_size
    assert (width, height) == (400, 120)
    with Image.open(path) as found:
        assert found.info["loop"] == 0
        shown = [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(found)]
        assert found.info["duration"] == 70
    assert len(shown) == len(made.pictures)
    for a, b in zip(shown, made.pictures, strict=True):
        assert np.abs(a - b).mean() < 6


def test_a_film_holds_the_pictures(tmp_path):
    av = pytest.importorskip("av", reason="PYAV ABSENT: films are not tested")
    made, path = smooth(), tmp_path / "a.mp4"
    write_animation(made, path)
    with av.open(str(path)) as film:
        shown = [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0)]
    assert len(shown) == len(made.pictures)
    assert np.abs(np.array(shown) - made.pictures).mean() < 8


def test_what_is_too_large_loses_colours_then_pixels_then_pictures(tmp_path):
    made = smooth(count=4)
    full, size, count = write_animation(made, tmp_path / "a.gif")
    assert (size, count) == ((400, 120), 4)
    steps = []
    for part in (0.9, 0.5, 0.3, 0.2):
        length, size, count = write_animation(made, tmp_path / f"{part}.gif", megabytes=part * full / 1e6)
        assert length <= part * full
        assert size[1] / size[0] == pytest.approx(120 / 400, rel=0.03)
        steps.append((size[0], count))
    assert steps[0] == (400, 4)
    assert steps[-1][1] == 2
    assert min(width for width, _ in steps) >= 240
    assert all(width >= 320 for width, count in steps if count == 4)
    with Image.open(tmp_path / "0.2.gif") as found:
        assert found.info["duration"] == 140


def test_a_film_that_is_too_large_loses_pixels(tmp_path):
    made = smooth(count=4)
    full = write_animation(made, tmp_path / "a.webp")[0]
    size, (width, _), count = write_animation(made, tmp_path / "b.webp", megabytes=0.8 * full / 1e6)
    assert size <= 0.8 * full
    assert 240 <= width < 400
    assert count == 4


def test_what_does_not_get_small_enough_is_not_written(tmp_path):
    made = smooth(count=4)
    with pytest.raises(FileError, match=r"more than the 0\.001 MB allowed"):
        write_animation(made, tmp_path / "c.gif", megabytes=0.001)
    assert not (tmp_path / "c.gif").exists()


def test_names_and_sizes_that_do_not_fit_are_refused(tmp_path, cases):
    path = tmp_path / "a.gif"
    path.write_bytes(b"mine")
    with pytest.raises(FileError, match="exists"):
        write_animation(smooth(1), path)
    assert path.read_bytes() == b"mine"
    with pytest.raises(FileError, match=r"must end in \.gif, \.webp or \.mp4, received '\.png'"):
        write_animation(smooth(1), tmp_path / "a.png")
    case = cases["tiny"]
    with pytest.raises(InputError, match="received 3 frames of 5 points"):
        make_animation(case.result, tracks=Tracks(case.tracks[:3]))


def test_a_video_is_behind_the_tracks(cases):
    case = cases["sparse"]

    class Blue:
        width, height = 640, 480

        def array(self, frame):
            return np.full((240, 320, 3), (30, 40, 200), dtype=np.uint8)

    made = make_animation(case.result, tracks=Tracks(case.tracks), pictures=Blue(), pace=PACE).pictures[0]
    blue = (np.abs(made.astype(int) - (30, 40, 200)).max(axis=2) < 8).nonzero()
    assert np.ptp(blue[1]) / np.ptp(blue[0]) == pytest.approx(640 / 480, rel=0.03)
    assert animation.check_animation_path("A.GIF") == ".gif"
