"""The live page: what it answers, to whom, and what a browser makes of it."""

from __future__ import annotations

import json
import re
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.client import HTTPConnection, HTTPResponse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from chromium import open_page
from coded_video import write_video
from record_fakes import frame, segmentation

from mlbs_actors.actors.stream.protocol import StreamProgress
from mlbs_actors.errors import ConfigError
from mlbs_actors.source import SourceSilence
from orchestrator.counts.stream_counts import StreamCounts
from orchestrator.events.delivery import Backlog
from orchestrator.events.zones import EventRules, Zone
from orchestrator.monitor.address import TOKEN_VARIABLE, MonitorAddress
from orchestrator.monitor.board import Board
from orchestrator.monitor.metrics import MetricsText
from orchestrator.monitor.server import serving
from orchestrator.run.stream_state import StateName, StreamState, after_progress, after_start
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.live_picture import LivePicture, live_picture_path, watch
from orchestrator.sinks.record import StreamRecord
from orchestrator.sinks.still import Still

ROOT = Path(__file__).resolve().parents[3]
TOKEN = "a-token-of-the-tests"
HERE = MonitorAddress("127.0.0.1", 0)
COUNTS = StreamCounts(
    objects=2, zones={'the "yard"': 1}, crossings={"fence": {"left": 3, "right": 0}}, events={"entered": 4}
)
STATES = [
    StreamState("yard", "running", read=20, committed=8, layers=3, frames_per_second=4.25, latency_ms=312.4),
    StreamState("<b>", "failed", error="The file <is> gone."),
    after_start(StreamState("late")),
]


@pytest.fixture
def board(tmp_path: Path) -> Board:
    board = Board(tmp_path, tmp_path / "out", lambda: [Backlog("mqtt://broker/***", 3, 0.0)])
    for read in (8, 16, 20):
        board.update([after_progress(STATES[0], progress(read), 4.25), *STATES[1:]])
    picture = LivePicture(live_picture_path(tmp_path, "yard"))
    picture.show(LabelledPicture(np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.uint16), 7, 0.0))
    return board


@pytest.fixture
def url(board: Board, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    with serving(HERE, board) as url:
        yield url


def progress(read: int) -> StreamProgress:
    return StreamProgress(
        read=read,
        committed=8,
        quarantined=0,
        dropped=0,
        layers=2,
        done=False,
        stage_ms={"a": 300, "b": 12.4},
        length=37,
    )


def get(url: str, path: str = "/", **headers: str) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", int(url.split(":")[2].split("/")[0]))
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


# What it tells


def test_the_status_tells_of_every_stream_what_it_does_and_what_waits(url: str) -> None:
    answer, body = get(url, "/status.json")
    assert answer.status == 200
    yard, failed, late = json.loads(body)["streams"]
    assert (yard["state"], yard["read"], yard["committed"], yard["queued"]) == ("running", 20, 8, 12)
    assert (yard["frames_per_second"], yard["latency_ms"], yard["dropped"]) == (4.25, 312.4, 0)
    assert yard["layers_over_time"] == [[8, 2], [16, 2], [20, 2]]
    assert (yard["length"], yard["seconds_left"]) == (37, 4.0)
    assert (yard["waits_for"], late["waits_for"]) == (None, "its processes and its first frames")
    assert failed["error"] == "The file <is> gone."
    assert [one["rank"] for one in (yard, failed, late)] == [0, 1, 0]
    assert (failed["picture"], late["picture"], late["state"]) == (None, None, "starting")


def test_pictures_are_those_of_the_stream_at_that_place(url: str) -> None:
    answer, body = get(url, "/pictures/0.jpg?1")
    assert answer.getheader("Content-Type") == "image/jpeg"
    picture = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (48, 64, 3)
    for path in (
        "/pictures/1.jpg",
        "/pictures/99.jpg",
        "/pictures/-1.jpg",
        "/pictures/../run.json",
        "/run.json",
    ):
        assert get(url, path)[0].status == 404


def test_prometheus_gets_a_sample_for_every_stream_and_metric(url: str) -> None:
    answer, body = get(url, "/metrics")
    assert (answer.getheader("Content-Type") or "").startswith("text/plain; version=0.0.4")
    samples = dict(line.rsplit(" ", 1) for line in body.decode().splitlines() if not line.startswith("#"))
    assert samples['mlbs_stream_read_frames_total{stream="yard"}'] == "20.0"
    assert samples['mlbs_stream_queued_frames{stream="yard"}'] == "12.0"
    assert float(samples['mlbs_stream_latency_seconds{stream="yard"}']) == pytest.approx(0.3124)
    assert samples['mlbs_stream_state{stream="<b>",state="failed"}'] == "1"
    kinds = [line.split()[2] for line in body.decode().splitlines() if line.startswith("# TYPE")]
    assert len(kinds) == len(set(kinds)) == (len(samples) - 3) / 3 + 3
    assert samples['mlbs_events_waiting{target="mqtt://broker/***"}'] == "3.0"
    assert float(samples['mlbs_events_away_seconds{target="mqtt://broker/***"}']) > 1e9
    hostile = MetricsText()([StreamState('a"b\\c')])
    assert 'stream="a\\"b\\\\c"' in hostile


def test_without_targets_of_events_there_are_no_samples_of_them() -> None:
    assert "mlbs_events" not in MetricsText()(STATES)


def test_a_counter_does_not_fall_when_a_stream_goes_back() -> None:
    text, name = MetricsText(), "mlbs_stream_read_frames_total"
    told = [text([replace(STATES[0], read=read)]) for read in (40, 32, 41)]
    assert [float(one.split(f'{name}{{stream="yard"}} ')[1].split()[0]) for one in told] == [40, 40, 41]


def test_grafanas_board_asks_for_all_that_the_page_serves_and_nothing_else() -> None:
    text = (ROOT / "configs/grafana.json").read_text(encoding="utf-8")
    panels = json.loads(text)["panels"]
    queries = [target["expr"] for panel in panels for target in panel["targets"]]
    page = MetricsText()(STATES, [Backlog("mqtt://broker/***", 3, None)], {"yard": COUNTS})
    served = set(re.findall(r"^# TYPE (\S+)", page, re.MULTILINE))
    assert {name for query in queries for name in re.findall(r"mlbs_\w+", query)} == served
    assert set(re.findall(r"mlbs_\w+", text)) == served  # those that the choice of streams asks for too
    labels = set(re.findall(r"(\w+)=\"", page))
    assert (
        set(re.findall(r"\{\{(\w+)\}\}", text))
        == labels
        == {*("stream", "state", "target", "zone", "line", "direction", "kind")}
    )
    assert len({panel["id"] for panel in panels}) == len(panels)


def test_the_past_of_a_long_run_keeps_its_span_in_bounded_room(tmp_path: Path) -> None:
    board = Board(tmp_path, tmp_path)
    for read in range(1, 5001):
        board.update([StreamState("a", "running", read=read, layers=2)])
    past = board.status()["streams"][0]["layers_over_time"]
    assert len(past) <= 240
    assert (past[0][0], past[-1][0]) == (1, 5000)


def test_the_latency_is_the_sum_of_the_stages_and_stays_when_a_burst_labelled_nothing() -> None:
    state = after_progress(StreamState("a"), progress(8), 1.0)
    assert state.latency_ms == pytest.approx(312.4)
    nothing = StreamProgress(16, 8, 0, 0, 2, False)
    assert after_progress(state, nothing, 1.0).latency_ms == pytest.approx(312.4)


@pytest.mark.parametrize("away", ["stalled", "reconnecting"])
def test_a_camera_that_sends_nothing_has_no_rate(away: Literal["stalled", "reconnecting"]) -> None:
    silent = replace(progress(8), silence=SourceSilence(away, "The camera is away."))
    state = after_progress(StreamState("gate", "running", frames_per_second=4.0), silent, 3.5)
    assert (state.state, state.frames_per_second, state.seconds_left) == (away, 0.0, None)
    usual = replace(progress(8), silence=SourceSilence(None))
    assert after_progress(state, usual, 3.5).frames_per_second == 3.5


def test_the_status_has_the_last_events_and_the_page_their_pictures(
    board: Board, url: str, tmp_path: Path
) -> None:
    zone = Zone(name="here", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    record = StreamRecord(tmp_path / "out/yard", "yard", frozenset(), rules=EventRules((zone,)))
    for index in range(14):
        record.write(segmentation(index, 3, *([5] if index // 5 % 2 else [])), frame(index))
    yard, *others = json.loads(get(url, "/status.json")[1])["streams"]
    assert [one["events"] for one in others] == [[], []]
    assert 4 < len(yard["events"]) <= 10
    written = (tmp_path / "out/yard/events.jsonl").read_text().splitlines()
    assert yard["events"] == [json.loads(line) for line in written[-10:]]
    pictures = [event["picture"] for event in yard["events"] if event["picture"] is not None]
    assert pictures
    answer, body = get(url, f"/records/yard/{pictures[-1]}")
    assert (answer.status, answer.getheader("Content-Type"), body[:2]) == (200, "image/jpeg", b"\xff\xd8")
    for path in ("yard/events/../events.jsonl", "yard/events/nothing.jpg", "nobody/" + pictures[-1], "yard"):
        assert get(url, f"/records/{path}")[0].status == 404


CLIP = "clips/00000012-0123abcd.mp4"


@pytest.fixture
def clip(tmp_path: Path) -> bytes:
    path = tmp_path / "out/yard" / CLIP
    path.parent.mkdir(parents=True)
    return write_video(path, 6).read_bytes()


@pytest.mark.parametrize(
    ("asked", "status", "expected"),
    [
        (None, 200, slice(None)),
        ("bytes=0-", 206, slice(None)),
        ("bytes=10-19", 206, slice(10, 20)),
        ("bytes=-7", 206, slice(-7, None)),
        ("bytes=100-999999", 206, slice(100, None)),
        ("bytes=0-1,5-6", 200, slice(None)),
        ("pages=1-2", 200, slice(None)),
        ("bytes=-", 200, slice(None)),
    ],
)
def test_a_player_gets_the_part_of_a_clip_that_it_asks_for(
    url: str, clip: bytes, asked: str | None, status: int, expected: slice
) -> None:
    answer, body = get(url, f"/records/yard/{CLIP}", **({} if asked is None else {"Range": asked}))
    assert (answer.status, body) == (status, clip[expected])
    assert answer.getheader("Content-Type") == "video/mp4"
    assert answer.getheader("Accept-Ranges") == "bytes"
    first, last, _ = expected.indices(len(clip))
    whole = f"bytes {first}-{last - 1}/{len(clip)}"
    assert answer.getheader("Content-Range") == (whole if status == 206 else None)


def test_a_part_at_a_place_of_thousands_of_digits_is_none(url: str, clip: bytes) -> None:
    for asked in (f"bytes={'9' * 5000}-", f"bytes=-{'9' * 5000}", f"bytes=0-{'9' * 5000}"):
        answer, body = get(url, f"/records/yard/{CLIP}", Range=asked)
        assert (answer.status, body) == (200, clip)


def test_a_part_that_a_clip_does_not_have_is_refused(url: str, clip: bytes) -> None:
    for asked in (f"bytes={len(clip)}-", "bytes=9-3", "bytes=-0"):
        answer, body = get(url, f"/records/yard/{CLIP}", Range=asked)
        assert (answer.status, body) == (416, b"")
        assert answer.getheader("Content-Range") == f"bytes */{len(clip)}"


def test_nothing_but_pictures_and_clips_of_its_streams_is_served(
    url: str, clip: bytes, tmp_path: Path
) -> None:
    (tmp_path / "out/other/clips").mkdir(parents=True)
    (tmp_path / "out/other" / CLIP).write_bytes(b"of no stream of this run")
    (tmp_path / "out/yard/events.jsonl").write_bytes(b"lines")
    name = CLIP.removeprefix("clips/")
    for path in (
        "yard/events.jsonl",
        "yard/clips/",
        "yard/clips/../events.jsonl",
        "yard/clips/%2e%2e/events.jsonl",
        f"other/{CLIP}",
        f"yard/../other/{CLIP}",
        f"yard%2f..%2fother/{CLIP}",
        f"yard/events/{name}",
        "yard/clips/00000013-0123abcd.mp4",
        f"yard//clips/{name}",
        "yard",
        "",
    ):
        assert get(url, f"/records/{path}")[0].status == 404, path
    assert get(url, f"/{CLIP}")[0].status == 404


def test_clips_and_stills_need_the_token_as_the_page_does(
    board: Board, clip: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    (tmp_path / "out/yard/still.jpg").write_bytes(b"a picture")
    with serving(HERE, board) as url:
        for path in (f"/records/yard/{CLIP}", "/stills/yard.jpg"):
            assert get(url, path)[0].status == 401
            assert get(url, path, Authorization=f"Bearer {TOKEN}")[0].status == 200


def test_a_still_is_served_and_a_newer_one_asked_for(url: str, tmp_path: Path) -> None:
    assert get(url, "/stills/yard.jpg")[0].status == 404  # there is none yet
    folder = tmp_path / "out/yard"
    still = Still(folder.parent / "yard", lambda: 0.0)
    folder.mkdir(parents=True)
    still.show(np.zeros((48, 64, 3), np.uint8))
    answer, body = get(url, "/stills/yard.jpg")
    assert (answer.status, answer.getheader("Content-Type"), body[:2]) == (200, "image/jpeg", b"\xff\xd8")
    assert (folder / ".still-asked").exists()
    for path in ("/stills/nobody.jpg", "/stills/yard", "/stills/../out/yard.jpg", "/stills/yard.jpg.jpg"):
        assert get(url, path)[0].status == 404


_PLAYER = """<body><video muted src="{address}"></video><script>
const film = document.querySelector("video"), said = document.createElement("p");
document.body.append(said);
film.onloadedmetadata = () => {{ film.currentTime = 4.4; }};
film.onseeked = () => {{
  said.textContent = `${{film.duration}} s, ${{film.videoWidth}} px, at ${{film.currentTime}} s`;
}};
film.onerror = () => {{ said.textContent = film.error.message; }};
</script>"""


def test_a_browser_plays_a_clip_from_any_time(url: str, clip: bytes) -> None:
    page = _PLAYER.format(address=f"{url}records/yard/{CLIP}").encode()

    class Pages(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Pages) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        opened = open_page(f"http://127.0.0.1:{server.server_port}/", seconds=10)
        server.shutdown()
    assert "6 s, 64 px, at 4.4 s" in opened.document


def test_the_page_has_an_events_picture_and_its_clip(
    board: Board, clip: bytes, url: str, tmp_path: Path
) -> None:
    picture = "events/00000012-3.jpg"
    line = {"id": "a", "kind": "entered", "clock": None, "time": 1.2, "object": 3, "zone": "here"}
    line |= {"direction": None, "picture": picture, "clip": CLIP}
    (tmp_path / "out/yard/events.jsonl").write_text(json.dumps(line) + "\n")
    page = open_page(url, seconds=3)
    assert f'src="records/yard/{picture}"' in page.document
    assert f'href="records/yard/{CLIP}"' in page.document


@pytest.fixture
def counted(board: Board, tmp_path: Path) -> Path:
    """A record in which an object walks through a zone and over a line."""
    there = Zone(name="here", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
    fence = Zone(name="fence", kind="line", polygon=((0.3, 0), (0.3, 1)))
    folder = tmp_path / "out/yard"
    record = StreamRecord(folder, "yard", frozenset(), rules=EventRules((there, fence)))
    for index in range(30):
        record.write(segmentation(index, 3), frame(index))
    record.close(whole=False)
    return folder


def test_prometheus_gets_what_is_counted_of_zones_lines_and_events(counted: Path, url: str) -> None:
    samples = dict(line.rsplit(" ", 1) for line in get(url, "/metrics")[1].decode().splitlines())
    assert samples['mlbs_zone_objects{stream="yard",zone="here"}'] == "1"
    assert samples['mlbs_line_crossings_total{stream="yard",line="fence",direction="left"}'] == "1"
    assert samples['mlbs_events_total{stream="yard",kind="entered"}'] == "1"


def test_the_page_gets_the_rows_of_the_last_hours_and_the_heat_map(counted: Path, url: str) -> None:
    yard, *others = json.loads(get(url, "/status.json")[1])["streams"]
    assert yard["counts"] is not None
    assert [one["counts"] for one in others] == [None, None]
    counts = json.loads(get(url, "/streams/yard/counts.json")[1])
    assert [(row["place"], row["kind"]) for row in counts["hours"]] == [
        ("", "picture"),
        ("fence", "line"),
        ("here", "zone"),
    ]
    assert sum(counts["heat"]["label_maps"]) == 30
    assert get(url, "/streams/nobody/counts.json")[0].status == 404


def test_other_viewers_get_the_pictures_as_motion_jpeg_until_the_stream_ends(
    board: Board, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.monitor.restream._REPEAT_SECONDS", 1e6)
    live = LivePicture(live_picture_path(tmp_path, "yard"))
    connection = HTTPConnection("127.0.0.1", int(url.split(":")[2].split("/")[0]))
    connection.request("GET", "/streams/yard.mjpg")
    answer = connection.getresponse()
    assert answer.getheader("Content-Type") == "multipart/x-mixed-replace; boundary=picture"

    def part() -> int:
        """The brightness of the next picture."""
        head = [answer.readline() for _ in range(4)]
        assert head[0] == b"--picture\r\n"
        jpeg = answer.read(int(head[2].split()[1]) + 2)[:-2]
        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        return round(float(picture[-1, -1].mean()))

    assert part() < 130  # that of the fixture, all of it one object
    live.show(LabelledPicture(np.full((48, 64, 3), 200, np.uint8), np.zeros((48, 64), np.uint16), 8, 0.0))
    assert part() == 200
    board.update([replace(STATES[0], state="done"), *STATES[1:]])
    assert answer.read() == b""
    assert get(url, "/streams/nobody.mjpg")[0].status == 404


# To whom


def test_another_sites_name_for_this_machine_is_refused(url: str) -> None:
    assert get(url, "/status.json", Host="evil.example")[0].status == 403
    assert get(url, "/status.json", Host="localhost:1234")[0].status == 200


@pytest.mark.parametrize("token", ["", "short"])
def test_elsewhere_than_on_this_machine_a_token_is_demanded(
    board: Board, monkeypatch: pytest.MonkeyPatch, token: str
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, token)
    with pytest.raises(ConfigError, match=TOKEN_VARIABLE), serving(MonitorAddress("0.0.0.0", 0), board):
        pass


def test_who_knows_the_token_gets_in_by_address_cookie_or_header_and_nobody_else(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    with serving(MonitorAddress("0.0.0.0", 0), board) as url:
        assert TOKEN not in url
        for path in ("/", "/status.json", "/pictures/0.jpg", "/?token=wrong"):
            answer, body = get(url, path)
            assert (answer.status, TOKEN in body.decode()) == (401, False)
        answer, _ = get(url, f"/?token={TOKEN}")
        assert (answer.status, answer.getheader("Location")) == (303, "./")
        cookie = answer.getheader("Set-Cookie") or ""
        assert "HttpOnly" in cookie
        assert get(url, "/status.json", Cookie=cookie.partition(";")[0])[0].status == 200
        assert get(url, "/status.json", Authorization=f"Bearer {TOKEN}")[0].status == 200
        assert get(url, f"/streams/<b>.mjpg?token={TOKEN}")[0].status == 200  # a player keeps no cookie
        assert get(url, "/streams/<b>.mjpg?token=wrong")[0].status == 401
        assert get(url, "/status.json", Cookie="mlbs-monitor=wrong; \x7f")[0].status == 401


@pytest.mark.parametrize("state", [None, "waiting", "starting", "running", "stalled", "failed"])
def test_probes_need_no_token_and_learn_whether_a_stream_is_under_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, state: StateName | None
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    board = Board(tmp_path, tmp_path)
    board.update([] if state is None else [StreamState("a", state), StreamState("b")])
    with serving(MonitorAddress("0.0.0.0", 0), board) as url:
        assert get(url, "/healthz", Host="pod.cluster")[0].status == 200
        ready = get(url, "/readyz", Host="pod.cluster")[0].status
        assert ready == (200 if state in ("running", "stalled") else 503)


def test_the_page_can_be_served_below_a_path(url: str) -> None:
    for path in ("/", "/monitor.js", "/monitor.css"):
        text = get(url, path)[1].decode()
        assert not re.search(r"""(?:href|src)=["']/|fetch\(["'`]/|["'`(]/(?:pictures|streams)/""", text)


# Its life


def test_the_port_is_free_and_the_thread_gone_once_the_run_ends_even_if_someone_looks_on(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Nobody but the end of the run sends the one who looks on away.
    monkeypatch.setattr("orchestrator.monitor.server._Handler.timeout", None)
    with serving(HERE, board) as url:
        port = int(url.split(":")[2].split("/")[0])
        lingering = socket.create_connection(("127.0.0.1", port))
    assert not any(thread.name == "monitor" for thread in threading.enumerate())
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))
    lingering.close()


def test_a_port_that_is_taken_is_refused_with_a_sentence(board: Board) -> None:
    with serving(HERE, board) as url:
        taken = MonitorAddress("127.0.0.1", int(url.split(":")[2].split("/")[0]))
        with pytest.raises(ConfigError, match="cannot listen at"), serving(taken, board):
            pass


# Live pictures


def test_a_live_picture_is_replaced_twice_a_second_and_at_most_640_wide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.sinks.live_picture._LOOK_SECONDS", 1e6)
    now = [0.0]
    live = LivePicture(tmp_path / "a.jpg", lambda: now[0])
    written = []
    for index in range(13):
        now[0] = index / 10
        live.show(
            LabelledPicture(
                np.full((500, 1000, 3), 8 * index, np.uint8), np.zeros((500, 1000), np.uint16), index, 0.0
            )
        )
        picture = cv2.imread(str(tmp_path / "a.jpg"))
        assert picture is not None
        assert picture.shape == (320, 640, 3)
        written.append(round(float(picture[-1, -1].mean()) / 8))
    assert written == [0] * 5 + [5] * 5 + [10] * 3
    live.close()  # of a stream that is over the last frame is to be seen
    picture = cv2.imread(str(tmp_path / "a.jpg"))
    assert picture is not None
    assert round(float(picture[-1, -1].mean()) / 8) == 12
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]
    watch(tmp_path / "a.jpg")
    for index in range(13, 16):  # ten times a second for somebody who watches
        now[0] = index / 9
        live.show(
            LabelledPicture(
                np.full((500, 1000, 3), 8 * index, np.uint8), np.zeros((500, 1000), np.uint16), index, 0.0
            )
        )
        picture = cv2.imread(str(tmp_path / "a.jpg"))
        assert picture is not None
        assert round(float(picture[-1, -1].mean()) / 8) == index


def test_a_record_shows_its_frames_and_no_trouble_with_that_reaches_it(tmp_path: Path) -> None:
    for name in ("live", "gone"):
        picture = tmp_path / name / "a.jpg"
        if name == "live":
            picture.parent.mkdir()
        record = StreamRecord(tmp_path / f"stream-{name}", "a", frozenset({"masks"}), LivePicture(picture))
        record.write(segmentation(0), frame(0))
        assert record.close(whole=True) == 1
        assert picture.exists() == (name == "live")


# In a browser


@pytest.mark.long
def test_a_browser_draws_the_counts_when_they_are_opened(
    counted: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = 'copy.querySelector(".counts").open = true;'
    script = (
        (ROOT / "orchestrator/monitor/monitor.js")
        .read_text()
        .replace("list.append(copy);", opened + "list.append(copy);")
    )
    (counted.parent / "monitor.js").write_text(script)
    for name in ("page.html", "monitor.css"):
        (counted.parent / name).write_bytes((ROOT / "orchestrator/monitor" / name).read_bytes())
    monkeypatch.setattr("orchestrator.monitor.server._FOLDER", counted.parent)
    page = open_page(url, seconds=3)
    assert page.console == []
    assert 'aria-label="fence: to the left 1, to the right 0; at most 1 an hour"' in page.document
    assert "<title>hour 0: 1 entered</title>" in page.document
    assert re.search(r'aria-label="Cells in which objects stood: \d+ of 2304"', page.document)


@pytest.mark.long
def test_a_browser_shows_every_stream_without_complaint(url: str) -> None:
    page = open_page(url, seconds=3)
    assert page.console == []
    for words in ('<h2 id="name-0">yard</h2>', "&lt;b&gt;", "The file &lt;is&gt; gone.", "312", "4.3"):
        assert words in page.document
    for words in ("20 of 37", "00:00:04", "waits for its processes and its first frames"):
        assert words in page.document
    assert "1 running, 1 starting, 1 failed" in page.document
    assert "3 events wait for mqtt://broker/***, away since " in page.document
    assert 'alt="Newest frame of yard with its objects outlined and numbered"' in page.document
    assert "layers over time, at most 2" in page.document
    # In the document itself, which is what a keyboard and a screen reader go through.
    assert re.findall(r'<h2 id="name-\d">(.*?)</h2>', page.document) == ["yard", "late", "&lt;b&gt;"]


@pytest.mark.long
def test_a_browser_shows_fifty_streams_with_their_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    board = Board(tmp_path, tmp_path)
    names = [f"camera {number}" for number in range(50)]
    for read in (8, 16):
        board.update([StreamState(name, "running", read=read, layers=2) for name in names])
    event = {"clock": None, "time": 1.25, "object": 4, "zone": "yard", "kind": "entered", "direction": None}
    for name in names:
        LivePicture(live_picture_path(tmp_path, name)).show(
            LabelledPicture(np.zeros((48, 64, 3), np.uint8), np.zeros((48, 64), np.uint16), 7, 0.0)
        )
        (tmp_path / name).mkdir()
        line = json.dumps(event | {"id": name, "picture": "events/00000007-4.jpg"}) + "\n"
        (tmp_path / name / "events.jsonl").write_text(line, encoding="utf-8")
    with serving(HERE, board) as url:
        page = open_page(url, seconds=3)
    assert page.console == []
    assert len(re.findall("<article", page.document)) == 51  # with that of the template
    assert page.document.count("1.3 s: 4 entered yard") == 100
    loaded = len(re.findall(r' src="pictures/\d+\.jpg', page.document))
    assert 0 < loaded < 50  # those in sight
