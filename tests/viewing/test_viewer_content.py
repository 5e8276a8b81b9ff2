"""What the page of the viewer is given, against the arrays and against nrsfm.metrics."""

import dataclasses
import json

import numpy as np
import pytest

from nrsfm import Reconstruction, Tracks
from nrsfm.errors import FileError, InputError
from nrsfm.metrics import frame_errors, point_errors
from nrsfm.viewing.viewer import make_content, open_pictures
from nrsfm.viewing.viewer.colours import STEPS, UNKNOWN, to_steps
from nrsfm.viewing.viewer.pictures import sample_colours

FRAMES, POINTS = 5, 60


def rotations(rng, count):
    q, r = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    q[np.linalg.det(q) < 0, :, 0] *= -1
    return q


@pytest.fixture
def result():
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(1, POINTS, 3)) * 40 + rng.normal(size=(FRAMES, POINTS, 3)) * 3
    return Reconstruction(
        shapes.astype(np.float32),
        rotations(rng, FRAMES),
        rng.normal(size=(FRAMES, 2)) + 100,
        np.linspace(0.8, 1.2, FRAMES),
        groups=np.arange(POINTS) % 4,
        diagnostics={
            "warnings": ["the noise is high"],
            "mirror": {"rule": "convex towards the camera", "decided": True},
        },
        method="auto",
    )


def without(result, lost):
    shapes = result.shapes.copy()
    shapes[:, lost] = np.nan
    return dataclasses.replace(result, shapes=shapes)


def read_frame(content, frame):
    count, rows = content.about["points"], content.about["rows"]
    data = content.frame_bytes(frame)
    padded = count + -count % 4
    assert len(data) == 8 * count + padded * len(rows)
    points = np.frombuffer(data, "<i2", 4 * count).reshape(count, 4)
    steps = {name: np.frombuffer(data, np.uint8, count, 8 * count + padded * k) for k, name in enumerate(rows)}
    return points, steps


def decoded(content, frame):
    points, _ = read_frame(content, frame)
    return points[:, :3] * (content.about["half"] / 32767) + content._centre


def test_points_come_back_to_the_stated_precision(result):
    content = make_content(result)
    for f in range(FRAMES):
        gap = np.abs(decoded(content, f) - result.shapes[f]).max()
        assert gap <= content.about["half"] / 65534 * 1.001


def test_lost_points_are_left_out_and_told(result):
    lost = [0, 7, 59]
    content = make_content(without(result, lost), faces=np.array([[0, 1, 2], [1, 2, 3], [57, 58, 56]]))
    kept = np.setdiff1d(np.arange(POINTS), lost)
    assert (content.about["points"], content.about["of"]) == (POINTS - 3, POINTS)
    assert np.abs(decoded(content, 2) - result.shapes[2, kept]).max() < content.about["half"] / 60000
    assert any("3 points were not reconstructed" in note["text"] for note in content.about["notes"])
    faces = np.frombuffer(content.faces_bytes(), "<u4").reshape(-1, 3)
    assert kept[faces].tolist() == [[1, 2, 3], [57, 58, 56]]


def test_what_is_said_is_plain_json_and_says_the_warnings(result):
    about = make_content(result, title="bücher & co").about
    assert json.loads(json.dumps(about, allow_nan=False)) == about
    texts = [note["text"] for note in about["notes"]]
    assert texts[0] == "The noise is high."
    assert any("mirror image" in text for text in texts)


def test_an_undecided_mirror_is_a_warning_once(result):
    mirror = {"rule": "convex towards the camera", "decided": False}
    undecided = dataclasses.replace(result, diagnostics={"mirror": mirror})
    found = [note for note in make_content(undecided).about["notes"] if "mirror" in note["text"]]
    assert [note["kind"] for note in found] == ["warning"]
    said = dataclasses.replace(
        result, diagnostics={"mirror": mirror, "warnings": ["which of the two mirror images is shown is arbitrary"]}
    )
    assert len([note for note in make_content(said).about["notes"] if "mirror" in note["text"]]) == 1


def test_steps_end_where_the_scale_ends_and_keep_the_unknown_apart():
    values = np.array([0.0, 1.0, 2.0, 3.0, -1.0, np.nan])
    assert to_steps(values, 0.0, 2.0).tolist() == [0, STEPS // 2, STEPS, STEPS, 0, UNKNOWN]


@pytest.mark.parametrize("factor", [1.0, 0.01])
def test_errors_are_those_of_the_metrics(result, factor):
    rng = np.random.default_rng(1)
    # Another frame in each frame, mirrored in one: alignment must undo it.
    turns = rotations(rng, FRAMES) * np.array([1, 1, -1, 1, 1])[:, None, None]
    truth = factor * (result.shapes + rng.normal(size=result.shapes.shape)) @ turns + 7.0
    content = make_content(result, truth=truth)
    align = "per-frame" if factor == 1.0 else "similarity"
    expected, legend = point_errors(result, truth, align), legend_of(content, "error")
    assert content.about["errors"] == pytest.approx(frame_errors(result, truth, align).tolist(), rel=1e-5)
    for f in range(FRAMES):
        steps = read_frame(content, f)[1]["error"]
        assert (
            np.abs(steps / STEPS * legend["high"] - np.minimum(expected[f], legend["high"])).max()
            < legend["high"] / 500
        )


def legend_of(content, name):
    return next(entry for entry in content.about["colours"] if entry["name"] == name)


def test_truth_that_is_not_known_is_marked(result):
    valid = np.ones((FRAMES, POINTS), dtype=bool)
    valid[1, :10] = False
    truth = np.where(valid[..., None], result.shapes, np.nan)
    content = make_content(result, truth=truth, valid=valid)
    assert (read_frame(content, 1)[1]["error"] == UNKNOWN).tolist() == (~valid[1]).tolist()
    assert legend_of(content, "error")["unknown"]


def test_confidence_and_deviation_are_rows(result):
    rng = np.random.default_rng(2)
    confidence = rng.random((FRAMES, POINTS)).astype(np.float32)
    deviation = rng.random((FRAMES, POINTS)).astype(np.float32)
    content = make_content(dataclasses.replace(result, confidence=confidence, depth_deviation=deviation))
    steps = read_frame(content, 3)[1]
    assert np.abs(steps["confidence"] / STEPS - confidence[3]).max() < 0.5 / STEPS + 1e-6
    high = legend_of(content, "deviation")["high"]
    assert np.abs(steps["deviation"] / STEPS * high - np.minimum(deviation[3], high)).max() < high / STEPS


def test_what_is_missing_says_what_it_needs(result):
    content = make_content(result)
    assert legend_of(content, "error")["missing"] == "needs --truth"
    assert not legend_of(content, "groups")["missing"]
    assert content.colours_bytes("texture") is None
    assert content.faces_bytes() is None


def test_groups_have_one_colour_each(result):
    colours = np.frombuffer(make_content(result).colours_bytes("groups"), np.uint8).reshape(-1, 4)
    for label in range(4):
        assert len(np.unique(colours[result.groups == label], axis=0)) == 1
    assert len(np.unique(colours, axis=0)) == 4


def test_tracks_are_measured_or_projected(result):
    seen = np.random.default_rng(3).random((FRAMES, POINTS)) < 0.7
    points = np.where(seen[..., None], result.project(), np.nan)
    content = make_content(result, tracks=Tracks(points, seen))
    drawn = np.frombuffer(content.tracks_bytes(), "<f4").reshape(FRAMES, -1, 3)
    assert content.about["tracks"]["measured"]
    assert np.isnan(drawn[..., 0]).mean() == pytest.approx(1 - seen.mean(), abs=1e-9)
    assert not np.isnan(np.frombuffer(make_content(result).tracks_bytes(), "<f4")).any()


def test_orthographic_cameras_look_at_the_object_from_one_distance(result):
    about = make_content(result).about
    places = np.array(about["cameras"]["places"]).reshape(-1, 3) - about["middle"]
    distances = np.linalg.norm(places, axis=1)
    assert np.ptp(distances) < 1e-4 * distances[0]
    assert np.allclose(places / distances[:, None], -result.rotations[:, 2], atol=1e-4)


def test_sizes_that_do_not_fit_are_refused(result):
    with pytest.raises(InputError, match="5 frames of 60 points are needed"):
        make_content(result, truth=result.shapes[:, :50])
    with pytest.raises(InputError, match="received 4 frames of 60"):
        make_content(result, tracks=Tracks(result.project()[:4]))


@pytest.mark.parametrize("shapes", [np.zeros((3, 4, 3)), np.random.default_rng(0).normal(size=(1, 4, 3))])
def test_the_least_there_can_be_is_shown(shapes):
    frames = len(shapes)
    result = Reconstruction(shapes, np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 2)), np.ones(frames))
    content = make_content(result, truth=np.full(shapes.shape, np.nan), valid=np.zeros(shapes.shape[:2], dtype=bool))
    json.dumps(content.about, allow_nan=False)
    assert np.allclose(decoded(content, frames - 1), shapes[-1], atol=1e-4)
    assert content.about["errors"] == [None] * frames


def write_images(folder, count, size=(40, 30), names="frame {}.png"):
    from PIL import Image

    folder.mkdir(exist_ok=True)
    for k in range(count):
        picture = np.zeros((size[1], size[0], 3), np.uint8)
        picture[..., 0] = np.arange(size[0]) * 5
        picture[..., 1] = np.arange(size[1])[:, None] * 7
        picture[..., 2] = k * 10
        Image.fromarray(picture).save(folder / names.format(k + 1))


def test_a_folder_of_images_is_read_in_the_order_of_its_numbers(tmp_path):
    folder = tmp_path / "bilder é ü"
    write_images(folder, 12)
    pictures = open_pictures(folder, 12)
    assert (pictures.width, pictures.height) == (40, 30)
    blue = [float(pictures.array(f)[..., 2].mean()) for f in range(12)]
    assert blue == pytest.approx([10.0 * k for k in range(12)], abs=4)  # JPEG; frame 10 after frame 9


def test_texture_is_the_input_at_the_points(tmp_path):
    write_images(tmp_path / "a", 3)
    pictures = open_pictures(tmp_path / "a", 3)
    seen = np.array([[[10.0, 20.0], [30.2, 4.9], [np.nan, 1.0]]] * 3)
    trusted = np.array([[True, True, False]] * 3)
    colours = sample_colours(pictures, seen, trusted, np.arange(3))
    assert np.abs(colours[:2].astype(int) - [[50, 140, 10], [150, 35, 10]]).max() <= 12  # JPEG


def test_images_that_do_not_fit_are_refused_in_one_line(tmp_path):
    from PIL import Image

    write_images(tmp_path / "a", 3)
    with pytest.raises(FileError, match="has 3 images, the reconstruction 5 frames"):
        open_pictures(tmp_path / "a", 5)
    Image.new("RGB", (20, 20)).save(tmp_path / "a" / "frame 2.png")
    with pytest.raises(FileError, match="images of one size are needed"):
        open_pictures(tmp_path / "a", 3)
    (tmp_path / "a" / "frame 2.png").write_bytes(b"no picture")
    with pytest.raises(FileError, match="is not an image"):
        open_pictures(tmp_path / "a", 3)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="found none"):
        open_pictures(tmp_path / "empty", 3)
    with pytest.raises(FileError, match="no such file"):
        open_pictures(tmp_path / "nowhere", 3)


def write_video(path, count, size=(64, 48)):
    av = pytest.importorskip("av", reason="PyAV ABSENT: videos are not tested")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for k in range(count):
            picture = np.full((size[1], size[0], 3), 20 * k, np.uint8)
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


def test_a_video_is_read(tmp_path):
    path = tmp_path / "film é.mp4"
    write_video(path, 6)
    pictures = open_pictures(path, 6)
    assert (pictures.count, pictures.width, pictures.height) == (6, 64, 48)
    levels = [float(pictures.array(f).mean()) for f in range(6)]
    assert levels == pytest.approx([20.0 * k for k in range(6)], abs=8)
    for frames, words in ((9, "has 6 frames"), (4, "more than 4 frames")):
        with pytest.raises(FileError, match=words):
            open_pictures(path, frames)


def test_what_is_no_video_is_refused(tmp_path):
    pytest.importorskip("av", reason="PyAV ABSENT: videos are not tested")
    path = tmp_path / "film.mp4"
    path.write_bytes(b"this is no film" * 20)
    with pytest.raises(FileError, match=r"film\.mp4"):
        open_pictures(path, 3)
