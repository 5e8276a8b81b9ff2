"""The viewer's server: this machine only, its own files only; and the command that runs it."""

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nrsfm import Reconstruction
from nrsfm.errors import OptionError
from nrsfm.viewing.viewer import ViewServer, make_content
from nrsfm.viewing.viewer.server import DEFAULT_PORT


def small(frames=4, points=30):
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(1, points, 3)) + 0.1 * rng.normal(size=(frames, points, 3))
    turns = np.tile(np.eye(3), (frames, 1, 1))
    return Reconstruction(shapes, turns, np.zeros((frames, 2)), np.ones(frames))


@pytest.fixture(scope="module")
def server():
    with ViewServer(make_content(small()), port=0) as running:
        yield running


def ask(server, path, *, method="GET", host=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    try:
        connection.request(method, path, headers={"Host": host or f"127.0.0.1:{server.port}"})
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def test_the_page_and_the_numbers_are_there(server):
    status, headers, body = ask(server, "/")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    for path in re.findall(rb'(?:href|src)="([^"]+)"', body):
        assert ask(server, "/" + path.decode())[0] == 200
    assert ask(server, "/scene.json")[1]["Content-Type"] == "application/json"
    assert len(ask(server, "/frame/3")[2]) == 30 * 8


def test_every_module_that_a_module_imports_is_served(server):
    seen, todo = set(), ["main.js"]
    while todo:
        name = todo.pop()
        status, headers, body = ask(server, "/" + name)
        assert (status, headers["Content-Type"]) == (200, "text/javascript; charset=utf-8"), name
        seen.add(name)
        todo += set(re.findall(r'from "\./([\w.]+)"', body.decode())) - seen
    page = Path(__import__("nrsfm").__file__).parent / "viewing" / "viewer" / "page"
    assert seen == {file.name for file in page.glob("*.js")}


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py", "/%2e%2e/server.py", "/page/main.js", "//etc/passwd", "/etc/passwd", "/frame/4", "/frame/-1",
        "/frame/1/..", "/image/0", "/faces", "/colours/texture", "/colours/../scene.json", "/frame/9999999999999",
        "/favicon.ico", "/index.html/", "/.",
    ],
)  # fmt: skip
def test_nothing_else_is(server, path):
    assert ask(server, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "CONNECT"])
def test_nothing_can_be_sent(server, method):
    assert ask(server, "/", method=method)[0] == 501


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "127.0.0.1",
        "127.0.0.1:1",
        "0.0.0.0:{port}",
        "localhost.evil.example:{port}",
    ],
)
def test_a_name_of_somebody_else_is_refused(server, host):
    assert ask(server, "/scene.json", host=host.format(port=server.port))[0] == 403
    assert ask(server, "/scene.json", host=f"localhost:{server.port}")[0] == 200


def test_other_pages_may_not_use_the_answers(server):
    for path in ("/", "/scene.json", "/frame/0", "/nothing"):
        headers = ask(server, path)[1]
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "default-src 'self'" in headers["Content-Security-Policy"]
        assert "Access-Control-Allow-Origin" not in headers


def test_head_has_no_body(server):
    status, headers, body = ask(server, "/frame/0", method="HEAD")
    assert (status, headers["Content-Length"], body) == (200, "240", b"")


def test_it_listens_on_this_machine_only(server):
    assert server._server.socket.getsockname()[0] == "127.0.0.1"
    assert server.address == f"http://127.0.0.1:{server.port}/"


@pytest.mark.parametrize("host", ["0.0.0.0", "", "::", "192.168.1.2", "example.org"])
def test_other_hosts_are_refused(host):
    with pytest.raises(OptionError, match="only this machine"):
        ViewServer(make_content(small()), host=host)


@pytest.mark.parametrize("port", [-1, 65536, 1.5, True, "80"])
def test_ports_that_are_none_are_refused(port):
    with pytest.raises(OptionError, match="whole number from 0 to 65535"):
        ViewServer(make_content(small()), port=port)


def test_a_named_port_in_use_is_an_error_and_the_default_goes_on(server):
    with pytest.raises(OptionError, match=rf"port {server.port} cannot be used: in use"):
        ViewServer(make_content(small()), port=server.port)
    with ViewServer(make_content(small())) as first, ViewServer(make_content(small())) as second:
        assert DEFAULT_PORT <= first.port < second.port


def test_the_end_frees_the_port():
    with ViewServer(make_content(small()), port=0) as first:
        port = first.port
    with ViewServer(make_content(small()), port=port) as again:
        assert ask(again, "/")[0] == 200


# The command


def start(*words):
    command = [sys.executable, "-m", "nrsfm.cli", "view", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "möbius strip" / "reconstruction.npz"
    path.parent.mkdir()
    small().save(path)
    return path


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a signal")
def test_the_command_says_where_and_ends_with_ctrl_c(saved):
    process = start(saved.parent, "--port", 0)
    try:
        line = process.stderr.readline()
        found = re.fullmatch(r"nrsfm: view at http://127\.0\.0\.1:(\d+)/ \(Ctrl-C ends it\)\n", line)
        assert found, line
        connection = http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=10)
        connection.request("GET", "/scene.json")
        assert '"title": "möbius strip"' in connection.getresponse().read().decode()
        process.send_signal(signal.SIGINT)  # while a connection is open
        out, err = process.communicate(timeout=10)
        connection.close()
    finally:
        process.kill()
    assert (process.returncode, out, err) == (0, "", "nrsfm: view ended\n")


def refused(*words):
    process = start(*words)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, ""), err
    assert err.startswith("nrsfm: error: ")
    assert err.count("\n") == 1, err
    return err


def test_bad_input_is_one_line(saved, tmp_path):
    truth = tmp_path / "truth.npz"
    np.savez(truth, shapes=np.zeros((4, 29, 3)))
    for words, expected in (
        ([tmp_path / "nothing.npz"], "nothing.npz"),
        ([saved, "--truth", truth], "4 frames of 30 points are needed"),
        ([saved, "--images", tmp_path / "nowhere"], "no such file or folder"),
        ([saved, "--faces", "grid:3x3"], "must be the number of points"),
        ([saved, "--fps", "0"], "'--fps' must be greater than 0"),
        ([saved, "--host", "0.0.0.0"], "this machine only"),
    ):
        assert expected in refused(*words)


def test_a_port_in_use_is_one_line(saved):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert "in use" in refused(saved, "--port", taken.getsockname()[1])
