"""Cameras: what is dropped, what is missing, what happens when one goes away and comes back."""

from __future__ import annotations

import queue
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import av
import av.error
import cv2
import numpy as np
import pytest
from camera_server import camera, free_port, needs_rtsp_server
from http_camera import PICTURES, http_camera

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame, SourceSilence
from orchestrator.retries import retry_seconds
from orchestrator.sources import live
from orchestrator.sources.address import parse_address
from orchestrator.sources.connection import Connection, LibavConnection, connect
from orchestrator.sources.libav import reason
from orchestrator.sources.live import LiveReader
from orchestrator.sources.live_buffer import CAPACITY, LiveBuffer, LiveTime, Picture


def image(value: int) -> Array:
    return np.full((4, 6, 3), value, np.uint8)


def picture(value: int, at: float | None = None) -> Picture:
    return Picture(at, lambda: image(value))


# What is kept and what makes way


def test_the_newest_pictures_are_kept_and_every_other_is_a_row_in_its_place() -> None:
    buffer = LiveBuffer()
    for number in range(6):
        buffer.put(picture(number), number / 10)
    frames = [buffer.take()() for _ in range(len(buffer))]
    assert [frame.index for frame in frames] == list(range(6))
    assert [frame.status for frame in frames] == ["dropped"] * (6 - CAPACITY) + ["ok"] * CAPACITY
    assert [frame.pts for frame in frames] == [number / 10 for number in range(6)]
    assert [None if frame.image is None else int(frame.image[0, 0, 0]) for frame in frames] == [
        *[None] * (6 - CAPACITY),
        *range(6 - CAPACITY, 6),
    ]


def test_of_any_puts_and_takes_no_row_is_lost_and_few_pictures_are_held() -> None:
    rng = np.random.default_rng(3)
    buffer, rows, held, most = LiveBuffer(), 0, [], 0
    taken: list[SourceFrame] = []
    for step in range(500):
        action = rng.integers(10)
        if action < 6:
            buffer.put(picture(step % 256), float(step))
            rows += 1
        elif action < 7:
            buffer.gap(float(step))
            rows += 1
        elif len(buffer):
            taken.append(buffer.take()())
        held = [row for row in buffer._rows if row.picture is not None]
        most = max(most, len(held))
    taken += [buffer.take()() for _ in range(len(buffer))]
    assert most == CAPACITY
    assert [frame.index for frame in taken] == list(range(rows))
    assert {frame.status for frame in taken} == {"ok", "dropped", "gap"}


def test_a_picture_that_cannot_be_decoded_is_quarantined() -> None:
    buffer = LiveBuffer()
    buffer.put(Picture(0.0, lambda: None), 0.0)
    assert buffer.take()().status == "quarantined"


# Times


def test_times_are_the_camera_s_own_from_its_first_picture() -> None:
    times = LiveTime()
    assert [times.of(900.0 + t, 50.0 + t + late) for t, late in ((0, 0), (0.1, 0.04), (0.2, 0.01))] == (
        pytest.approx([0, 0.1, 0.2])
    )


def test_a_picture_that_waited_for_its_connection_was_taken_earlier() -> None:
    times = LiveTime()
    delays = []
    for camera_time, now in ((900.0, 50.0), (900.2, 50.0), (900.4, 50.0), (900.6, 50.1), (900.8, 50.6)):
        times.of(camera_time, now)
        delays.append(times.delay)
    # By the fourth picture it is known that the first ones came in a burst; the last one was late.
    assert delays == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.3])
    times.reconnected()
    times.of(3.0, 57.0)
    assert times.delay == 0.0


def test_a_new_connection_goes_on_in_time_wherever_its_clock_begins() -> None:
    times = LiveTime()
    times.of(900.0, 50.0)
    times.reconnected()
    assert times.of(3.0, 57.0) == pytest.approx(7.0)
    assert times.of(3.5, 57.6) == pytest.approx(7.5)


@pytest.mark.parametrize(
    "camera",
    [[0, 0.1, 0.05, 0.2], [0, 0.1, 0.1, 0.2], [0, 0.1, 9e5, 9e5], [0, 0.1, -50, -50], [7, 7.1, 4, 4.1, 4.2]],
)
def test_a_clock_that_goes_back_stands_still_or_jumps_gives_times_near_the_arrival(
    camera: list[float],
) -> None:
    times = LiveTime()
    given = [times.of(at, 5 + number / 10) for number, at in enumerate(camera)]
    assert given == sorted(given)
    np.testing.assert_allclose(given, np.arange(len(camera)) / 10, atol=0.2)


def test_tries_are_spread_and_their_distance_doubles_up_to_a_bound() -> None:
    for failures, longest in ((1, 0.5), (2, 1.0), (3, 2.0), (7, 30.0), (10_000, 30.0)):
        pauses = [retry_seconds(failures) for _ in range(50)]
        assert longest / 2 <= min(pauses) < max(pauses) <= longest


# Connections, on a clock that only the test moves


class FakeConnection:
    """Gives what the test puts in: numbers are pictures, an exception breaks it, None ends it.

    The word "same" is a sign of life.
    """

    def __init__(self) -> None:
        self.sent: queue.SimpleQueue[float | str | SourceError | None] = queue.SimpleQueue()
        self.closed = False

    def pictures(self) -> Iterator[Picture | None]:
        while (said := self.sent.get()) is not None:
            if isinstance(said, SourceError):
                raise said
            yield None if isinstance(said, str) else picture(7, said)

    def close(self) -> None:
        self.closed = True


class Bench:
    """A camera that answers as it is told, and a reader of it."""

    def __init__(self, answers: list[FakeConnection | None], give_up_after: float | None = None) -> None:
        self.now = 100.0
        self.answers = iter(answers)
        self.pauses: list[float] = []
        self.reader = LiveReader(
            "rtsp://door", self.connect, give_up_after, clock=lambda: self.now, sleep=self.pause
        )

    def pause(self, seconds: float) -> None:
        self.pauses.append(seconds)
        time.sleep(0.001)

    def connect(self) -> Connection:
        connection = next(self.answers, None)
        if connection is None:
            raise SourceError("Cannot open rtsp://door: Connection refused.")
        return connection

    def read(self) -> SourceFrame:
        """The next frame, past silences."""
        for _ in range(100):
            frame = self.reader.read()
            if isinstance(frame, SourceFrame):
                return frame
        raise AssertionError("no frame came")

    def silence(self, state: str) -> SourceSilence:
        """The next silence of that state."""
        for _ in range(100):
            said = self.reader.read()
            if isinstance(said, SourceSilence) and said.state == state:
                return said
        raise AssertionError(f"never {state}")


@pytest.fixture(autouse=True)
def quick_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_ANSWER_SECONDS", 0.02)


def test_a_camera_that_refuses_four_times_is_read_all_the_same() -> None:
    connection = FakeConnection()
    connection.sent.put(0.0)
    bench = Bench([None, None, None, None, connection])
    assert (bench.read().index, bench.reader.problem) == (0, None)
    assert len(bench.pauses) == 4
    assert bench.pauses[3] > bench.pauses[0]
    bench.reader.close()


def test_an_error_that_nobody_foresaw_is_a_lost_connection_and_its_text_is_not_shown() -> None:
    class Odd(FakeConnection):
        def pictures(self) -> Iterator[Picture | None]:
            yield picture(1, 0.0)
            raise RuntimeError("rtsp://bob:hunter2@door")

    bench = Bench([Odd(), Odd()])
    assert [bench.read().status for _ in range(3)] == ["ok", "gap", "ok"]
    assert "hunter2" not in str(bench.silence("reconnecting"))
    bench.reader.close()


def test_a_camera_that_is_off_at_the_start_is_tried_until_it_is_on_and_its_state_is_steady() -> None:
    silent, talking = FakeConnection(), FakeConnection()
    bench = Bench([*[None] * 20, silent, *[None] * 20, talking])
    silent.sent.put(SourceError("Connection refused"))  # connected, but without a picture
    said = {bench.silence("reconnecting")}
    while len(bench.pauses) < 41:
        said.add(bench.reader.read())  # type: ignore[arg-type]
    assert len(said) == 1
    assert re.fullmatch(
        r"The camera rtsp://door has been unreachable since \d{4}-\d\d-\d\d \d\d:\d\d \w+: "
        r"Connection refused\. It is tried again at least every 30 s\.",
        said.pop().reason or "",
    )
    talking.sent.put(0.0)
    assert (bench.read().index, bench.reader.problem) == (0, None)
    bench.reader.close()


def test_a_camera_without_a_picture_for_too_long_is_given_up_if_asked() -> None:
    first = FakeConnection()
    bench = Bench([first], give_up_after=60.0)
    first.sent.put(0.0)
    bench.read()
    first.sent.put(None)
    bench.now += 59.0
    bench.silence("reconnecting")
    assert bench.reader.problem is None
    bench.now += 2.0
    assert bench.reader.read() is None
    assert bench.reader.problem is not None
    assert bench.reader.problem.startswith(
        "The camera rtsp://door sent no picture for 60 s and was given up: "
    )


def test_a_lost_connection_is_a_gap_and_the_stream_goes_on() -> None:
    first, second = FakeConnection(), FakeConnection()
    bench = Bench([first, None, None, None, None, None, None, None, second])
    first.sent.put(10.0)
    assert bench.read().pts == 0.0
    bench.now += 2.0
    first.sent.put(SourceError("End of file"))
    second.sent.put(500.0)
    rows = [bench.read() for _ in range(2)]
    assert [(row.index, row.status) for row in rows] == [(1, "gap"), (2, "ok")]
    assert [row.pts for row in rows] == pytest.approx([0.0, 2.0])
    assert first.closed
    assert len(bench.pauses) == 8
    bench.reader.close()


def test_a_camera_away_is_reconnecting_and_says_why() -> None:
    first = FakeConnection()
    bench = Bench([first])
    first.sent.put(0.0)
    bench.read()
    first.sent.put(None)
    said = bench.silence("reconnecting")
    assert said.reason is not None
    assert said.reason.startswith("The camera rtsp://door has been unreachable since ")
    assert said.reason.count("rtsp://door") == 1
    bench.reader.close()


def test_a_silent_camera_is_stalled_and_one_that_hangs_is_connected_anew() -> None:
    hung, second = FakeConnection(), FakeConnection()
    bench = Bench([hung, second])
    hung.sent.put(0.0)
    bench.read()
    assert bench.reader.read() == SourceSilence(None)
    bench.now += 6.0
    assert (bench.silence("stalled").reason or "").startswith("The camera rtsp://door has been silent since ")
    bench.now += 10.0
    bench.silence("reconnecting")
    second.sent.put(0.0)
    assert [bench.read().status for _ in range(2)] == ["gap", "ok"]
    hung.sent.put(1.0)  # what the old line still says is not heard
    second.sent.put(0.1)
    assert bench.read().pts == pytest.approx(16.1)
    assert isinstance(bench.reader.read(), SourceSilence)
    bench.reader.close()


def test_a_stall_that_ends_by_itself_is_a_gap_too() -> None:
    connection = FakeConnection()
    bench = Bench([connection])
    connection.sent.put(0.0)
    bench.read()
    bench.now += 6.0
    bench.silence("stalled")
    connection.sent.put(6.0)
    assert [(row.status, row.pts) for row in (bench.read(), bench.read())] == [("gap", 0.0), ("ok", 6.0)]
    bench.reader.close()


def test_a_camera_that_says_that_nothing_is_newer_is_neither_stalled_nor_has_a_gap() -> None:
    connection = FakeConnection()
    bench = Bench([connection], give_up_after=60.0)
    connection.sent.put(0.0)
    bench.read()
    for _ in range(10):
        bench.now += 4.0
        connection.sent.put("same")
        # A reader that had not heard it would say, the second time, that the camera is stalled.
        _wait_for(lambda: bench.reader.read() == SourceSilence(None) and connection.sent.empty(), 20)
    connection.sent.put(40.0)
    row = bench.read()
    assert (row.index, row.status) == (1, "ok")
    assert row.pts == pytest.approx(40.0)
    bench.now += 61.0  # but who wants pictures does not wait for ever
    connection.sent.put("same")
    assert bench.reader.read() is None
    assert "sent no picture for 60 s" in (bench.reader.problem or "")


def test_a_camera_that_comes_and_goes_is_tried_less_and_less_often() -> None:
    connections = [FakeConnection() for _ in range(6)]
    for connection in connections:
        connection.sent.put(0.0)
        connection.sent.put(None)
    bench = Bench([*connections])
    statuses = [bench.read().status for _ in range(11)]
    assert statuses.count("gap") == 5
    bench.silence("reconnecting")
    assert bench.pauses[5] >= 8 > bench.pauses[0]
    bench.reader.close()


def test_a_closed_reader_gives_nothing_more_and_lets_its_camera_go() -> None:
    connection = FakeConnection()
    bench = Bench([connection])
    bench.reader.close()
    bench.reader.close()
    assert bench.reader.read() is None
    connection.sent.put(0.0)
    _wait_for(lambda: connection.closed)


# A real camera's protocol


@pytest.mark.parametrize("scheme", ["rtsp", "rtsps"])
def test_no_error_of_a_camera_shows_its_password(scheme: str) -> None:
    address = parse_address(f"{scheme}://bob:hunter2@127.0.0.1:9/door?token=hunter3", Path("/"))
    with pytest.raises(SourceError) as caught:
        LibavConnection(address)
    shown = f"{caught.value} {caught.value!r} {caught.value.__cause__!r}"
    assert "hunter" not in shown
    assert "127.0.0.1:9/door" in shown


def test_a_refused_password_is_told_with_how_its_percent_sign_is_written() -> None:
    refused = av.error.HTTPUnauthorizedError(0, "rtsp://bob:5%41@cam/door")
    assert reason(refused) == "user name or password refused (a % in them is written %25 in the address)"


def _wait_for(condition: Callable[[], bool], seconds: float = 180.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def _frames(reader: LiveReader, pictures: int) -> list[SourceFrame]:
    """All rows until so many with a picture have come."""
    deadline = time.monotonic() + 180
    frames: list[SourceFrame] = []
    while sum(frame.image is not None for frame in frames) < pictures:
        assert time.monotonic() < deadline, "no frames came"
        if isinstance(one := reader.read(), SourceFrame):
            frames.append(one)
    return frames


@needs_rtsp_server
def test_an_rtsp_camera_that_goes_away_and_comes_back_is_read_again_and_its_password_never_shown() -> None:
    port = free_port()
    address = parse_address(f"rtsp://bob:hunter2@127.0.0.1:{port}/door", Path("/"))
    with camera(port):
        reader = LiveReader.of(address)
        before = _frames(reader, 10)
    while not (isinstance(said := reader.read(), SourceSilence) and said.state == "reconnecting"):
        before += [said] if isinstance(said, SourceFrame) else []
    with camera(port):
        after = _frames(reader, 10)
    reader.close()
    assert after[0].status == "gap"
    frames = before + after
    assert [frame.index for frame in frames] == list(range(len(frames)))
    times = [frame.pts for frame in frames]
    assert times == sorted(times)
    shown = next(frame.image for frame in after if frame.image is not None)
    assert shown.shape == (120, 160, 3)
    assert shown.std() > 1
    assert "hunter2" not in str(said)
    assert f"127.0.0.1:{port}/door" in str(said)
    steady = [frame.pts for frame in after if frame.status != "gap"]
    np.testing.assert_allclose(np.diff(steady) * 20, np.rint(np.diff(steady) * 20), atol=0.1)


@needs_rtsp_server
def test_a_camera_without_tcp_is_read_over_udp() -> None:
    port = free_port()
    with camera(port, has_tcp=False):
        reader = LiveReader.of(parse_address(f"rtsp://bob:hunter2@127.0.0.1:{port}/door", Path("/")))
        assert len(_frames(reader, 5)) >= 5
        reader.close()


def test_an_mjpeg_camera_is_read_over_http_and_reconnected(tmp_path: Path) -> None:
    with http_camera() as host:
        reader = LiveReader.of(parse_address(f"http://bob:hunter2@{host}/video.mjpg", tmp_path))
        frames = _frames(reader, 2 * PICTURES - 10)
        reader.close()
    assert "gap" in [frame.status for frame in frames]
    shown = [frame for frame in frames if frame.image is not None]
    assert shown[0].image is not None
    assert shown[0].image.shape == (120, 160, 3)
    times = [frame.pts for frame in frames]
    assert times == sorted(times)
    assert 1.0 < times[-1] < 8.0


@pytest.mark.parametrize(
    ("login", "path", "told"),
    [
        ("bob:hunter2", "page", "something of no stated type"),
        ("bob:hunter3", "video", "user name or password refused"),
    ],
)
def test_what_is_no_camera_over_http_is_told_without_its_password(
    tmp_path: Path, login: str, path: str, told: str
) -> None:
    with http_camera() as host, pytest.raises(SourceError, match=told) as caught:
        connect(parse_address(f"http://{login}@{host}/{path}", tmp_path))
    assert "hunter" not in f"{caught.value!r}"


# Local cameras: no machine of the tests has one, so libav's answers are those of a file


def _write_three_pictures(path: Path) -> None:
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48), True)
    for number in range(3):
        video.write(np.full((48, 64, 3), 60 * number, np.uint8))
    video.release()


def test_a_local_camera_is_opened_as_video4linux_and_nothing_else_and_its_pictures_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _write_three_pictures(tmp_path / "a.avi")
    asked: list[tuple[str, dict[str, Any]]] = []
    really_open = av.open

    def open_device(location: str, **how: Any) -> Any:
        asked.append((location, how))
        return really_open(str(tmp_path / "a.avi"))

    monkeypatch.setattr(av, "open", open_device)
    connection = LibavConnection(parse_address("/dev/video7", tmp_path))
    images = [taken.convert() for taken in connection.pictures()]
    connection.close()
    assert [round(float(np.mean(one)) / 60) for one in images if one is not None] == [0, 1, 2]
    ((location, how),) = asked
    assert (location, how["format"]) == ("/dev/video7", "v4l2")
    assert how["container_options"] == {"format_whitelist": "video4linux2,v4l2"}
    assert 0 < how["timeout"] < 60


def test_what_comes_only_when_libav_s_patience_is_over_is_no_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _write_three_pictures(tmp_path / "a.avi")
    monkeypatch.setattr(av, "open", partial(_open_instead, av.open, str(tmp_path / "a.avi")))
    # Asked and answered in turn; the third picture takes as long as libav waits.
    times = iter([0.0, 0.0, 5.0, 14.0, 20.0, 30.0])
    pictures = LibavConnection(parse_address("/dev/video7", tmp_path), clock=lambda: next(times)).pictures()
    assert [next(pictures).time, next(pictures).time] == [0.0, 0.04]
    with pytest.raises(SourceError, match="no answer in time"):
        next(pictures)


def _open_instead(really_open: Callable[..., Any], path: str, location: str, **how: Any) -> Any:
    return really_open(path)


def test_what_is_no_camera_is_refused_by_libavs_own_video4linux(tmp_path: Path) -> None:
    assert "video4linux2,v4l2" in av.formats_available
    (tmp_path / "file").write_bytes(b"no camera")
    address = replace(parse_address("/dev/video7", tmp_path), location=str(tmp_path / "file"))
    with pytest.raises(SourceError, match="Inappropriate ioctl for device"):
        LibavConnection(address)
