"""The closing lines of a run on real tracks: told from the diagnostics, and silent where these are."""

import dataclasses
from pathlib import Path

import pytest

from nrsfm.cli.summary import mirror_text, repair_text, summary


def test_what_was_missing_is_told(real_result):
    expected = "8 of 60 entries missing (13.3 %), 1 outlier (1.7 %), 1 of 10 points not reconstructed"
    assert repair_text(real_result) == expected
    lines = summary(real_result, None, {"repair": 0.1}, [], Path("out")).splitlines()
    assert f"tracks   {expected}" in lines
    assert "mirror   nose towards the camera" in lines
    assert "groups   2" in lines  # the label of the point without a shape is none


@pytest.mark.parametrize("diagnostics", [{}, {"repair": None}, {"repair": {}}, {"repair": "none", "mirror": None}])
def test_absent_diagnostics_are_tolerated(real_result, diagnostics):
    result = dataclasses.replace(real_result, diagnostics=diagnostics)
    assert repair_text(result) == "8 of 60 entries missing (13.3 %), 1 of 10 points not reconstructed"
    assert "mirror" not in summary(result, None, {}, [], Path("out"))
    plain = dataclasses.replace(result, confidence=None)
    assert repair_text(plain) == "1 of 10 points not reconstructed"


def test_clean_tracks_need_no_words(real_result):
    clean = dataclasses.replace(
        real_result,
        shapes=real_result.camera_shapes()[:, :9],
        groups=None,
        confidence=None,
        depth_deviation=None,
        diagnostics={"repair": {"missing": 0, "outliers": 0}},
    )
    assert repair_text(clean) == ""
    assert "tracks" not in summary(clean, None, {}, [], Path("out"))


@pytest.mark.parametrize(
    ("diagnostics", "text"),
    [
        ({}, ""),
        ({"mirror": "perspective"}, "perspective"),
        ({"mirror": {"rule": "perspective"}}, "perspective"),
        ({"mirror": {"rule": "convex", "decided": False}}, "convex, which does not decide here"),
        ({"cameras": {"known": False, "mirror": {"rule": "convex", "decided": True}}}, "convex"),
        ({"mirror": {"rule": "perspective"}, "cameras": {"mirror": {"rule": "convex"}}}, "perspective"),
        ({"cameras": {"known": True}}, ""),
        ({"mirror": {"flip": True}}, ""),
    ],
)
def test_the_mirror_rule_is_named(diagnostics, text):
    assert mirror_text(diagnostics) == text


@pytest.mark.parametrize(("missing", "text"), [(1, "< 0.1 %"), (59_999, "> 99.9 %"), (600, "1.0 %")])
def test_some_is_never_called_none_or_all(real_result, missing, text):
    import numpy as np

    shapes = np.zeros((6, 10_000, 3))
    result = dataclasses.replace(
        real_result,
        shapes=shapes,
        groups=None,
        confidence=None,
        depth_deviation=None,
        diagnostics={"repair": {"missing": missing}},
    )
    assert repair_text(result) == f"{missing} of 60000 entries missing ({text})"
