import os
import subprocess
import sys

import pytest

import nrsfm
from nrsfm.cli import VERBS


def test_version(command):
    assert command("--version") == (0, f"nrsfm {nrsfm.__version__}\n", "")


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_names_every_command(command, flag):
    code, out, err = command(flag)
    assert (code, err) == (0, "")
    assert all(f"  {verb} " in out for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_every_command_has_help(command, pipeline, verb):
    code, out, err = command(verb, "--help")
    assert (code, err) == (0, "")
    assert out.startswith(f"usage: nrsfm {verb}")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "a command is needed, one of demo, reconstruct"),
        (["reconstrct"], "unknown command 'reconstrct'; did you mean 'reconstruct'"),
        (["zzz"], "unknown command 'zzz'; see nrsfm --help"),
        (["--helpp"], "unknown option '--helpp'; did you mean '--help'?"),
        (["methods", "--jsn"], "unknown option '--jsn'; did you mean '--json'?"),
        (["methods", "what"], "unexpected argument 'what'"),
    ],
)
def test_wrong_commands_are_explained_in_one_line(command, words, text):
    code, out, err = command(*words)
    assert (code, out) == (2, "")
    assert text in err
    assert err.count("\n") == 1


def test_a_fault_of_ours_is_one_line_and_code_1(command, monkeypatch):
    def fail(words):
        raise ZeroDivisionError("what\nis this")

    monkeypatch.setattr("nrsfm.cli.methods.run", fail)
    code, out, err = command("methods")
    assert (code, out) == (1, "")
    assert err == "nrsfm: a fault of nrsfm, not yours: ZeroDivisionError: what is this (--debug shows where)\n"
    with pytest.raises(ZeroDivisionError):
        command("methods", "--debug")


def test_refusals_of_the_system_are_code_2(command, monkeypatch):
    def fail(words):
        raise PermissionError(13, "Permission denied", "/x")

    monkeypatch.setattr("nrsfm.cli.methods.run", fail)
    assert command("methods") == (2, "", "nrsfm: error: the system refused '/x': Permission denied\n")


def test_running_out_of_memory_is_said(command, monkeypatch):
    def fail(words):
        raise MemoryError("Unable to allocate 5 TiB")

    monkeypatch.setattr("nrsfm.cli.methods.run", fail)
    assert command("methods") == (1, "", "nrsfm: error: not enough memory: Unable to allocate 5 TiB\n")


def test_ctrl_c_is_130(command, monkeypatch):
    def fail(words):
        raise KeyboardInterrupt

    monkeypatch.setattr("nrsfm.cli.methods.run", fail)
    assert command("methods") == (130, "", "nrsfm: interrupted\n")


def interrupted_at(module):
    """Run ``nrsfm methods`` in a process in which Ctrl-C is pressed when the module is first imported."""
    code = (
        "import os, signal, sys\n"
        "class Press:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            sys.meta_path.remove(self)\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "from nrsfm.cli import main\n"
        "sys.meta_path.insert(0, Press())\n"
        "sys.exit(main(['methods']))\n"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("module", ["nrsfm.cli.command", "numpy", "argparse", "nrsfm.cli.methods", "nrsfm.methods"])
def test_ctrl_c_while_python_imports_is_130_without_a_traceback(module):
    found = interrupted_at(module)
    assert (found.returncode, found.stdout) == (130, "")
    assert found.stderr in ("", "nrsfm: interrupted\n")


def test_the_entry_imports_next_to_nothing():
    code = (
        "import sys, nrsfm.cli; assert not {'numpy', 'argparse', 'nrsfm.errors', 'importlib.metadata'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_caller_keeps_its_own_answer_to_ctrl_c(command):
    import signal

    def own(number, frame):
        raise KeyboardInterrupt

    for handler in (own, signal.SIG_IGN, signal.default_int_handler):
        previous = signal.signal(signal.SIGINT, handler)
        try:
            assert command("--version")[0] == 0
            assert signal.getsignal(signal.SIGINT) is handler
        finally:
            signal.signal(signal.SIGINT, previous)


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_goes_away_is_no_fault(tracks_file, unbuffered):
    process = subprocess.Popen(
        [sys.executable, "-m", "nrsfm.cli", "info", tracks_file],
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) == 141
    assert err == b""


def test_an_ascii_terminal_shows_something():
    shown = subprocess.run(
        [sys.executable, "-m", "nrsfm.cli", "methodzz\u00e9"],
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert shown.returncode == 2
    assert "unknown command 'methodzz?'" in shown.stderr


def test_commands_that_do_not_draw_load_no_matplotlib(tmp_path):
    code = (
        "import sys, numpy\n"
        "from nrsfm.cli import main\n"
        "numpy.savez('t.npz', tracks=numpy.zeros((3, 4, 2)))\n"
        "assert main(['info', 't.npz']) == 0\n"
        "assert 'matplotlib' not in sys.modules and 'sklearn' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True)
