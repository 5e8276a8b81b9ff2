"""Options: every declared rule is kept, every error names the option, the rule and the value."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.errors import InputError, NrsfmError, OptionError, suggest
from nrsfm.methods import get_method, method_names
from nrsfm.options import build_options, field_types, option, split_options
from nrsfm.pipeline import STAGE_OPTIONS


@dataclasses.dataclass(frozen=True)
class Sample:
    count: int = option(3, "A count.", minimum=1, maximum=9)
    weight: float = option(0.5, "A weight.", symbol="λ", above=0)
    maybe: int | None = option(None, "Perhaps.", minimum=2)
    flag: bool = option(True, "A flag.")
    word: str = option("one", "A word.", choices=("one", "two", "three"))


def test_defaults_and_good_values():
    assert build_options(Sample, {}) == Sample()
    built = build_options(Sample, {"count": np.int64(9), "weight": np.float32(2), "maybe": None, "flag": np.bool_(0)})
    assert built == Sample(9, 2.0, None, False, "one")
    assert [type(v) for v in dataclasses.astuple(built)] == [int, float, type(None), bool, str]
    assert build_options(Sample, {"weight": 1}).weight == 1.0


@given(st.integers(-(10**20), 10**20))
def test_bounds_are_inclusive(value):
    if 1 <= value <= 9:
        assert build_options(Sample, {"count": value}).count == value
    else:
        with pytest.raises(OptionError, match="'count' must be at"):
            build_options(Sample, {"count": value})


@given(st.floats())
def test_above_is_exclusive(value):
    if 0 < value < np.inf:
        assert build_options(Sample, {"weight": value}).weight == value
    else:
        with pytest.raises(OptionError, match="'weight' must be"):
            build_options(Sample, {"weight": value})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("count", 2.0, "whole number, received 2.0"),
        ("count", True, "whole number, received True"),
        ("count", "3", "whole number, received '3'"),
        ("count", None, "received None"),
        ("count", 10, "at most 9, received 10"),
        ("count", 0, "at least 1, received 0"),
        ("weight", 0.0, "greater than 0, received 0.0"),
        ("weight", float("nan"), "a finite number, received nan"),
        ("weight", float("inf"), "a finite number, received inf"),
        ("weight", 10**400, "a finite number"),
        ("weight", True, "a finite number, received True"),
        ("weight", 1j, "a finite number, received 1j"),
        ("weight", [1.0], "a finite number"),
        ("maybe", 1, "at least 2, received 1"),
        ("flag", 1, "true or false, received 1"),
        ("flag", "yes", "true or false, received 'yes'"),
        ("word", "tow", "one of one, two, three, received 'tow'; did you mean 'two'"),
        ("word", 2, "a word, received 2"),
        ("word", None, "received None"),
    ],
)
def test_bad_values_name_option_rule_and_value(name, value, text):
    with pytest.raises(OptionError) as caught:
        build_options(Sample, {name: value})
    message = str(caught.value)
    assert f"'{name}'" in message
    assert text in message
    assert "\n" not in message
    assert isinstance(caught.value, (NrsfmError, InputError, ValueError))


def test_field_types():
    assert field_types(Sample) == {
        "count": (int, False),
        "weight": (float, False),
        "maybe": (int, True),
        "flag": (bool, False),
        "word": (str, False),
    }


def test_split_hands_each_name_to_its_class():
    @dataclasses.dataclass(frozen=True)
    class Other:
        depth: int = option(1, "A depth.")

    sample, other = split_options((Sample, Other), {"depth": 4, "count": 2}, "test")
    assert sample == Sample(count=2)
    assert other == Other(4)
    with pytest.raises(OptionError, match=r"'cuont' is not an option of test; did you mean 'count'"):
        split_options((Sample, Other), {"cuont": 4}, "test")
    with pytest.raises(OptionError, match=r"'zzz' is not an option of test$"):
        split_options((Sample, Other), {"zzz": 4}, "test")


def test_suggestions():
    assert suggest("grasmann", ["grassmann", "bmm"]) == "; did you mean 'grassmann'?"
    assert suggest("xyz", ["grassmann"]) == ""


ALL = list(STAGE_OPTIONS.values()) + [get_method(n).Options for n in method_names()]


@pytest.mark.parametrize("options", ALL)
def test_every_option_of_the_package_is_documented_and_its_default_is_allowed(options):
    kinds = field_types(options)
    for field in dataclasses.fields(options):
        assert field.metadata["doc"].endswith(".")
        default = field.default
        assert kinds[field.name][0] in (int, float, bool, str, np.ndarray)
        assert getattr(build_options(options, {field.name: default}), field.name) == default
        assert field.metadata["choices"] is None or default is None or default in field.metadata["choices"]
    assert dataclasses.is_dataclass(options)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(options(), dataclasses.fields(options)[0].name, 1)


@pytest.mark.parametrize("method", method_names())
def test_no_name_is_declared_twice(method):
    """One keyword of ``reconstruct`` belongs to one options class."""
    classes = (*STAGE_OPTIONS.values(), get_method(method).Options)
    names = [f.name for c in classes for f in dataclasses.fields(c)]
    assert len(names) == len(set(names))
    assert not {"tracks", "method", "rotations", "seed", "progress"} & set(names)
