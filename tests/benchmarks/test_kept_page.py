"""The page keeps what it says of sections that are not measured again, and nothing else."""

from types import SimpleNamespace

import pytest
from benchmarks import page, store
from benchmarks.kept_page import KEPT_NOTE, NOT_MEASURED, read_page
from benchmarks.tables import Check, Fact


def _section(title, limit=1.0):
    """A section whose values are numbers by name, each with the same target; the name 'others' is none."""

    def checks(values):
        return [Check(f"{title} {name}", value, limit, " s") for name, value in values["numbers"].items()]

    return SimpleNamespace(
        TITLE=title, checks=checks, render=lambda values: [f"text of {title} {values['numbers']}", ""]
    )


@pytest.fixture
def sections(tmp_path, monkeypatch):
    """Four sections, the third without targets, a page of their own, and a function that keeps values of one."""
    made = {"one": _section("One"), "two": _section("Two"), "plain": _section("Plain"), "four": _section("Four")}
    made["plain"].checks = lambda values: []
    monkeypatch.setattr(page, "SECTIONS", made)
    monkeypatch.setattr(store, "ROOT", tmp_path)
    monkeypatch.setattr(store, "OUTPUT", tmp_path / "kept")
    monkeypatch.setattr(store, "PAGE", tmp_path / "benchmarks.md")
    monkeypatch.setattr(store, "code_digest", lambda *_: "now")
    monkeypatch.setattr(page, "in_words", lambda machine: machine["name"])

    def keep(name, machine="old machine", records=None, **numbers):
        monkeypatch.setattr(store, "machine", lambda: {"name": machine})
        records = {} if records is None else {"records": records}
        store.write(name, {"numbers": numbers} | records)

    return keep


def _fresh_machine():
    for path in store.OUTPUT.iterdir():
        path.unlink()


def _page():
    return store.PAGE.read_text(encoding="utf-8")


def test_sections_that_are_not_measured_again_keep_text_date_machine_summary_and_what_they_missed(sections):
    sections("one", a=2.0, b=0.5, c=3.0)
    sections("two", a=0.5)
    sections("plain")
    sections("four", a=5.0)
    page.write_page()
    before = _page()
    assert KEPT_NOTE not in before
    _fresh_machine()
    sections("two", "new machine", a=7.0)
    missed, errors = page.write_page()
    after = _page()
    assert [check.what for check in missed] == ["Two a"]
    assert errors == {}
    assert "Machine for one, plain, four: old machine" in after
    assert "Machine for two: new machine" in after
    for row in ("| One | 1 of 3 | ✗ |", "| Two | 0 of 1 | ✗ |", "| Four | 0 of 1 | ✗ |"):
        assert row in after
    assert [line.split(":")[0] for line in after.splitlines() if line.startswith("- ")] == [
        "- One a",
        "- One c",
        "- Two a",
        "- Four a",
    ]
    assert "text of One {'a': 2.0, 'b': 0.5, 'c': 3.0}" in after
    assert "text of Two {'a': 7.0}" in after
    assert after.count(KEPT_NOTE) == 3
    assert f"## Two\n\nMeasured {store.today()}.\n\ntext of Two" in after
    assert "state of the code: one, plain, four." in after
    page.write_page()
    assert _page() == after, "written again from itself it is the same"


def test_a_whole_page_measured_again_holds_nothing_of_the_earlier_one(sections):
    for name in page.SECTIONS:
        sections(name, a=2.0)
    page.write_page()
    _fresh_machine()
    for name in page.SECTIONS:
        sections(name, "new machine", a=0.5)
    page.write_page()
    assert KEPT_NOTE not in _page()
    assert "old machine" not in _page()
    assert "No target is missed." in _page()


def test_a_new_section_is_not_measured_until_it_is(sections):
    sections("one", a=0.5)
    page.write_page()
    assert _page().count(NOT_MEASURED) == 3
    assert "| Two | not measured |  |" in _page()
    assert "No target is missed." not in _page()
    _fresh_machine()
    sections("two", a=0.5)
    page.write_page()
    assert _page().count(NOT_MEASURED) == 2
    assert "| One | 1 of 1 | ✓ |" in _page()


def test_runs_that_failed_stay_with_their_section(sections):
    sections("one", records={"case": {"error": "ValueError: two\nlines", "code": "now"}}, a=None)
    sections("two", records={"case": {"error": "KeyError: x", "code": "now"}}, a=0.5)
    page.write_page()
    assert "- One: case: ValueError: two lines" in _page()
    _fresh_machine()
    sections("two", a=0.5)
    page.write_page()
    assert "- One: case: ValueError: two lines" in _page()
    assert "KeyError" not in _page()
    assert "- One a: no number ✗" in _page()


def test_a_trial_leaves_the_page_alone(sections):
    sections("one", a=0.5)
    page.write_page()
    before = _page()
    sections("one", a=2.0)
    page.write_page(trial=True)
    assert _page() == before
    assert "0 of 1" in (store.OUTPUT / store.PAGE.name).read_text(encoding="utf-8")


def test_facts_and_marks_with_words_are_read_back(sections, monkeypatch):
    monkeypatch.setattr(
        page.SECTIONS["one"], "checks", lambda values: [Fact("cells", False, "3 cells"), Check("t", 1, 2)]
    )
    store.write("one", {"numbers": {}, "others": 0.9})
    monkeypatch.setattr(page, "in_words", lambda machine: "a machine")
    page.write_page()
    found = read_page(store.PAGE, {"one": "One"})["one"]
    assert found.row == ["One", "1 of 2", "✗ (measured while other programs ran: not reliable)"]
    assert found.missed == ["- cells: 3 cells ✗"]
    assert found.machine == "a machine"


def test_the_page_of_the_repository_is_understood():
    """Every section that has numbers there is found, and every missed target belongs to one of them."""
    real = store.PAGE
    found = read_page(real, {name: module.TITLE for name, module in page.SECTIONS.items()})
    text = real.read_text(encoding="utf-8")
    assert len(found) + text.count(NOT_MEASURED) == text.count("\n## ") - 1
    summary = text.split("## Summary")[1].split("\n## ")[0]
    items = [line for line in summary.splitlines() if line.startswith("- ")]
    assert [item for section in found.values() for item in section.missed + section.errors] == items
    assert all(section.machine != "not known" for section in found.values())
    assert all(section.lines[0].startswith("Measured ") for section in found.values())
