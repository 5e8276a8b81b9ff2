"""The page of a report: what it says, and that nothing can get in or out."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from nrsfm import Reconstruction, Tracks
from nrsfm.errors import FileError, InputError
from nrsfm.viewing.report import Sources, make_report, measures, read_run, write_report
from nrsfm.viewing.report.charts import Line, line_chart
from nrsfm.viewing.report.markup import el, escape, number, percent, relative
from nrsfm.viewing.report.sections import folded

HEADINGS = ("shape", "input", "choices", "convergence", "fit", "sides", "truth", "uncertainty", "repeat")


def run_of(result, folder, **config):
    folder.mkdir(parents=True)
    result.save(folder / "reconstruction.npz")
    if config:
        (folder / "config.json").write_text(json.dumps(config), encoding="utf-8")
    return read_run(folder)


@pytest.fixture(scope="module")
def full(cases, tmp_path_factory):
    """A run with everything: groups, uncertainty, doubted measurements, warnings, truth and tracks."""
    case = cases["mesh"]
    frames, points = case.result.shapes.shape[:2]
    confidence = np.ones((frames, points), dtype=np.float32)
    confidence[2, :40] = 0.0
    result = Reconstruction(
        case.result.shapes,
        case.result.rotations,
        case.result.translations,
        case.result.scales,
        groups=case.result.groups,
        method="bmm",
        confidence=confidence,
        depth_deviation=np.linspace(1.0, 3.0, frames * points, dtype=np.float32).reshape(frames, points),
        diagnostics={
            **case.result.diagnostics,
            "iterations": 3,
            "stop_reason": "gap",
            "noise": 0.5,
            "cameras": {"rank": 3, "turn": 61.0, "candidates": [{"K": 2, "cost": 1.0}, {"K": 3, "chosen": True}]},
            "mirror": {"rule": "convex towards the camera", "decided": False},
            "repair": {"missing": 0, "outliers": 40, "outlier_points": 40, "ladder": [[1, 2.0, 1.0], [2, 1.0, 0.5]]},
            "perspective": {"undone": False, "reason": "the affine model explains the tracks as well"},
            "compression": {"points": 900, "virtual_points": 60, "cells": 5, "discarded": 1e-4},
            "seconds": {"cameras": 1.0, "shapes": 3.0},
            "warnings": ["1% of the entries were taken for outliers and replaced"],
        },
    )
    run = run_of(
        result,
        tmp_path_factory.mktemp("runs") / "müde <b>Löwen & Co",
        command="nrsfm reconstruct 'a b.npz' --out x",
        tracks={"path": "a b.npz", "sha256": "0" * 64},
        options={"rank": None},
    )
    sources = Sources(tracks=Tracks(case.tracks), truth=case.truth, faces=case.faces, surface="a mesh", unit="px")
    return run, sources, make_report(run, sources)


def test_it_says_everything_that_is_known(full):
    text = full[2]
    for name in HEADINGS:
        assert f'<h2 id="{name}">' in text, name
        assert f'href="#{name}"' in text, name
    for words in (
        "the constraints were met", "61°", "Arbitrary", "Candidates compared", "15 times fewer points",
        "taken for outliers and replaced.", "--no-outliers", "not believed", "explains the tracks as well",
        "nrsfm reconstruct &#x27;a b.npz&#x27; --out x", "makes 0.707 px of it",
    ):  # fmt: skip
        assert words in text, words
    assert len(re.findall(r"from above", text)) >= 3


def test_pages_are_well_formed_and_the_same_each_time(full):
    run, sources, text = full
    assert make_report(run, sources) == make_report(run, sources)
    Balance().feed(text)


class Balance(HTMLParser):
    """Fails where elements do not close in the order in which they opened."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "link", "img", "br", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_names_cannot_become_markup(full, cases, tmp_path):
    assert "<b>Löwen" not in full[2]
    assert "müde &lt;b&gt;Löwen &amp; Co" in full[2]
    hostile = "</script><script>alert(1)</script>"
    result = cases["tiny"].result
    diagnostics = {"warnings": [hostile], "history": {hostile: [1.0, 2.0]}, "stop_reason": hostile}
    bad = Reconstruction(
        result.shapes, result.rotations, result.translations, result.scales, method=hostile, diagnostics=diagnostics
    )
    run = run_of(bad, tmp_path / "r", command=hostile, options={hostile: hostile}, versions={"nrsfm": hostile})
    text = make_report(run, Sources(unit=hostile, missing_tracks=hostile), title=hostile)
    assert "<script>alert" not in text
    assert text.count("<script") == 4  # two of data, two that run
    Balance().feed(text)


def test_the_policy_allows_our_scripts_and_style_and_nothing_else(full):
    text = full[2]
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1].replace("&#x27;", "'")
    assert policy.startswith("default-src 'none'; img-src data:; ")
    assert "unsafe" not in policy
    assert "http" not in policy
    for name in ("script", "style"):
        parts = re.findall(rf"<{name}>(.*?)</{name}>", text, re.DOTALL)
        digests = [base64.b64encode(hashlib.sha256(part.encode()).digest()).decode() for part in parts]
        allowed = re.search(rf"{name}-src ([^;]*)", policy)[1]
        assert allowed == " ".join(f"'sha256-{digest}'" for digest in digests)
    addresses = re.findall(r'(?:src|href|poster|action)="(?!#)([^"]{5})', text)
    assert set(addresses) == {"data:"}


@pytest.mark.parametrize("name", ["points", "sparse", "skeleton", "tiny", "two frames"])
def test_bare_reconstructions_have_a_page(cases, tmp_path, name):
    case = cases[name]
    result = Reconstruction(case.result.shapes, case.result.rotations, case.result.translations, case.result.scales)
    text = make_report(run_of(result, tmp_path / name), Sources(edges=case.edges, missing_tracks="No tracks."))
    Balance().feed(text)
    assert "No tracks." in text
    assert '<h2 id="truth">' not in text
    assert "made from Python" in text
    assert "No warnings." in text


def test_one_frame_and_rigid_shapes(cases, tmp_path):
    result = cases["sparse"].result
    rigid = Reconstruction(
        np.repeat(result.shapes[:1], 4, axis=0), result.rotations[:4], result.translations[:4], result.scales[:4]
    )
    assert "Rigid" in make_report(run_of(rigid, tmp_path / "rigid"))
    one = Reconstruction(result.shapes[:1], result.rotations[:1], result.translations[:1], result.scales[:1])
    Balance().feed(make_report(run_of(one, tmp_path / "one")))


def test_the_fit_is_that_of_the_measurements_that_were_believed(full):
    run, sources, _ = full
    fit = measures.fit_over_frames(run.result, sources.tracks)
    gaps = np.linalg.norm(run.result.project() - sources.tracks.points, axis=2)
    gaps[run.result.confidence < 0.5] = np.nan
    np.testing.assert_allclose(fit.rms, np.sqrt(np.nanmean(gaps**2, axis=1)), rtol=1e-5)
    np.testing.assert_allclose(fit.median, np.nanmedian(gaps, axis=1), rtol=1e-4)
    assert fit.overall == pytest.approx(np.sqrt(np.nanmean(gaps**2)), rel=1e-5)
    assert (fit.entries, fit.left_out) == (gaps.size - 40, 40)


def test_deformation_counts_its_directions():
    rng = np.random.default_rng(0)
    base, ways = rng.normal(size=(1, 50, 3)), rng.normal(size=(3, 50, 3))
    ways -= ways.mean(axis=1, keepdims=True)
    weights = np.linalg.qr(rng.normal(size=(20, 4)) - 0.0)[0][:, :3]
    weights -= weights.mean(axis=0)
    shapes = base + np.einsum("fk,kpd->fpd", weights, ways)
    found = measures.deformation(Reconstruction(shapes, np.tile(np.eye(3), (20, 1, 1)), np.zeros((20, 2)), np.ones(20)))
    assert found.modes[2] == 3
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    moved = centred - centred.mean(axis=0)
    assert found.relative == pytest.approx(np.linalg.norm(moved) / np.linalg.norm(centred), rel=1e-6)


def test_sources_of_another_size_are_refused(full):
    run, sources, _ = full
    with pytest.raises(InputError, match="received 4 frames"):
        make_report(run, Sources(tracks=Tracks(sources.tracks.points[:4])))
    with pytest.raises(InputError, match="received 5 frames of 899 points"):
        make_report(run, Sources(truth=sources.truth[:, 1:]))


@pytest.mark.parametrize(
    "values",
    [[1.0], [2.0, 2.0, 2.0], [np.nan, np.nan], [0.0, 0.0], [1e-9, 1.0, 1e9], [-5.0, -3.0], [np.nan, 1.0, np.nan, 2.0]],
)
def test_charts_stay_inside_their_frame(values):
    text = str(line_chart([Line(np.array(values))], label="x", x_name="frame"))
    Balance().feed(text)
    assert "nan" not in text
    assert "inf" not in text
    for points in re.findall(r'points="([^"]*)"', text):
        xy = np.array([pair.split(",") for pair in points.split()], dtype=float)
        assert (xy >= 0).all()
        assert (xy <= (480, 236)).all()


def test_labels_of_a_logarithmic_scale_reach_both_ends():
    text = str(line_chart([Line(np.array([3e-8, 40.0]))], label="x", x_name="iteration"))
    heights = [float(y) for y in re.findall(r'y1="([\d.]+)"', text)]
    assert (min(heights), max(heights)) == (14.0, 190.0)


def test_numbers_as_they_are_read():
    assert [number(v) for v in (0, 1234.5, -0.25, 1e-7, 2.5e7)] == [
        "0", "1,234", "−0.25", "10⁻⁷", "2.5\u202f·\u202f10⁷",
    ]  # fmt: skip
    assert number(float("nan")) == number(None) == "–"
    assert [percent(v).replace("\xa0", " ") for v in (0, 1e-5, 0.5, 0.9999, 1)] == [
        "0.0 %", "< 0.1 %", "50.0 %", "> 99.9 %", "100.0 %",
    ]  # fmt: skip
    assert relative(0.0137).replace("\xa0", " ") == "1.37 %"
    assert escape("<&\"'\0\ud800") == "&lt;&amp;&quot;&#x27;\ufffd\ufffd"
    assert el("p", "<", el("b", "x"), None, class_="a", hidden=False) == '<p class="a">&lt;<b>x</b></p>'


def test_a_folded_command_is_the_same_command():
    import shlex

    command = "nrsfm reconstruct 'a b.npz' --out \"d'e\" --truth /a/rather/long/path/to/a/file.npz --method grassmann"
    shown = folded(command)
    assert len(shown.splitlines()) > 2
    assert shlex.split(shown.replace("\\\n", "")) == shlex.split(command)


def test_folders_that_are_no_runs_are_refused(tmp_path, cases):
    for path, words in ((tmp_path / "none", "no such folder"), (tmp_path, "holds reconstruction.npz")):
        with pytest.raises(FileError, match=words):
            read_run(path)
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(FileError, match="received a file"):
        read_run(file)
    run_of(cases["tiny"].result, tmp_path / "run")
    (tmp_path / "run" / "config.json").write_text("{")
    with pytest.raises(FileError, match="damaged"):
        read_run(tmp_path / "run")


def test_writing_keeps_what_is_there(tmp_path):
    place = tmp_path / "neu é" / "r.html"
    assert write_report("ä", place) == 2
    with pytest.raises(FileError, match="exists"):
        write_report("b", place)
    assert place.read_text(encoding="utf-8") == "ä"
    write_report("b", place, overwrite=True)
    assert place.read_text() == "b"
    with pytest.raises(FileError, match=r"must end in \.html"):
        write_report("b", tmp_path / "r.txt")
