"""The examples of docs/formats.md run, and print what they say."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from nrsfm.files import known_extensions, load_tracks

PAGE = Path(__file__).resolve().parents[2] / "docs" / "formats.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_examples_print_what_they_say(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks("python"))
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, str(PAGE), "exec"), {})
    promised = re.findall(r"^print\(.*\)  # (.*)$", code, flags=re.MULTILINE)
    assert len(promised) >= 4
    assert output.getvalue().splitlines() == promised


@pytest.mark.parametrize("text", blocks("text"))
def test_the_text_files_are_tracks(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    tracks = load_tracks(tmp_path / "a.csv")
    assert (tracks.n_frames, tracks.n_points) == (2, 2)
    assert tracks.points[0, 0].tolist() == [101.5, 220.25]


def test_every_extension_is_on_the_page():
    page = PAGE.read_text(encoding="utf-8")
    assert all(f"`{extension}`" in page for extension in known_extensions())
