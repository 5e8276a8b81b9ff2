import io

from nrsfm.progress import TerminalProgress, silent


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_nothing_is_shown_where_there_is_no_terminal():
    stream = io.StringIO()
    with TerminalProgress(stream) as report:
        report("cameras", 0.5)
        report("shapes", None)
    assert stream.getvalue() == ""


def test_a_terminal_shows_the_stage(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with TerminalProgress(stream) as report:
        report("cameras", None)
        report("cameras", 0.5)
        report("shapes", 7.0)
    assert "shapes" in stream.getvalue()


def test_reporting_after_the_end_is_ignored():
    with TerminalProgress(Terminal()) as report:
        pass
    report("cameras", 0.5)


def test_silence(capsys):
    silent("cameras", 0.5)
    assert capsys.readouterr() == ("", "")
