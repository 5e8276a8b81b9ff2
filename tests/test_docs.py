"""The pages in docs/: examples run, links lead somewhere, and the options page is what the code declares."""

import contextlib
import dataclasses
import importlib
import io
import re
import runpy
from pathlib import Path

import pytest

from nrsfm.methods import get_method, method_names
from nrsfm.pipeline import STAGE_OPTIONS

ROOT = Path(__file__).resolve().parents[1]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [*DOCS, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]

_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\]\n]*\]\(([^()\s]+)\)")
_CODE_AT = re.compile(r"\]\(\.\./src/(nrsfm/[\w/]+)\.py\): ((?:`[\w.]+`(?:, )?)+)")


def name(page):
    return page.relative_to(ROOT).as_posix()


def python_blocks(page):
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page):
    """The fragments that a code host gives to the headings of a page."""
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    found = []
    for heading in re.findall(r"^#+ +(.+?)\s*$", text, flags=re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        found.append(f"{slug}-{found.count(slug)}" if slug in found else slug)
    return found


@pytest.mark.parametrize("page", [page for page in DOCS if python_blocks(page)], ids=name)
def test_the_examples_print_what_they_say(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(python_blocks(page))
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, str(page), "exec"), {"__name__": "__main__"})
    promised = re.findall(r"^ *print\(.*\)  # (.*)$", code, flags=re.MULTILINE)
    assert promised, "an example that prints nothing tests nothing"
    assert output.getvalue().splitlines() == promised


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_relative_link_resolves(page):
    text = _FENCED.sub("", page.read_text(encoding="utf-8"))
    broken = []
    for link in _LINK.findall(text):
        if re.match(r"[a-z]+:", link):  # elsewhere
            continue
        path, _, fragment = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        inside = target.is_relative_to(ROOT) and target.exists()
        if not inside or (fragment and fragment not in anchors(target)):
            broken.append(link)
    assert not broken


@pytest.mark.parametrize("page", DOCS, ids=name)
def test_code_that_a_page_points_to_is_there(page):
    for module, names in _CODE_AT.findall(page.read_text(encoding="utf-8")):
        for dotted in re.findall(r"`([\w.]+)`", names):
            found = importlib.import_module(module.replace("/", "."))
            for part in dotted.split("."):
                assert hasattr(found, part), f"{module}.py has no {dotted}"
                found = getattr(found, part)


def test_the_methods_page_points_to_the_code_of_every_step():
    pointers = _CODE_AT.findall((ROOT / "docs" / "methods.md").read_text(encoding="utf-8"))
    assert len(pointers) > 30
    assert {"nrsfm/methods/grassmann", "nrsfm/methods/geometry_aware"} <= {module for module, _ in pointers}


def test_every_page_is_on_the_map():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert [page.name for page in DOCS if page.name != "index.md" and f"]({page.name})" not in index] == []


def test_the_options_page_is_up_to_date():
    page = runpy.run_path(str(ROOT / "docs" / "write_options.py"))["page"]
    written = (ROOT / "docs" / "options.md").read_text(encoding="utf-8")
    assert written == page(), "run: python docs/write_options.py"


def options_sections():
    """The sections of the options page, by heading: the text above the table, and the options in it."""
    page = (ROOT / "docs" / "options.md").read_text(encoding="utf-8")
    return {
        section.partition("\n")[0]: (section.partition("\n|")[0], re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE))
        for section in page.split("\n## ")[1:]
    }


@pytest.mark.parametrize("stage", STAGE_OPTIONS)
def test_every_shared_option_is_on_its_page(stage):
    listed = options_sections()[stage.capitalize()][1]
    assert listed == [field.name for field in dataclasses.fields(STAGE_OPTIONS[stage])]


@pytest.mark.parametrize("method", method_names())
def test_every_option_of_a_method_is_on_its_page(method):
    listed = [option for text, options in options_sections().values() if f"`{method}`" in text for option in options]
    assert sorted(set(listed)) == sorted(field.name for field in dataclasses.fields(get_method(method).Options))


def test_defaults_that_differ_between_methods_are_all_given():
    rows = re.findall(r"^\| `reweight` \|.*$", (ROOT / "docs" / "options.md").read_text(encoding="utf-8"), re.MULTILINE)
    shared = rows[0]
    for method in ("bmm", "grassmann", "geometry-aware"):
        default = next(f.default for f in dataclasses.fields(get_method(method).Options) if f.name == "reweight")
        assert re.search(rf"`{default:g}` \((?:`[\w-]+`, )*`{method}`", shared)
    for method in ("rbmm", "organic"):  # they declare it anew: another meaning, a row of its own
        assert f"`{method}`" not in shared
        default = next(f.default for f in dataclasses.fields(get_method(method).Options) if f.name == "reweight")
        assert sum(f"| `{default:g}` |" in row for row in rows) == 1
