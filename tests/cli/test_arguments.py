from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.cli.arguments import Parser, add_options, flag_of, given_options
from nrsfm.errors import OptionError
from nrsfm.options import option


@dataclass(frozen=True)
class Options:
    max_rank: int | None = option(None, "Greatest rank in %.", symbol="K", minimum=1)
    step: float = option(0.5, "Step γ.", above=0)
    spatial: bool = option(True, "Use it.")
    start: str = option("rigid", "First guess.", choices=("rigid", "conic"))


def parser():
    made = Parser(prog="nrsfm verb")
    made.add_argument("file")
    made.add_argument("--out")
    add_options(made, "options of the method", Options)
    return made


def parsed(*words):
    return given_options(parser().parse_strictly(words))


PIECES = [
    ["a.npz"],
    ["--out", "d"],
    ["--max-rank", "3"],
    ["--step=-1e-3"],
    ["--no-spatial"],
    ["--start", "conic"],
]


@given(st.permutations(PIECES))
def test_arguments_may_come_in_any_order(pieces):
    words = [word for piece in pieces for word in piece]
    namespace = parser().parse_strictly(words)
    assert namespace.file == "a.npz"
    assert namespace.out == "d"
    assert given_options(namespace) == {"max_rank": 3, "step": -1e-3, "spatial": False, "start": "conic"}


def test_options_that_are_not_given_are_absent():
    assert parsed("a.npz") == {}


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_through_whatever_their_sign(value):
    assert parsed("a", "--step", repr(value)) == {"step": value}


def test_auto_means_none_where_that_is_allowed():
    assert parsed("a", "--max-rank", "auto") == {"max_rank": None}
    with pytest.raises(OptionError, match="a number is needed, received 'auto'"):
        parsed("a", "--step", "auto")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["a", "--max-rnk", "3"], "unknown option '--max-rnk'; did you mean '--max-rank'"),
        (["--max-rnk", "3"], "unknown option '--max-rnk'"),
        (["--stpe=3", "a"], "unknown option '--stpe'; did you mean '--step'"),
        (["a", "--max-r", "3"], "unknown option '--max-r'"),
        (["a", "-x"], "unknown option '-x'"),
        (["a", "b"], "unexpected argument 'b'"),
        (["--out", "d"], "required: file"),
        (["a", "--max-rank", "3.5"], "--max-rank: a whole number or auto is needed, received '3.5'"),
        (["a", "--out"], "expected one argument"),
    ],
)
def test_wrong_arguments_are_explained_in_one_line(words, text):
    with pytest.raises(OptionError, match=text) as caught:
        parser().parse_strictly(words)
    assert "\n" not in str(caught.value)


def test_help_shows_symbol_default_and_text():
    text = " ".join(parser().format_help().split())
    assert "options of the method:" in text
    assert "Greatest rank in %. [symbol K; default: auto]" in text
    assert "Step γ. [default: 0.5]" in text
    assert "--spatial, --no-spatial" in text
    assert "{rigid,conic}" in text


def test_a_flag_is_spelled_like_its_field():
    assert flag_of("max_rank") == "--max-rank"


@dataclass(frozen=True)
class ArrayOptions:
    faces: np.ndarray | None = option(None, "Mesh.")  # noqa: RUF009


def read_faces(*words):
    made = Parser(prog="nrsfm verb")
    add_options(made, "options of the method", ArrayOptions)
    return given_options(made.parse_strictly(words))["faces"]


def test_an_array_is_read_from_a_file(tmp_path):
    faces = np.array([[0, 1, 2], [1, 2, 3]])
    np.save(tmp_path / "alone.npy", faces)
    np.savez(tmp_path / "one.npz", triangles=faces)
    np.savez(tmp_path / "two.npz", faces=faces, other=faces + 1)
    for name in ("alone.npy", "one.npz", "two.npz"):
        np.testing.assert_array_equal(read_faces("--faces", str(tmp_path / name)), faces)
    assert read_faces("--faces", "auto") is None


def test_a_file_without_that_array_is_refused_in_one_line(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.zeros(3), b=np.zeros(4))
    with pytest.raises(OptionError, match=r"must hold an array 'faces', or one array only; it holds a .*, b"):
        read_faces("--faces", str(tmp_path / "two.npz"))
    with pytest.raises(OptionError, match="cannot read"):
        read_faces("--faces", str(tmp_path / "none.npy"))
