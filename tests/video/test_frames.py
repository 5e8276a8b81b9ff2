"""Frames come back as written, in any order, from files and folders; what is wrong is named in one line."""

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nrsfm.errors import FileError, InputError, NrsfmError, OptionError
from nrsfm.video import open_frames, write_video


def test_lossless_frames_are_the_images_in_any_order(video: Path, images: list[np.ndarray]) -> None:
    with open_frames(video, cache_bytes=1) as frames:
        assert frames.shape == (24, 90, 120)
        for f in (23, 0, 11, 12, 5, 23, 1):
            np.testing.assert_array_equal(frames.colour(f), images[f])
        assert not frames.colour(3).flags.writeable
        np.testing.assert_allclose(frames.grey(4), images[4] @ [0.299, 0.587, 0.114] / 255, atol=1e-6)
        assert frames.grey(4).dtype == np.float32
        np.testing.assert_array_equal(frames[-1], images[-1])
        with pytest.raises(IndexError):
            frames.colour(24)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".webm", ".mov", ".avi"])
def test_seeking_gives_what_reading_through_gave(tmp_path: Path, images: list[np.ndarray], suffix: str) -> None:
    """Long enough for several key frames, with frames that depend on later ones."""
    path = tmp_path / f"a{suffix}"
    long = [np.roll(images[f % 24], f, axis=0) for f in range(70)]
    codec = {"libvpx-vp9": "libvpx"}.get("libvpx-vp9") if suffix == ".webm" else None
    write_video(path, long, codec=codec, lossless=suffix == ".avi")
    through = open_frames(path)  # all in the cache from the one pass
    jumping = open_frames(path, cache_bytes=1)
    for f in (69, 3, 40, 41, 39, 0, 68):
        np.testing.assert_array_equal(jumping[f], through[f])
    error = [np.abs(through[f].astype(float) - long[f]).mean() for f in range(70)]
    assert max(error) < 12  # the frames are those, and not their neighbours
    wrong = np.abs(through[30].astype(float) - long[31]).mean()
    assert wrong > 2 * error[30]


def test_a_variable_rate_keeps_its_times(tmp_path: Path, images: list[np.ndarray]) -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.2, 24))
    write_video(tmp_path / "v.mp4", images, times=times)
    frames = open_frames(tmp_path / "v.mp4", cache_bytes=1)
    np.testing.assert_allclose(frames.times, times - times[0], atol=1e-4)
    assert frames.fps == pytest.approx(23 / (times[-1] - times[0]), rel=1e-3)
    assert np.abs(frames[17].astype(float) - images[17]).mean() < 6


def test_range_and_stride(video: Path, images: list[np.ndarray]) -> None:
    frames = open_frames(video, start=3, stop=20, stride=4)
    np.testing.assert_array_equal(frames.numbers, [3, 7, 11, 15, 19])
    for image, number in zip(frames, frames.numbers, strict=True):
        np.testing.assert_array_equal(image, images[number])
    np.testing.assert_allclose(frames.times, frames.numbers / 30, atol=2e-3)
    assert frames.fps == pytest.approx(7.5, rel=0.02)


def test_shrinking_takes_the_mean_of_areas(video: Path, images: list[np.ndarray]) -> None:
    for spec in (60, "60", (60, 45), "60x45"):
        frames = open_frames(video, resize=spec)  # type: ignore[arg-type]
        assert frames.shape == (24, 45, 60)
        assert frames.original_size == (90, 120)
        means = images[5].reshape(45, 2, 60, 2, 3).mean(axis=(1, 3))
        assert np.abs(frames[5] - means).max() <= 0.5 + 1e-9


@pytest.mark.parametrize(("turn", "matrix"), [(1, (0, -1, 1, 0)), (2, (-1, 0, 0, -1)), (3, (0, 1, -1, 0))])
def test_rotation_in_the_file_is_applied(tmp_path: Path, images: list[np.ndarray], turn: int, matrix: tuple) -> None:
    """The display matrix in an MP4's track header, as a phone held upright writes it."""
    path = tmp_path / "a.mp4"
    write_video(path, images)
    data = path.read_bytes()
    at = data.index(b"tkhd") + 44
    a, b, c, d = (65536 * n for n in matrix)
    path.write_bytes(data[:at] + struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30) + data[at + 36 :])
    frames = open_frames(path)
    upright = np.rot90(images[0], turn)
    assert frames.shape[1:] == upright.shape[:2]
    assert np.abs(frames[0].astype(float) - upright).mean() < 6


def test_a_folder_in_natural_order(tmp_path: Path, images: list[np.ndarray]) -> None:
    folder = tmp_path / "Bilder für Test"
    folder.mkdir()
    for f, image in enumerate(images[:12]):
        Image.fromarray(image).save(folder / f"img{f}.png")
    (folder / "notes.txt").write_text("no image")
    frames = open_frames(folder, fps=10, cache_bytes=1)
    assert len(frames) == 12
    for f in (0, 2, 10, 11):
        np.testing.assert_array_equal(frames[f], images[f])
    np.testing.assert_allclose(frames.times, np.arange(12) / 10)
    np.testing.assert_array_equal(open_frames(folder / "img?.png")[9], images[9])


def test_sixteen_bits_and_grey_images(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 65536, (20, 30)).astype(np.uint16)
    for f in range(2):
        Image.fromarray(values + f).save(tmp_path / f"{f}.tif")
    np.testing.assert_array_equal(open_frames(tmp_path)[0][..., 1], values >> 8)


def test_a_folder_of_two_series_or_sizes_or_nothing(tmp_path: Path, images: list[np.ndarray]) -> None:
    with pytest.raises(FileError, match=r"images .* are needed, found none"):
        open_frames(tmp_path)
    for f in range(3):
        Image.fromarray(images[f]).save(tmp_path / f"rgb_{f}.png")
        Image.fromarray(images[f]).save(tmp_path / f"mask_{f}.png")
    with pytest.raises(FileError, match=r"several series of images: .*rgb_\*\.png \(3\)"):
        open_frames(tmp_path)
    assert len(open_frames(tmp_path / "rgb_*.png")) == 3
    Image.fromarray(images[0][:50]).save(tmp_path / "rgb_2.png")
    with pytest.raises(FileError, match=r"one size are needed, 'rgb_2.png' has 120 x 50, the first has 120 x 90"):
        open_frames(tmp_path / "rgb_*.png")
    data = (tmp_path / "rgb_1.png").read_bytes()
    (tmp_path / "rgb_1.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileError, match=r"cannot read .*rgb_1.png' as an image"):
        open_frames(tmp_path / "rgb_*.png")


@pytest.mark.parametrize(("suffix", "lossless"), [(".mp4", False), (".mkv", False), (".avi", True)])
def test_a_truncated_file_is_refused_and_its_good_part_is_not(
    tmp_path: Path, images: list[np.ndarray], suffix: str, lossless: bool
) -> None:
    path = tmp_path / f"a{suffix}"
    noisy = np.random.default_rng(0).integers(-20, 20, (24, 90, 120, 3))
    write_video(path, [np.clip(i + n, 0, 255).astype(np.uint8) for i, n in zip(images, noisy, strict=True)],
                lossless=lossless)  # fmt: skip
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * 0.7)])
    with pytest.raises(FileError, match=r"truncated|as a video|damaged"):
        open_frames(path)
    if suffix != ".mp4":  # its index stands at the end
        assert len(open_frames(path, stop=5)) == 5


def test_damage_inside_is_found(tmp_path: Path, images: list[np.ndarray]) -> None:
    path = tmp_path / "a.mp4"
    write_video(path, images * 2, quality=5)
    data = bytearray(path.read_bytes())
    at = len(data) // 2
    data[at : at + 500] = np.random.default_rng(0).integers(0, 256, 500, dtype=np.uint8).tobytes()
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"damaged.*frame \d+"):
        open_frames(path)


def test_a_resolution_that_changes_is_named(tmp_path: Path, images: list[np.ndarray]) -> None:
    """Two raw H.264 streams one after the other: the second brings its own size."""
    import av

    parts = []
    for number, size in enumerate([(90, 120), (60, 80)]):
        path = tmp_path / f"{number}.h264"
        with av.open(str(path), "w", format="h264") as container:
            stream = container.add_stream("libx264", rate=30)
            stream.height, stream.width, stream.pix_fmt = *size, "yuv420p"
            for image in images[:6]:
                cut = np.ascontiguousarray(image[: size[0], : size[1]])
                container.mux(stream.encode(av.VideoFrame.from_ndarray(cut, format="rgb24")))
            container.mux(stream.encode(None))
        parts.append(path.read_bytes())
    both = tmp_path / "both.h264"
    both.write_bytes(parts[0] + parts[1])
    with pytest.raises(FileError, match="one resolution is needed, frame 6 has 80 x 60 after 120 x 90"):
        open_frames(both)
    raw = open_frames(tmp_path / "0.h264", cache_bytes=1)  # a stream without time stamps
    assert len(raw) == 6
    np.testing.assert_array_equal(raw[2], open_frames(tmp_path / "0.h264")[2])


def test_files_that_are_no_video(tmp_path: Path, video: Path, images: list[np.ndarray]) -> None:
    import av

    (tmp_path / "empty.mp4").touch()
    with pytest.raises(FileError, match="it is empty"):
        open_frames(tmp_path / "empty.mp4")
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(FileError, match=r"cannot read .*text.mp4' as a video"):
        open_frames(tmp_path / "text.mp4")
    with pytest.raises(FileError, match="there is no such file or folder"):
        open_frames(tmp_path / "nothing.mp4")
    with av.open(str(tmp_path / "sound.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.rate = 8000
        container.mux(stream.encode(sound))
    with pytest.raises(FileError, match="a video stream is needed, it holds audio"):
        open_frames(tmp_path / "sound.wav")
    write_video(tmp_path / "a.mp4", images)
    data = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "unknown.mp4").write_bytes(data.replace(b"avc1", b"zzz9"))
    with pytest.raises(FileError, match="no decoder for its video codec"):
        open_frames(tmp_path / "unknown.mp4")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": 24}, "start must be below the number of frames of .*, 24, received 24"),
        ({"stop": 25}, "stop must be at most the number of frames of .*, 24, received 25"),
        ({"start": 23}, "at least two frames are needed, .* the chosen range holds 1"),
        ({"stop": 1}, "at least two frames are needed"),
        ({"start": -1}, "start must be a whole number of at least 0, received -1"),
        ({"start": 4, "stop": 4}, "stop must be greater than start"),
        ({"stride": 0}, "stride must be a whole number of at least 1, received 0"),
        ({"resize": "big"}, "resize must be a longest side or WIDTHxHEIGHT"),
        ({"resize": (4, 100)}, "resize must be"),
    ],
)
def test_ranges_and_sizes_that_cannot_be(video: Path, options: dict, message: str) -> None:
    with pytest.raises(NrsfmError, match=message) as caught:
        open_frames(video, **options)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_written(tmp_path: Path, images: list[np.ndarray]) -> None:
    for name, given, options, message in (
        ("a.gif", images, {}, "must end in"),
        ("a.mp4", [], {}, "at least one is needed"),
        ("a.mp4", [images[0], images[1][:50]], {}, "image 1: 120 x 90 is needed"),
        ("a.mp4", [images[0].astype(float)], {}, "image 0: uint8"),
        ("a.mp4", images, {"codec": "h266x"}, "no 'h266x'"),
        ("a.avi", images, {"times": range(24)}, "constant frame rate"),
    ):
        with pytest.raises(InputError, match=message):
            write_video(tmp_path / name, given, **options)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
    with pytest.raises(OptionError, match="fps"):
        open_frames(tmp_path, fps=0)
