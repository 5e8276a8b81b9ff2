"""Outputs of an experiment and the pages of all of them, with a made-up experiment that computes nothing."""

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nrsfm.errors import InputError, OptionError
from nrsfm.experiments import about, experiment_names, get_experiment, markdown, page, report
from nrsfm.experiments.base import Cell, Data, Finding, Picture, Scope
from nrsfm.experiments.kept import Store
from nrsfm.experiments.report import Settings

CELLS = [Cell(Data("built-in-face1"), "bmm"), Cell(Data("built-in-face2", noise=0.1), "bmm")]
RECORDS = {CELLS[0].key: {"value": 1.0}, CELLS[1].key: {"error": "a | b"}}


class Made:
    name = "made"
    title = "A made-up experiment"
    question = "Is 1 < 2?"

    def cells(self, scope):
        return [*CELLS, CELLS[0]]

    def rows(self, cells, records):
        return [{"key": c.key, **records[c.key]} for c in cells]

    def pictures(self, rows):
        from nrsfm.viewing.style import new_figure

        return [Picture("made", new_figure(2.0, "One"), "The first."), Picture("made-two", new_figure(2.0, "Two"))]

    def findings(self, rows):
        return [Finding("Yes.", "reproduced", "1 < 2."), Finding("No.", "not reproduced", "2 > 1.")]

    def table(self, rows):
        return [*markdown.table(["", "n"], [["`x`", "1"]]), *markdown.folded("more", ["**bold** & *slanted*"])]


@pytest.fixture
def outcome(tmp_path):
    settings = Settings(tmp_path / "out", quick=True)
    store = Store(settings.out / "cells", None)
    cells = report.plan(Made(), Scope(True, ("built-in-face1",)))
    return report.write(Made(), cells, RECORDS, settings, store), settings


def test_an_experiment_writes_table_configuration_and_pictures(outcome):
    found, settings = outcome
    names = sorted(path.name for path in settings.out.iterdir())
    assert names == ["made-two.png", "made-two.svg", "made.csv", "made.json", "made.png", "made.svg"]
    rows = list(csv.DictReader(io.StringIO((settings.out / "made.csv").read_text())))
    assert [row["value"] for row in rows] == ["1", ""]
    assert rows[1]["error"] == "a | b"
    config = json.loads((settings.out / "made.json").read_text())
    assert [cell["key"] for cell in config["cells"]] == [cell.key for cell in CELLS]
    assert config["machine"]["cores"] >= 1
    assert config["quick"] is True
    assert set(config["data"]) == {"built-in-face1", "built-in-face2"}
    assert found.cells == 2
    assert found.failures == {"a | b": ["bmm, own cameras, built-in-face2, noise 0.1"]}


def test_csv_of_ragged_rows():
    rows = [{"a": 1.23456789, "b": None}, {"c": [1, 2], "a": True, "b": float("nan")}, {"d": 'say "x", y'}]
    assert list(csv.reader(io.StringIO(report.csv_text(rows)))) == [
        ["a", "b", "c", "d"],
        ["1.23457", "", "", ""],
        ["True", "", "[1, 2]", ""],
        ["", "", "", 'say "x", y'],
    ]
    assert report.csv_text([]) == "\n"


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.links, self.ids, self.sources = [], [], [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values["href"]] if "href" in values else []
        self.sources += [values["src"]] if "src" in values else []
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_report_is_one_whole_page_that_needs_nothing_else(outcome):
    found, settings = outcome
    text = page.report_html([found], settings)
    parsed = _Page()
    parsed.feed(text)
    assert not parsed.open
    assert all(link.startswith("#") and link[1:] in parsed.ids for link in parsed.links)
    assert len(parsed.sources) == 2
    assert all(s.startswith("data:image/png;base64,") for s in parsed.sources)
    assert "http" not in text
    assert '<span class="verdict good">reproduced</span>' in text
    assert '<span class="verdict bad">not reproduced</span>' in text
    assert "<strong>bold</strong> &amp; <em>slanted</em>" in text
    assert "1 of 2 cells have no numbers" in text
    assert "a | b: bmm" in text


def test_the_markdown_page_links_pictures_that_are_there(outcome, tmp_path):
    found, settings = outcome
    target = tmp_path / "docs" / "results.md"
    report_file, written = page.write_pages([found], settings, target)
    assert written == target
    assert report_file.is_file()
    text = target.read_text()
    links = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert links == ["images/results/made.png", "images/results/made-two.png"]
    assert all((target.parent / link).is_file() for link in links)
    assert "\n\n\n" not in text
    assert text.endswith("\n")
    assert "quick run" in text
    assert "Claims: 1 reproduced, 1 not reproduced." in text
    _, beside = page.write_pages([found], settings, None)
    assert beside == settings.out / "results.md"
    assert all((settings.out / link).is_file() for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", beside.read_text()))


def test_only_a_page_of_ours_is_replaced_and_only_by_a_complete_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = Settings(Path("out"))
    assert page.default_page(whole) is None
    Path("docs").mkdir()
    Path("docs/results.md").write_text("# Somebody's own results\n")
    assert page.default_page(whole) is None
    Path("docs/results.md").write_text(f"# Results\n\n{page.MARKER}\n")
    assert page.default_page(whole) == Path("docs/results.md")
    for part in ({"quick": True}, {"methods": ("bmm",)}, {"sequences": ("pickup",)}):
        assert page.default_page(Settings(Path("out"), **part)) is None


def test_pictures_of_the_page_are_small(tmp_path):
    paths = []
    for i in range(3):
        noise = np.random.default_rng(i).integers(0, 255, (40, 1400, 3), dtype=np.uint8)
        Image.fromarray(noise).save(tmp_path / f"{i}.png")
        paths.append(tmp_path / f"{i}.png")
    found = page.compact(paths, largest=60_000)
    assert list(found) == paths
    widths = {Image.open(io.BytesIO(content)).width for content in found.values()}
    assert len(widths) == 1
    assert widths < {640, 800, 1000}


def test_markdown_becomes_html():
    lines = ["# A `b`", "", "one", "two **x** [y](#a-b)", "- p", "- q", "", *markdown.table(["", "h"], [["a|b", "<"]])]
    found = markdown.to_html(lines)
    assert '<h1 id="a-b">A <code>b</code></h1>' in found
    assert '<p>one two <strong>x</strong> <a href="#a-b">y</a></p>' in found
    assert "<ul><li>p</li><li>q</li></ul>" in found
    assert "<td>a|b</td><td>&lt;</td>" in found
    assert markdown.to_html(["5 * 3 * 2 and a_b_c"]) == "<p>5 * 3 * 2 and a_b_c</p>\n"


def test_scopes_refuse_unknown_and_absent_names(tmp_path):
    assert report.make_scope(Settings(tmp_path, sequences=("built-in-sheet",))).sequences == ("built-in-sheet",)
    with pytest.raises(InputError, match="did you mean 'pickup'"):
        report.make_scope(Settings(tmp_path, sequences=("pikup",)))
    with pytest.raises(InputError, match="none was given"):
        report.make_scope(Settings(tmp_path, sequences=("pickup",)))
    with pytest.raises(InputError, match="its files are not in"):
        report.make_scope(Settings(tmp_path, root=tmp_path, sequences=("pickup",)))
    with pytest.raises(OptionError, match="did you mean 'bmm'"):
        report.make_scope(Settings(tmp_path, methods=("bm",)))


def test_every_experiment_is_registered_under_its_name():
    names = experiment_names()
    assert names[:2] == ["table", "noise"]
    assert len(names) == 12
    with pytest.raises(OptionError, match="did you mean 'noise'"):
        get_experiment("noize")
    for name in names:
        experiment = get_experiment(name)
        assert experiment.name == name
        assert experiment.title
        assert experiment.question.endswith("?")
        assert about(name)


@pytest.mark.parametrize("name", experiment_names())
@pytest.mark.parametrize("quick", [True, False])
def test_no_experiment_needs_data_or_numbers(name, quick):
    from nrsfm.experiments import sequences

    experiment = get_experiment(name)
    cells = experiment.cells(Scope(quick, sequences.available(None)))
    assert cells
    assert len({cell.key for cell in cells}) == len(cells)
    assert all(cell.data.sequence in sequences.BUILT_IN for cell in cells)
    # Cells that all failed, and no cells at all.
    for rows in (experiment.rows(cells, {cell.key: {"error": "no"} for cell in cells}), experiment.rows([], {})):
        findings = experiment.findings(rows)
        assert all(f.verdict in ("not measured", "not reproduced") for f in findings)
        assert experiment.pictures(rows) == []
        assert isinstance(experiment.table(rows), list)
