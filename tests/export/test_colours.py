import dataclasses

import numpy as np
import pytest
from PIL import Image

from nrsfm.errors import FileError, InputError, OptionError
from nrsfm.export.colours import group_colours, image_array, linear, point_colours, read_image


def ramp(height=480, width=640):
    """Red counts columns and green counts rows, a quarter of each, so that a colour tells its place."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x // 4, y // 4, np.full_like(x, 7)], axis=2).astype(np.uint8)


def test_the_image_is_sampled_where_the_reference_frame_sees_each_point(result):
    for reference in (0, 5):
        colours = point_colours("image", result, reference, ramp())
        places = result.project()[reference]
        np.testing.assert_allclose(colours[:, :2], places / 4, atol=1.01)
        assert (colours[:, 2] == 7).all()


def test_whole_coordinates_are_centres_of_pixels(result):
    image = np.random.default_rng(0).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    shape = np.zeros((1, 48, 3))
    shape[0, :, 0], shape[0, :, 1] = np.arange(48), np.arange(48) % 40
    flat = dataclasses.replace(
        result,
        shapes=shape,
        rotations=np.eye(3)[None],
        translations=np.zeros((1, 2)),
        scales=np.ones(1),
        confidence=None,
        depth_deviation=None,
    )
    found = point_colours("image", flat, 0, image)
    np.testing.assert_array_equal(found, image[np.arange(48) % 40, np.arange(48)])


def test_beyond_the_image_the_border_goes_on(result):
    found = point_colours("image", result, 0, np.full((1, 1, 3), 99, dtype=np.uint8))
    assert (found == 99).all()


def test_every_source_gives_a_colour_to_every_point(holed):
    for source in ("image", "groups", "confidence", "depth", "#102030"):
        found = point_colours(source, holed, 2, ramp())
        assert (found.shape, found.dtype) == ((48, 3), np.uint8)
    assert point_colours(None, holed, 0, None) is None
    array = np.random.default_rng(0).integers(0, 256, (48, 4), dtype=np.uint8)
    np.testing.assert_array_equal(point_colours(array, holed, 0, None), array[:, :3])
    np.testing.assert_allclose(point_colours(array[:, :3] / 255, holed, 0, None), array[:, :3])


def test_groups_differ_and_none_is_grey():
    found = group_colours(np.arange(-1, 20))
    assert found[0].tolist() == [128, 128, 128]
    assert len({tuple(colour) for colour in found.tolist()}) == 21


def test_near_is_lighter_than_far(result):
    found = point_colours("depth", result, 3, None).astype(int).sum(axis=1)
    depth = result.camera_depths()[3]
    assert found[np.argmin(depth)] > found[np.argmax(depth)]


def test_light_follows_the_curve_of_srgb():
    assert linear(np.array([0, 255], dtype=np.uint8)).tolist() == [0.0, 1.0]
    assert linear(np.array([188], dtype=np.uint8))[0] == pytest.approx(0.5029, abs=1e-3)  # IEC 61966-2-1


@pytest.mark.parametrize(
    ("source", "error", "text"),
    [
        ("image", OptionError, "image of the reference frame is needed"),
        ("grups", OptionError, "did you mean 'groups'"),
        ("#12345", OptionError, "#rrggbb"),
        (np.zeros((3, 3), dtype=np.uint8), InputError, r"shape \(48, 3\)"),
        (np.full((48, 3), 2.0), InputError, "from 0 to 1"),
        (np.full((48, 3), np.nan), InputError, "from 0 to 1"),
        (np.zeros((48, 3), dtype=int), InputError, "uint8"),
    ],
)
def test_colours_that_cannot_be_are_explained(result, source, error, text):
    with pytest.raises(error, match=text):
        point_colours(source, result, 0, None)


@pytest.mark.parametrize("name", ["groups", "confidence"])
def test_what_the_reconstruction_lacks_is_said(result, name):
    with pytest.raises(InputError, match=f"colours '{name}': the reconstruction has none"):
        point_colours(name, dataclasses.replace(result, **{name: None}), 0, None)


def test_pictures_are_read_and_others_refused(tmp_path):
    Image.fromarray(ramp(6, 8)).save(tmp_path / "bild ü.png")
    np.testing.assert_array_equal(read_image(tmp_path / "bild ü.png"), ramp(6, 8))
    Image.fromarray(ramp(6, 8)[..., 0]).save(tmp_path / "grey.png")
    assert read_image(tmp_path / "grey.png").shape == (6, 8, 3)
    (tmp_path / "text.png").write_text("no picture")
    for name, text in (("text.png", "not a picture"), ("none.png", "No such file")):
        with pytest.raises(FileError, match=text):
            read_image(tmp_path / name)
    with pytest.raises(InputError, match="uint8"):
        image_array(np.zeros((4, 4, 3)))
    assert image_array(np.zeros((4, 5), dtype=np.uint8)).shape == (4, 5, 3)
