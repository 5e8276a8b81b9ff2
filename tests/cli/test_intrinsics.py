"""``--intrinsics``: four numbers, or a file."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.cli.arguments import Parser, add_options, given_options
from nrsfm.errors import OptionError
from nrsfm.options import option

K = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
FOUR = np.array([800.0, 810, 320, 240])


@dataclass(frozen=True)
class Options:
    intrinsics: np.ndarray | None = option(None, "Camera matrix.")  # noqa: RUF009


def parser():
    made = Parser(prog="nrsfm verb")
    add_options(made, "options of the run", Options)
    return made


def read(text):
    return given_options(parser().parse_strictly(["--intrinsics", str(text)]))["intrinsics"]


focal = st.floats(1e-3, 1e6)
centre = st.floats(-1e6, 1e6)


@given(focal, focal, centre, centre)
def test_four_numbers_are_the_matrix(fx, fy, cx, cy):
    found = read(f"{fx!r},{fy!r}, {cx!r},{cy!r}")
    np.testing.assert_array_equal(found, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    assert found.dtype == np.float64


def test_auto_is_none_and_the_help_says_both_forms():
    assert read("auto") is None
    assert "--intrinsics FX,FY,CX,CY or FILE" in " ".join(parser().format_help().split())


@pytest.mark.parametrize("array", [K, K.astype(np.float32), K.astype(int), FOUR, FOUR[None], FOUR[:, None]])
def test_a_file_holds_the_matrix_or_the_four_numbers(tmp_path, array):
    np.save(tmp_path / "k.npy", array)
    np.savetxt(tmp_path / "k.txt", np.atleast_2d(array))
    np.savez(tmp_path / "one.npz", camera=array)
    np.savez(tmp_path / "k.npz", K=array, tracks=np.zeros((3, 4, 2)))
    np.savez(tmp_path / "both.npz", K=np.zeros(3), intrinsics=array)
    for name in ("k.npy", "k.txt", "one.npz", "k.npz", "both.npz"):
        np.testing.assert_array_equal(read(tmp_path / name), K)


def test_a_file_with_commas_in_its_name(tmp_path):
    np.save(tmp_path / "1,2,a.npy", K)
    np.testing.assert_array_equal(read(tmp_path / "1,2,a.npy"), K)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("800,800,320", "finite fx,fy,cx,cy with positive fx and fy"),
        ("800", "finite fx,fy,cx,cy with positive fx and fy"),
        ("800,-1,0,0", "positive fx and fy.* received '800,-1,0,0'"),
        ("800,nan,0,0", "finite fx,fy"),
        ("800,800,320,x", r"cannot read '800,800,320,x'.* \(or type fx,fy,cx,cy: four numbers\)"),
        ("none.npy", "cannot read 'none.npy': No such file"),
    ],
)
def test_wrong_words_are_explained_in_one_line(text, words):
    with pytest.raises(OptionError, match=words) as caught:
        read(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "array",
    [np.eye(4), np.zeros((3, 3)), K.T, 2 * K, np.full((3, 3), np.nan), K.astype(complex), K > 0, np.stack([K, K])],
)
def test_other_arrays_are_refused(tmp_path, array):
    np.save(tmp_path / "k.npy", array)
    with pytest.raises(OptionError, match=r"--intrinsics: .* are needed, received '.*k\.npy' with "):
        read(tmp_path / "k.npy")


def test_a_file_of_several_arrays_must_name_it(tmp_path):
    np.savez(tmp_path / "two.npz", a=K, b=K)
    with pytest.raises(OptionError, match="must hold an array 'K' or 'intrinsics', or one array only; it holds a "):
        read(tmp_path / "two.npz")
