"""The page on which zones are drawn: what it shows, and what it takes from whom."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import cv2
import numpy as np
import pytest
from chromium import open_page

from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.monitor.board import Board
from orchestrator.monitor.server import serving
from orchestrator.run.edit_zones import ZoneFiles
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.live_picture import live_picture_path

TOKEN = "a-token-of-the-tests"
BEARER = {"Authorization": f"Bearer {TOKEN}"}
CAMERAS = """\
# ours
streams:
  gate:
    source: /dev/video0  # the old one
    zones:
      - {name: yard, polygon: [[16, 12], [48, 12], [48, 36]]}
      - {name: fence, kind: line, polygon: [[0.2, 0.9], [0.9, 0.8]]}
    rules:
      - {name: stays, dwell: {zone: yard, seconds: 5}}
  la ne: /dev/video1
"""


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    path = tmp_path / "cameras.yaml"
    path.write_text(CAMERAS)
    return path


@pytest.fixture
def board(tmp_path: Path) -> Board:
    board = Board(tmp_path, tmp_path / "out")
    board.update([StreamState("gate", "running"), StreamState("la ne", "running")])
    for name in ("gate", "la ne"):
        (tmp_path / "out" / name).mkdir(parents=True)
        cv2.imwrite(str(live_picture_path(tmp_path, name)), np.full((48, 64, 3), 99, np.uint8))
    cv2.imwrite(str(tmp_path / "out/gate/still.jpg"), np.full((48, 64, 3), 99, np.uint8))
    return board


@pytest.fixture
def port(board: Board, cameras: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    with served(board, ZoneFiles(cameras, watched=True)) as port:
        yield port


@contextmanager
def served(board: Board, files: ZoneFiles | None = None) -> Iterator[int]:
    with serving(MonitorAddress("127.0.0.1", 0), board, files) as url:
        yield int(url.split(":")[2].split("/")[0])


def ask(port: int, method: str, path: str, body: object = None, **headers: str) -> tuple[int, str]:
    connection = HTTPConnection("127.0.0.1", port)
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request(method, path, content if method == "PUT" else None, headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def zones_of(port: int, stream: str = "gate", **headers: str) -> dict[str, Any]:
    status, text = ask(port, "GET", f"/zones/{stream}.json", **(headers or BEARER))
    assert status == 200
    zones: dict[str, Any] = json.loads(text)
    return zones


def put(port: int, body: object, stream: str = "gate", **headers: str) -> tuple[int, str]:
    own = {"Content-Type": "application/json", "Origin": f"http://127.0.0.1:{port}", **BEARER} | headers
    return ask(port, "PUT", f"/zones/{stream}.json", body, **own)


def drawing(port: int, *zones: dict[str, Any], stream: str = "gate") -> dict[str, Any]:
    kept = [{"name": one["name"], "was": one["name"]} for one in zones_of(port, stream)["zones"]]
    return {"zones": [*kept, *zones], "version": zones_of(port, stream)["version"]}


DOOR = {"name": "door", "polygon": [[0.5, 0.5], [1, 0.5], [1, 1]]}


def test_zones_are_told_as_shares_of_the_picture_with_the_rules_that_name_them(port: int) -> None:
    told = zones_of(port)
    assert (told["size"], told["may_write"]) == ([64, 48], True)
    yard, fence = told["zones"]
    assert yard["polygon"] == [[0.25, 0.25], [0.75, 0.25], [0.75, 0.75]]
    assert (yard["rules"], fence["rules"], fence["kind"]) == (["stays"], [], "line")
    assert told["pictures"] == ["stills/gate.jpg", "pictures/0.jpg"]
    lane = zones_of(port, "la%20ne")
    assert (lane["zones"], lane["size"], lane["pictures"][0]) == ([], None, "stills/la%20ne.jpg")


def test_what_is_drawn_is_in_the_file_and_nothing_else_of_it_changes(port: int, cameras: Path) -> None:
    status, text = put(port, drawing(port, DOOR))
    assert status == 200
    assert [one["name"] for one in json.loads(text)["zones"]] == ["yard", "fence", "door"]
    line = "      - {name: door, polygon: [[0.5, 0.5], [1, 0.5], [1, 1]]}\n"
    assert cameras.read_text() == CAMERAS.replace("    rules:", f"{line}    rules:")
    assert put(port, drawing(port, DOOR, stream="la%20ne"), "la%20ne")[0] == 200
    assert cameras.read_text().endswith(f"  la ne:\n    source: /dev/video1\n    zones:\n{line}")


@pytest.mark.parametrize(
    ("headers", "status", "words"),
    [
        ({"Authorization": ""}, 401, "token"),
        ({"Authorization": "Bearer another"}, 401, "token"),
        ({"Origin": "http://evil.example"}, 403, "only taken from this page"),
        ({"Origin": "null"}, 403, "only taken from this page"),
        ({"Origin": ""}, 403, "only taken from this page"),
        ({"Sec-Fetch-Site": "cross-site"}, 403, "only taken from this page"),
        ({"Content-Type": "text/plain"}, 415, "application/json"),
    ],
)
def test_nobody_else_and_no_other_page_can_write(
    port: int, cameras: Path, headers: dict[str, str], status: int, words: str
) -> None:
    answered, text = put(port, drawing(port, DOOR), **headers)
    assert (answered, words in text) == (status, True)
    assert cameras.read_text() == CAMERAS


def test_a_page_behind_a_proxy_is_known_by_what_the_browser_says_of_it(port: int) -> None:
    behind = {"Origin": "https://cameras.example", "Sec-Fetch-Site": "same-origin"}
    assert put(port, drawing(port, DOOR), **behind)[0] == 200


def test_without_a_token_zones_are_shown_and_never_written(
    board: Board, cameras: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    with served(board, ZoneFiles(cameras)) as port:
        told = zones_of(port, Host="localhost")
        assert (len(told["zones"]), told["may_write"]) == (2, False)
        assert f"set {TOKEN_VARIABLE} to at least 16" in told["note"]
        assert put(port, drawing(port, DOOR))[0] == 403
        assert put(port, drawing(port, DOOR), Host="evil.example")[0] == 403
    assert cameras.read_text() == CAMERAS


@pytest.mark.parametrize(
    ("zone", "status", "words"),
    [
        ({"name": "door", "polygon": [[0, 0], [1, 1]]}, 409, "Door: the polygon of a zone needs at least 3"),
        ({"name": "yard", "polygon": DOOR["polygon"]}, 409, "Two zones are named 'yard'"),
        ({"name": "", "polygon": DOOR["polygon"]}, 422, "zones.2.name"),
        ({"name": "door", "polygon": [[0, 2], [1, 1], [1, 0]]}, 422, "less than or equal to 1"),
        ({"name": "do\x85or", "polygon": DOOR["polygon"]}, 422, "a name is one line"),
        ({"name": "door"}, 422, "the new zone 'door' has no points"),
        ({"name": "door", "fixed_to": "scene", "polygon": DOOR["polygon"]}, 422, "zones.2.fixed_to"),
        ({"name": "door", "was": "gone"}, 409, "There is no zone 'gone' any more"),
    ],
)
def test_a_faulty_zone_is_told_in_words(
    port: int, cameras: Path, zone: dict[str, Any], status: int, words: str
) -> None:
    answered, text = put(port, drawing(port, zone))
    assert (answered, words in text) == (status, True), text
    assert cameras.read_text() == CAMERAS


def test_what_is_no_drawing_or_too_long_is_refused(port: int, cameras: Path) -> None:
    assert put(port, b"{")[0] == 422
    assert put(port, b'{"zones": [], "version": "\\ud800"}')[0] == 422
    assert put(port, b" " * (1 << 18) + b"{}")[0] == 413
    assert put(port, drawing(port), "nobody")[0] == 404
    assert put(port, {"zones": [], "version": "of before"}) == (
        409,
        "Somebody else has changed these zones since; reload the page.\n",
    )
    for path in ("/zones/", "/zones/nobody", "/zones/../run.json", "/zones/gate.json/"):
        assert ask(port, "GET", path, **BEARER)[0] == 404
    assert cameras.read_text() == CAMERAS


def test_the_page_says_when_what_is_saved_counts_and_what_to_do_where_nothing_can_be(
    board: Board, cameras: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    with served(board, ZoneFiles(cameras)) as port:
        assert "counts from the next start" in zones_of(port)["note"]
    with served(board) as port:
        told = zones_of(port)
        assert (told["may_write"], "write its streams into a file of cameras" in told["note"]) == (
            False,
            True,
        )
        answered, text = put(port, {"zones": [DOOR], "version": ""})
        assert (answered, "cameras.yaml" in text) == (409, True)


# In a browser, which sees the page below a path of another address

HAND = """
const after = (wait) => new Promise((done) => setTimeout(done, wait));
const stage = document.getElementById("stage");
function point(kind, x, y) {
  const box = stage.getBoundingClientRect();
  const place = { clientX: box.left + x * box.width, clientY: box.top + y * box.height };
  const under = document.elementFromPoint(place.clientX, place.clientY) || stage;
  under.dispatchEvent(new PointerEvent(kind, { ...place, pointerId: 1, bubbles: true, cancelable: true }));
}
function click(x, y) {
  for (const kind of ["pointermove", "pointerdown", "pointerup"]) point(kind, x, y);
}
function press(key) {
  document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
}
function type(words) {
  const name = document.activeElement;
  name.value = words;
  for (const kind of ["input", "change"]) name.dispatchEvent(new Event(kind, { bubbles: true }));
}
(async () => {
  stage.setPointerCapture = () => {}; // there is no real pointer here
  while (!document.querySelector("img[src]")) await after(50);
  document.getElementById("zone").click();
  for (const [x, y] of [[0.1, 0.6], [0.3, 0.6], [0.8, 0.1], [0.3, 0.9]]) {
    click(x, y);
    if (x === 0.8) press("Escape");
  }
  press("Enter");
  type("Tür: <b>");
  document.getElementById("line").click();
  for (const [x, y] of [[0.2, 0.2], [0.2, 0.4]]) click(x, y);
  press("Enter");
  type("Tür: <b>");
  document.getElementById("save").click(); // two of one name
  document.body.title = document.getElementById("fault").textContent;
  type("way");
  point("pointerdown", 0.2, 0.4); // the end of the line is moved
  point("pointermove", 0.4, 0.4);
  point("pointerup", 0.4, 0.4);
  document.getElementById("save").click();
})();
"""


@contextmanager
def below_a_path(port: int) -> Iterator[str]:
    """Serve the monitor below /cams/ of another port, to one who knows the token, with a hand that draws."""

    class Proxy(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path == "/cams/hand.js":
                self._send(200, "text/javascript", HAND.encode())
                return
            assert self.path.startswith("/cams/")
            connection = HTTPConnection("127.0.0.1", port)
            length = int(self.headers.get("Content-Length", 0))
            passed = {key: value for key, value in self.headers.items() if key != "Connection"} | BEARER
            path = self.path.removeprefix("/cams")
            connection.request(self.command, path, self.rfile.read(length) or None, passed)
            answer = connection.getresponse()
            content, kind = answer.read(), answer.getheader("Content-Type") or ""
            if kind.startswith("text/html"):
                content = content.replace(
                    b"</body>", b'<script type="module" src="../hand.js"></script></body>'
                )
            self._send(answer.status, kind, content)

        do_PUT = do_GET  # noqa: N815, the name that the server looks for

        def _send(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/cams/"
        server.shutdown()


def test_a_browser_draws_a_polygon_and_a_line_and_saves_them(port: int, cameras: Path) -> None:
    with below_a_path(port) as url:
        page = open_page(f"{url}zones/gate", seconds=12)
    assert page.console == []
    assert "Not saved. Two are named" in page.document  # as long as that was so
    said = re.findall(r'<p id="(?:note|fault)"[^>]*>([^<]*)', page.document)
    assert said == ["Saved. The run follows what is saved within seconds.", ""]
    words = re.findall(r"<text[^>]*>([^<]*)", page.document)
    assert {"yard", "fence", "left", "right", "way"} <= set(words)
    door, way = zones_of(port)["zones"][2:]
    assert (door["name"], door["kind"]) == ("Tür: <b>", "zone")
    assert np.allclose(door["polygon"], [[0.1, 0.6], [0.3, 0.6], [0.3, 0.9]], atol=0.01)
    assert (way["name"], way["kind"]) == ("way", "line")
    assert np.allclose(way["polygon"], [[0.2, 0.2], [0.4, 0.4]], atol=0.01)
    assert cameras.read_text().startswith(CAMERAS[: CAMERAS.index("    rules:")])


def test_all_addresses_of_the_page_are_relative(port: int) -> None:
    for path in ("/zones/gate", "/zones.js", "/zones.css", "/zone_shapes.js", "/zone_words.js"):
        status, text = ask(port, "GET", path, **BEARER)
        assert status == 200
        assert not re.search(r"""(?:href|src)=["']/|fetch\(["'`]/|from ["']/""", text)
