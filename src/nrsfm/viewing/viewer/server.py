"""The server behind the page: this machine only, and nothing but the page's files and the numbers of one content.

Three things keep others out. The socket listens on 127.0.0.1. Requests must name this address in their ``Host``, so
that a name of somebody else's that is made to point here (DNS rebinding) is refused. And the answers may not be used by
pages from elsewhere: no CORS header, ``Cross-Origin-Resource-Policy: same-origin``, and a content policy without any
other host. Only GET and HEAD are known, and only paths of a fixed list: no path of a request ever meets a file system.

Source: ours; RFC 9110 for the answers.
"""

from __future__ import annotations

import contextlib
import errno
import json
import re
import socket
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any

from nrsfm.errors import NrsfmError, OptionError
from nrsfm.viewing.viewer.content import Content

HOST = "127.0.0.1"
DEFAULT_PORT = 8090
_NEARBY = 20  # ports tried from the default one
_NAMES = (HOST, "localhost")
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_NUMBERED = re.compile(r"/(frame|image)/(\d{1,9})")
_NAMED = re.compile(r"/colours/([a-z]{1,20})")
_BYTES = "application/octet-stream"
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
}


class ViewServer:
    """Serves one content; ``with ViewServer(content) as server`` starts it and stops it.

    Parameters
    ----------
    content
        What is shown.
    host
        ``127.0.0.1`` or ``localhost``; anything else is refused.
    port
        A port, 0 for any free one, or ``None``: 8090, or the next free one.

    Raises
    ------
    OptionError
        Another host, or a port that is in use or may not be used.
    """

    def __init__(self, content: Content, *, host: str = HOST, port: int | None = None) -> None:
        if host not in _NAMES:
            raise OptionError(f"option 'host' must be {' or '.join(_NAMES)}: only this machine, received {host!r}")
        if port is not None and (isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535):
            raise OptionError(f"option 'port' must be a whole number from 0 to 65535, received {port!r}")
        self._server = _bind(port)
        self._server.answers = Answers(content)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """What to open in the browser."""
        return f"http://{HOST}:{self.port}/"

    def __enter__(self) -> ViewServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.close_connections()
        self._server.server_close()
        self._thread.join(timeout=2.0)

    def wait(self) -> None:
        """Return when the server ends, or raise what interrupts it."""
        while self._thread.is_alive():
            self._thread.join(timeout=0.5)  # a wait without end would not see Ctrl-C on every system


class Answers:
    """What each path is answered with: type and bytes, or ``None`` for a path that does not exist."""

    def __init__(self, content: Content) -> None:
        self._content = content
        self._scene = json.dumps(content.about, ensure_ascii=False, allow_nan=False).encode()
        page = resources.files(__package__) / "page"
        self._files = {
            f"/{entry.name}": (_TYPES[suffix], entry.read_bytes())
            for entry in page.iterdir()
            if (suffix := "." + entry.name.rpartition(".")[2]) in _TYPES
        }
        self._files["/"] = self._files["/index.html"]

    def find(self, path: str) -> tuple[str, bytes] | None:
        """Return the answer; the content is asked for it at most once per request."""
        if path in self._files:
            return self._files[path]
        if path == "/scene.json":
            return "application/json", self._scene
        if path in ("/faces", "/edges", "/tracks"):
            data = getattr(self._content, path[1:] + "_bytes")()
            return None if data is None else (_BYTES, data)
        named = _NAMED.fullmatch(path)
        if named:
            data = self._content.colours_bytes(named[1])
            return None if data is None else (_BYTES, data)
        numbered = _NUMBERED.fullmatch(path)
        if not numbered or int(numbered[2]) >= self._content.n_frames:
            return None
        if numbered[1] == "frame":
            return _BYTES, self._content.frame_bytes(int(numbered[2]))
        picture = self._content.pictures
        return None if picture is None else ("image/jpeg", picture.jpeg(int(numbered[2])))


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True  # a port left a second ago is free
    request_queue_size = 32
    answers: Answers

    def __init__(self, *arguments: Any) -> None:
        self._open: set[socket.socket] = set()
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer on a thread of its own, and remember the connection."""
        self._open.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self._open.discard(request)
        super().shutdown_request(request)

    def close_connections(self) -> None:
        """Close the connections that browsers keep open for their next request."""
        for request in list(self._open):
            with contextlib.suppress(OSError):
                request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Stay silent: a browser that goes away in mid-answer is no news."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    protocol_version = "HTTP/1.1"
    server_version = "nrsfm"
    sys_version = ""
    timeout = 60.0
    disable_nagle_algorithm = True

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        port = self.server.server_address[1]
        if self.headers.get("Host") not in {f"{name}:{port}" for name in _NAMES}:
            self._send(HTTPStatus.FORBIDDEN, "text/plain", b"only 127.0.0.1 is served\n", body)
            return
        try:
            found = self.server.answers.find(self.path.partition("?")[0])
        except NrsfmError as error:  # a picture that cannot be read any more, for example
            self._send(HTTPStatus.INTERNAL_SERVER_ERROR, "text/plain; charset=utf-8", f"{error}\n".encode(), body)
            return
        if found is None:
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not here\n", body)
        else:
            self._send(HTTPStatus.OK, *found, body)

    def _send(self, status: HTTPStatus, kind: str, data: bytes, body: bool) -> None:
        with contextlib.suppress(ConnectionError):
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(data)))
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            self.end_headers()
            if body:
                self.wfile.write(data)

    def log_message(self, *_: Any) -> None:
        """Say nothing: the terminal belongs to the user."""


def _bind(port: int | None) -> _Server:
    tried = range(DEFAULT_PORT, DEFAULT_PORT + _NEARBY) if port is None else (port,)
    for number in tried:
        try:
            return _Server((HOST, number), _Handler)
        except OSError as error:
            if port is None and error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            reason = "in use" if error.errno == errno.EADDRINUSE else (error.strerror or str(error)).lower()
            raise OptionError(f"port {number} cannot be used: {reason}; choose another --port, or none") from error
    raise OptionError(f"ports {tried[0]} to {tried[-1]} are in use; choose another --port")
