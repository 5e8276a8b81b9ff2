"""Stages are done once, again when what they depend on changes, and never left half done."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from nrsfm.errors import FileError
from nrsfm.stages import RECORD, Stage, identity, is_same, is_there, open_stages, plain


class Kitchen:
    """Three stages of text files: a reads an input, b doubles a, c reads b; d reads a alone."""

    def __init__(self, tmp_path: Path) -> None:
        self.folder, self.input = tmp_path / "öut put", tmp_path / "in put.txt"
        self.input.write_text("1")
        self.ran: list[str] = []
        self.settings: dict[str, dict] = {"a": {}, "b": {"times": 2}, "c": {}, "d": {}}
        self.fail = ""
        self.version = "1"

    def stages(self) -> list[Stage]:
        def work(name: str, source: Path):
            def do(aside: Path, report) -> dict:
                self.ran.append(name)
                (aside / f"{name}.txt").write_text(source.read_text() * self.settings[name].get("times", 1))
                if self.fail == name:
                    raise KeyboardInterrupt
                return {"length": len(source.read_text())}

            return do

        f = self.folder
        return [
            Stage("a", work("a", self.input), self.settings["a"], {"input": str(self.input)}),
            Stage("b", work("b", f / "a.txt"), self.settings["b"], needs=("a",)),
            Stage("c", work("c", f / "b.txt"), self.settings["c"], needs=("a", "b")),
            Stage("d", work("d", f / "a.txt"), self.settings["d"], needs=("a",)),
        ]

    def cook(self) -> list[str]:
        self.ran = []
        with open_stages(self.folder, "cook", self.version, extra=("log.txt",)) as folder:
            (self.folder / "log.txt").write_text("said")
            for stage in self.stages():
                if folder.why(stage):
                    folder.run(stage)
        return self.ran


@pytest.fixture
def kitchen(tmp_path: Path) -> Kitchen:
    return Kitchen(tmp_path)


def test_what_is_done_is_not_done_again(kitchen: Kitchen) -> None:
    assert kitchen.cook() == ["a", "b", "c", "d"]
    assert kitchen.cook() == []
    assert (kitchen.folder / "c.txt").read_text() == "11"
    assert sorted(os.listdir(kitchen.folder)) == ["a.txt", "b.txt", "c.txt", "d.txt", "log.txt", RECORD]


def test_a_change_repeats_what_depends_on_it_and_nothing_else(kitchen: Kitchen) -> None:
    kitchen.cook()
    kitchen.settings["b"] = {"times": 3}
    assert kitchen.cook() == ["b", "c"]
    assert (kitchen.folder / "c.txt").read_text() == "111"
    kitchen.input.write_text("7")
    assert kitchen.cook() == ["a", "b", "c", "d"]
    os.utime(kitchen.input, (1, 1))  # touched, and the same
    assert kitchen.cook() == []
    (kitchen.folder / "b.txt").unlink()
    assert kitchen.cook() == ["b", "c"]
    (kitchen.folder / "d.txt").write_text("changed")
    assert kitchen.cook() == ["d"]
    kitchen.version = "2"
    assert kitchen.cook() == ["a", "b", "c", "d"]


def test_the_reason_is_told(kitchen: Kitchen) -> None:
    kitchen.cook()
    kitchen.settings["b"] = {"times": 4}
    kitchen.input.write_text("9")
    with open_stages(kitchen.folder, "cook", "1") as folder:
        assert [folder.why(stage) for stage in kitchen.stages()[:2]] == [
            "the input has changed",
            "other options: times",
        ]
    with open_stages(kitchen.folder, "cook", "2") as folder:
        assert folder.why(kitchen.stages()[0]) == "made by version 1"


def test_an_interrupted_change_leaves_the_old_outputs_whole(kitchen: Kitchen) -> None:
    kitchen.cook()
    kitchen.settings["b"], kitchen.fail = {"times": 5}, "b"
    with pytest.raises(KeyboardInterrupt):
        kitchen.cook()
    assert (kitchen.folder / "b.txt").read_text() == (kitchen.folder / "c.txt").read_text() == "11"
    kitchen.settings["b"] = {"times": 2}
    assert kitchen.cook() == []
    kitchen.fail, kitchen.settings["b"] = "c", {"times": 5}
    with pytest.raises(KeyboardInterrupt):
        kitchen.cook()
    assert not (kitchen.folder / "c.txt").exists()  # of the old b
    kitchen.fail = ""
    assert kitchen.cook() == ["c"]


def test_nothing_is_left_where_no_stage_could_be_finished(kitchen: Kitchen, tmp_path: Path) -> None:
    kitchen.folder, kitchen.fail = tmp_path / "new" / "deep", "a"
    with pytest.raises(KeyboardInterrupt):
        kitchen.cook()
    assert not (tmp_path / "new").exists()


def test_a_stage_that_is_not_wanted_goes_with_what_builds_on_it(kitchen: Kitchen) -> None:
    kitchen.cook()
    with open_stages(kitchen.folder, "cook", "1") as folder:
        folder.drop("b")
        assert (folder.entry("c"), folder.facts("d")) == (None, {"length": 1})
    assert sorted(os.listdir(kitchen.folder)) == ["a.txt", "d.txt", "log.txt", RECORD]


KILLED = """
import sys, time
from pathlib import Path
from nrsfm.stages import Stage, open_stages

def first(aside, report):
    (aside / "one.txt").write_text("whole")
    return {}

def second(aside, report):
    (aside / "two.txt").write_text("ha")
    print("ready", flush=True)
    time.sleep(60)

with open_stages(sys.argv[1], "cook", "1") as folder:
    folder.run(Stage("first", first))
    folder.run(Stage("second", second, needs=("first",)))
"""


def test_a_killed_process_leaves_finished_stages_and_the_folder_is_cleaned(tmp_path: Path) -> None:
    place = tmp_path / "out"
    words = [sys.executable, "-c", KILLED, str(place)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "ready\n"
            with pytest.raises(FileError, match="another process is working in it"), open_stages(place, "cook", "1"):
                pass
        finally:
            child.send_signal(signal.SIGKILL)
    assert not (place / "two.txt").exists()
    with open_stages(place, "cook", "1") as folder:
        assert folder.why(Stage("first", lambda aside, report: {})) == ""
        assert folder.entry("second") is None
    assert sorted(os.listdir(place)) == ["one.txt", RECORD]


def test_files_on_their_way_in_are_removed_if_the_record_does_not_know_them(kitchen: Kitchen) -> None:
    kitchen.cook()
    record = json.loads((kitchen.folder / RECORD).read_text())
    del record["stages"]["d"]
    (kitchen.folder / RECORD).write_text(json.dumps({**record, "pending": ["d.txt"]}))
    with open_stages(kitchen.folder, "cook", "1"):
        assert not (kitchen.folder / "d.txt").exists()
    assert kitchen.cook() == ["d"]


def test_a_folder_of_something_else_is_refused(kitchen: Kitchen, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    kitchen.folder = tmp_path / "notes"
    with pytest.raises(FileError, match=r"holds other files and no stages.json of cook: mine.txt"):
        kitchen.cook()
    assert os.listdir(tmp_path / "notes") == ["mine.txt"]
    kitchen.folder = kitchen.input
    with pytest.raises(FileError, match="a file of that name exists"):
        kitchen.cook()
    kitchen.folder = tmp_path / "other"
    kitchen.cook()
    with pytest.raises(FileError, match="made by 'cook'"), open_stages(kitchen.folder, "bake", "1"):
        pass


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"made_by": "cook", "format": 1, "pending": ["../../x"], "stages": {}}']
)
def test_a_damaged_record_is_refused_and_nothing_outside_is_removed(kitchen: Kitchen, text: str) -> None:
    kitchen.cook()
    (kitchen.folder / RECORD).write_text(text)
    with pytest.raises(FileError, match=r"stages.json is damaged"):
        kitchen.cook()
    assert (kitchen.folder / "c.txt").exists()


def test_a_folder_that_is_not_ours_is_never_replaced(kitchen: Kitchen) -> None:
    kitchen.cook()
    (kitchen.folder / "b.txt").unlink()
    (kitchen.folder / "b.txt").mkdir()
    (kitchen.folder / "b.txt" / "mine").write_text("mine")

    def other(aside: Path, report) -> dict:
        (aside / "notes").write_text("x")
        return {}

    (kitchen.folder / "notes").mkdir()
    with (
        open_stages(kitchen.folder, "cook", "1") as folder,
        pytest.raises(FileError, match="a folder of that name exists"),
    ):
        folder.run(Stage("e", other))
    assert (kitchen.folder / "notes").is_dir()


def test_identities_follow_names_and_contents(tmp_path: Path) -> None:
    images = tmp_path / "im [a]ges"
    images.mkdir()
    for n in range(3):
        (images / f"ä_{n}.png").write_bytes(bytes([n]) * 10)
    whole, pattern = identity(images), identity(images / "ä_*.png")
    assert (whole["bytes"], pattern["bytes"], whole["sha256"] == pattern["sha256"]) == (30, 30, True)
    assert is_same(images, whole)
    assert is_there(images / "ä_*.png")
    assert not is_there(images / "b_*.png")
    assert not is_there("1,2 3,4 5,6")
    time.sleep(0.01)
    (images / "ä_1.png").write_bytes(bytes([9]) * 10)
    assert not is_same(images, whole)
    (images / "ä_1.png").write_bytes(bytes([1]) * 10)
    assert is_same(images, whole)
    (images / "ä_2.png").rename(images / "ä_3.png")
    assert not is_same(images, whole)
    assert not is_same(tmp_path / "gone", whole)
    assert not is_same(images, None)
    with pytest.raises(FileError, match="there is no such file or folder"):
        identity(tmp_path / "gone")


def test_settings_are_compared_as_json_gives_them_back() -> None:
    given = {"a": (1, np.float64(2.5)), "b": np.arange(3), "c": Path("x"), 4: None}
    assert plain(given) == json.loads(json.dumps(plain(given)))
    assert plain(np.arange(3)) != plain(np.arange(1, 4))
