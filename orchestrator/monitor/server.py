"""Serves the monitor's page: on this machine only, or elsewhere to those who know the token.

The page is static and requests ``/status.json`` twice a second; pictures are files that the sink writes at
most twice a second, or ten times for the streams that are sent on as Motion JPEG. So viewers never slow a
frame, however many there are. All addresses are relative, so that a proxy may serve the page below a path.
"""

from __future__ import annotations

import hmac
import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from mlbs_actors.errors import ConfigError
from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.monitor.board import Board
from orchestrator.monitor.metrics import CONTENT_TYPE, MetricsText
from orchestrator.monitor.recorded_files import RecordedFile, asked_range
from orchestrator.monitor.restream import BOUNDARY, motion_jpeg
from orchestrator.monitor.zones_page import MOST_BYTES, ZONES_FILES, ZonesPage
from orchestrator.run.edit_zones import ZoneEditor, ZoneFiles

__all__ = ["serving"]

_LEAST_TOKEN = 16  # characters
_COOKIE = "mlbs-monitor"
_CHUNK = 1 << 16  # bytes
_FOLDER = Path(__file__).parent
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/monitor.js": ("monitor.js", "text/javascript; charset=utf-8"),
    "/monitor.css": ("monitor.css", "text/css; charset=utf-8"),
    **ZONES_FILES,
}
_UNDER_WAY = ("running", "stalled", "reconnecting", "done")
#: What probes ask for, and whether it is so: the command answers; a stream is under way.
_HEALTH: dict[str, Callable[[Board], bool]] = {
    "/healthz": lambda _: True,
    "/readyz": lambda board: any(state.state in _UNDER_WAY for state in board.states),
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; media-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@contextmanager
def serving(address: MonitorAddress, board: Board, zones: ZoneFiles | None = None) -> Iterator[str]:
    """Serve the page while the ``with`` block runs.

    Parameters
    ----------
    address : MonitorAddress
    board : Board
    zones : ZoneFiles, optional
        Where the zones of the run are, which may be drawn; by default nowhere.

    Yields
    ------
    str
        The page's address, without the token.

    Raises
    ------
    ConfigError
        If the address is not available, or others could reach it and there is no token.
    """
    token = os.environ.get(TOKEN_VARIABLE, "")
    if (token or not address.is_loopback) and len(token) < _LEAST_TOKEN:
        raise ConfigError(
            f"--monitor at {address.host} needs a token: set {TOKEN_VARIABLE} to at least {_LEAST_TOKEN} "
            "characters, for example with openssl rand -hex 16."
        )
    try:
        server = _Server(address, board, token, zones or ZoneFiles())
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(
            f"--monitor cannot listen at {address.host}:{address.port}: {reason}. Choose another address."
        ) from None
    thread = threading.Thread(target=server.serve_forever, args=(0.1,), name="monitor", daemon=True)
    thread.start()
    try:
        yield f"http://{address.host}:{server.server_port}/" + ("?token=…" if token else "")
    finally:
        server.is_closing = True
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a slow viewer must not delay the end of the run

    def __init__(self, address: MonitorAddress, board: Board, token: str, zones: ZoneFiles) -> None:
        self.board = board
        self.zones = ZonesPage(board, ZoneEditor(zones), may_write=bool(token))
        self.metrics_text = MetricsText()
        self.token = token
        self.is_closing = False
        super().__init__((address.host, address.port), _Handler)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version = "mlbs-monitor"
    sys_version = ""
    timeout = 10  # s without data from the client

    def do_GET(self) -> None:
        """Answer with a file of the page, the status, or a picture."""
        url, board = urlsplit(self.path), self.server.board
        if url.path in _HEALTH:  # they tell nothing that needs a token
            self._answer_on_health(_HEALTH[url.path])
            return
        given = _token_of(url.query)
        # A player of pictures, which has another address, keeps no cookie.
        if given and url.path == "/" and self._is_token(given):
            # A cookie keeps the token from now on, so that it is not in the browser's history.
            headers = {"Location": "./", "Set-Cookie": f"{_COOKIE}={given}; HttpOnly; SameSite=Strict"}
            self._answer(HTTPStatus.SEE_OTHER, b"", "text/plain", headers)
            return
        if not self._is_allowed(given):
            return
        if url.path in _FILES:
            name, kind = _FILES[url.path]
            self._answer(HTTPStatus.OK, (_FOLDER / name).read_bytes(), kind)
        elif url.path == "/status.json":
            self._answer(HTTPStatus.OK, json.dumps(board.status()).encode(), "application/json")
        elif url.path == "/metrics":
            text = self.server.metrics_text(board.states, board.backlogs(), board.counts())
            self._answer(HTTPStatus.OK, text.encode(), CONTENT_TYPE)
        elif (stream := board.stream_in(url.path, "/streams/", ".mjpg")) is not None:
            self._send_on(stream)
        elif (zones := self.server.zones.get(url.path)) is not None:
            self._answer(zones.status, zones.content, zones.kind)
        elif (stream := board.stream_in(url.path, "/streams/", "/counts.json")) is not None:
            self._answer(HTTPStatus.OK, json.dumps(board.counts_of(stream)).encode(), "application/json")
        elif (recorded := board.recorded(url.path)) is not None:
            self._send_file(recorded)
        elif (picture := self._picture(url.path)) is not None:
            self._answer(HTTPStatus.OK, picture, "image/jpeg")
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "There is nothing here.")

    def do_PUT(self) -> None:
        """Take the zones of a stream that were drawn."""
        url = urlsplit(self.path)
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal()) or int(length[:9]) > MOST_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"Zones have at most {MOST_BYTES} bytes.")
            return
        body = self.rfile.read(int(length))  # first, as a browser reads no answer before it has sent all
        if self._is_allowed(_token_of(url.query)):
            zones = self.server.zones.put(url.path, self.headers, body)
            self._answer(zones.status, zones.content, zones.kind)

    def _is_allowed(self, given: str) -> bool:
        """Whether a request, which may have a token in its address, is answered; if not, say so."""
        if not self.server.token:
            if not self._is_for_loopback():
                # DNS rebinding: another site's name may point at this machine to read the page.
                self._refuse(HTTPStatus.FORBIDDEN, "Open this page at 127.0.0.1 or localhost.")
                return False
        elif not any(self._is_token(one) for one in (given, self._bearer(), self._cookie())):
            self._refuse(HTTPStatus.UNAUTHORIZED, "Open this page with ?token=… in its address.")
            return False
        return True

    def _answer_on_health(self, is_enough: Callable[[Board], bool]) -> None:
        if is_enough(self.server.board):
            self._answer(HTTPStatus.OK, b"ok\n", "text/plain; charset=utf-8")
        else:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "No stream is under way yet.")

    def log_message(self, format: str, *arguments: object) -> None:
        """Do nothing: the terminal belongs to the progress, and a line could contain the token."""

    def _send_on(self, name: str) -> None:
        """Send pictures of a stream until it ends, or the viewer leaves, or the run ends."""
        self._begin(HTTPStatus.OK, {"Content-Type": f"multipart/x-mixed-replace; boundary={BOUNDARY}"})
        try:
            for part in motion_jpeg(self.server.board, name):
                self.wfile.write(part)
                if self.server.is_closing:
                    break
        except OSError:
            pass  # the viewer is gone, or takes nothing
        self.close_connection = True

    def _send_file(self, recorded: RecordedFile) -> None:
        """Send a file of a record, or the part of it that a player asks for."""
        try:
            file = recorded.path.open("rb")
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND, "It is not there, or not yet.")
            return
        with file:
            size = os.fstat(file.fileno()).st_size
            asked = asked_range(self.headers.get("Range"), size)
            if asked is not None and not asked:
                headers = {"Content-Range": f"bytes */{size}"}
                self._answer(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, b"", "text/plain", headers)
                return
            part = range(size) if asked is None else asked
            own = {"Content-Type": recorded.kind, "Content-Length": str(len(part)), "Accept-Ranges": "bytes"}
            if asked is not None:
                own["Content-Range"] = f"bytes {part.start}-{part.stop - 1}/{size}"
            self._begin(HTTPStatus.OK if asked is None else HTTPStatus.PARTIAL_CONTENT, own)
            file.seek(part.start)
            try:
                for left in range(len(part), 0, -_CHUNK):
                    self.wfile.write(file.read(min(_CHUNK, left)))
            except OSError:
                self.close_connection = True  # the client is gone, or takes nothing

    def _picture(self, path: str) -> bytes | None:
        number = path.removeprefix("/pictures/").removesuffix(".jpg")
        if path != f"/pictures/{number}.jpg" or not (number.isascii() and number.isdecimal()):
            return None
        return self.server.board.picture(int(number[:9]))

    def _is_token(self, given: str) -> bool:
        return bool(self.server.token) and hmac.compare_digest(given.encode(), self.server.token.encode())

    def _bearer(self) -> str:
        return self.headers.get("Authorization", "").removeprefix("Bearer ")

    def _cookie(self) -> str:
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(_COOKIE)
        except CookieError:
            return ""
        return cookie.value if cookie else ""

    def _is_for_loopback(self) -> bool:
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        return MonitorAddress(host, 0).is_loopback

    def _refuse(self, status: HTTPStatus, sentence: str) -> None:
        self._answer(status, f"{sentence}\n".encode(), "text/plain; charset=utf-8")

    def _answer(
        self, status: HTTPStatus, content: bytes, kind: str, headers: dict[str, str] | None = None
    ) -> None:
        self._begin(status, {"Content-Type": kind, "Content-Length": str(len(content))} | (headers or {}))
        try:
            self.wfile.write(content)
        except ConnectionError:
            self.close_connection = True  # the client is gone

    def _begin(self, status: HTTPStatus, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in (_HEADERS | headers).items():
            self.send_header(name, value)
        self.end_headers()


def _token_of(query: str) -> str:
    return parse_qs(query).get("token", [""])[0]
