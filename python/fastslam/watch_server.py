"""The page to watch, served to browsers of this machine alone."""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from .errors import ConfigError
from .watching import Pace, Watcher

OUR_NAMES = ("127.0.0.1", "localhost", "::1")
LONGEST_REQUEST = 1000
HEARTBEAT_S = 2.0
"""A page that has closed is noticed so late at most."""
FASTEST = 1e6

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@contextmanager
def served(watcher: Watcher, *, port: int) -> Iterator[str]:
    """Serves the page on a port of this machine (0: any) as long as the context lasts; yields its address.

    Errors: `ConfigError` for a port that is none or in use.
    """
    if not 0 <= port < 65536:
        raise ConfigError(f"--watch-port: got {port}, expected a port below 65536, or 0 for any")
    handler = type("Handler", (_Handler,), {"watcher": watcher})
    try:
        server = _Server(("127.0.0.1", port), handler)
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        why = "is in use" if error.errno == errno.EADDRINUSE else "is not allowed"
        raise ConfigError(f"--watch-port: port {port} {why}; name another one, or 0 for any") from None
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), name="watch", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        watcher.end()
        server.let_go()
        server.shutdown()
        server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, *args: Any) -> None:
        self.streams: set[threading.Thread] = set()
        super().__init__(*args)

    def let_go(self) -> None:
        """Gives the pages a second to hear that it has ended."""
        for thread in list(self.streams):
            thread.join(1.0 / max(1, len(self.streams)))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that closed is no error; nothing else may spoil the output of the command either."""


class _Handler(BaseHTTPRequestHandler):
    watcher: Watcher
    server: _Server
    timeout = 20.0
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """The page, or the stream of what it draws; there are no other files."""
        if not self._is_for_us():
            return
        path = urlsplit(self.path).path
        if path == "/":
            self._answer(200, _page(), "text/html; charset=utf-8")
        elif path == "/events":
            self._stream()
        else:
            self._answer(404, b"there is only one page\n")

    def do_POST(self) -> None:
        """What the page asks of a run: to stand, or another speed."""
        if not self._is_for_us():
            return
        # Refused requests are not read to their end.
        self.close_connection = True
        if urlsplit(self.path).path != "/pace" or self.watcher.kind != "run":
            return self._answer(404, b"nothing here takes that\n")
        if self.headers.get("Content-Type") != "application/json":
            return self._answer(415, b"expected JSON\n")
        try:
            length = int(self.headers.get("Content-Length", ""))
            if not 0 <= length <= LONGEST_REQUEST:
                raise ValueError
            pace = _pace_of(json.loads(self.rfile.read(length)))
        except (ValueError, RecursionError):
            return self._answer(400, b'expected {"paused": true, "speed": 1.0}\n')
        self.watcher.set_pace(pace)
        self._answer(200, b"{}", "application/json")

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is the command's."""

    def _is_for_us(self) -> bool:
        """Refuses what a page of another site makes a browser ask, also by a name that leads here."""
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin")
        if _name_in(f"//{host}") in OUR_NAMES and origin in (None, f"http://{host}"):
            return True
        self.close_connection = True
        self._answer(403, b"only for browsers of this machine\n")
        return False

    def _answer(self, status: int, body: bytes, kind: str = "text/plain; charset=utf-8") -> None:
        self.send_response(status)
        self._headers(kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _headers(self, kind: str) -> None:
        self.send_header("Content-Type", kind)
        for name, value in HEADERS.items():
            self.send_header(name, value)

    def _stream(self) -> None:
        """Server-sent events until the page closes or nothing more comes; a slow page misses frames."""
        self.close_connection = True
        thread = threading.current_thread()
        self.server.streams.add(thread)
        room = self.watcher.enter()
        try:
            if room:
                with suppress(OSError):
                    self._send_events()
            else:
                self._answer(503, b"too many pages are open\n")
        finally:
            self.watcher.leave()
            self.server.streams.discard(thread)

    def _send_events(self) -> None:
        self.send_response(200)
        self._headers("text/event-stream")
        self.end_headers()
        self._send("scene", json.dumps(self.watcher.scene, ensure_ascii=False).encode())
        number, version = -1, -1
        while True:
            frames, now, state = self.watcher.news(number, version, wait_s=HEARTBEAT_S)
            for sent, frame in frames:
                self._send("frame", frame)
                number = sent
            if now != version:
                self._send("state", json.dumps(state).encode())
                version = now
            if state["ended"]:
                return
            if not frames:
                self.wfile.write(b":\n\n")
            self.wfile.flush()

    def _send(self, event: str, data: bytes) -> None:
        self.wfile.write(b"event: " + event.encode() + b"\ndata: " + data + b"\n\n")


def _pace_of(asked: object) -> Pace:
    """Errors: ValueError."""
    if not isinstance(asked, dict) or set(asked) != {"paused", "speed"}:
        raise ValueError
    paused, speed = asked["paused"], asked["speed"]
    if not isinstance(paused, bool) or isinstance(speed, bool) or not isinstance(speed, int | float):
        raise ValueError
    if not (speed == 0 or 1.0 / FASTEST <= speed <= FASTEST):
        raise ValueError
    return Pace(paused, float(speed))


def _name_in(address: str) -> str:
    try:
        return urlsplit(address).hostname or ""
    except ValueError:
        return ""


@cache
def _page() -> bytes:
    return files(__package__).joinpath("watch.html").read_bytes()
