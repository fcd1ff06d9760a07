"""Streams that libav reads from the network: times, where they may not lead, what is told of others."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from camera_server import free_port
from network_video import FRAME_RATE, encoded, tcp_sender, udp_sender
from rtmp_server import rtmp_server
from web_server import Page, page, web_server

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.source import SourceFrame
from orchestrator.sources.address import parse_address
from orchestrator.sources.connection import Pace, connect
from orchestrator.sources.libav_policy import has_protocol
from orchestrator.sources.live import LiveReader
from orchestrator.sources.live_buffer import LiveTime
from orchestrator.sources.presence import require_source

HERE = Path("/")
PLAYLIST = "application/vnd.apple.mpegurl"


def camera_times(url: str, most: int = 10_000) -> list[float]:
    """Times of the camera's own clock, until it ends the connection or there are so many."""
    connection = connect(parse_address(url, HERE))
    times: list[float] = []
    try:
        for picture in connection.pictures():
            assert picture is not None
            assert picture.time is not None
            image = picture.convert()
            assert image is not None
            assert image.shape == (120, 160, 3)
            times.append(picture.time)
            if len(times) == most:
                break
    except SourceError:
        pass  # it broke off
    finally:
        connection.close()
    return times


def frames_until(reader: LiveReader, enough: Callable[[list[SourceFrame]], bool]) -> list[SourceFrame]:
    deadline = time.monotonic() + 180
    frames: list[SourceFrame] = []
    while not enough(frames):
        assert time.monotonic() < deadline, "waited in vain"
        if isinstance(one := reader.read(), SourceFrame):
            frames.append(one)
    reader.close()
    return frames


def playlist(*lines: str, ends: bool = True) -> bytes:
    head = ["#EXTM3U", "#EXT-X-VERSION:3", "#EXT-X-TARGETDURATION:1", "#EXT-X-MEDIA-SEQUENCE:0"]
    return "\n".join([*head, *lines, *(["#EXT-X-ENDLIST"] if ends else []), ""]).encode()


def segment(name: str) -> str:
    return f"#EXTINF:1.0,\n{name}"


@pytest.fixture(scope="module")
def video() -> bytes:
    return encoded("mpegts", 40)


# Each protocol


def test_rtmp_is_read() -> None:
    with rtmp_server(encoded("flv", 20)) as host:
        times = camera_times(f"rtmp://{host}/live/gate?token=hunter2")
    np.testing.assert_allclose(np.diff(times), 1 / FRAME_RATE, atol=0.002)
    assert len(times) == 20


def test_a_transport_stream_over_tcp_is_read(video: bytes) -> None:
    with tcp_sender(video) as host:
        times = camera_times(f"tcp://{host}")
    np.testing.assert_allclose(np.diff(times), 1 / FRAME_RATE, atol=0.002)
    assert len(times) == 40


@pytest.mark.parametrize(
    "address", ["udp://@:{}", pytest.param("udp://127.0.0.1:{}", marks=pytest.mark.long)]
)
def test_a_transport_stream_that_is_sent_to_this_machine_is_read(video: bytes, address: str) -> None:
    port = free_port()
    with udp_sender(port, video, 2.0):
        reader = LiveReader.of(parse_address(address.format(port), HERE))
        frames = frames_until(reader, lambda frames: len(frames) >= 60)
    times = [frame.pts for frame in frames]
    assert times == sorted(times)
    assert 0 < times[-1] < 60


def test_a_live_transport_stream_over_http_is_read(video: bytes) -> None:
    with web_server(
        {"/live": page("video/MP2T", video), "/odd": page("application/octet-stream", video)}
    ) as host:
        assert len(camera_times(f"http://{host}/live")) == len(camera_times(f"http://{host}/odd")) == 40


# Times


def test_the_clock_of_a_transport_stream_may_run_over() -> None:
    last = 2**33 / 90_000
    with tcp_sender(encoded("mpegts", 60, start_s=last - 2.5)) as host:
        times = camera_times(f"tcp://{host}")
    np.testing.assert_allclose(np.diff(times), 1 / FRAME_RATE, atol=0.002)
    assert len(times) == 60


def test_a_clock_that_begins_anew_by_little_goes_on_from_the_arrival() -> None:
    times = LiveTime()
    given = [times.of(at, number / 10) for number, at in enumerate([7.0, 7.1, 7.2, 5.0, 5.1, 5.2])]
    assert given == pytest.approx(np.arange(6) / 10)


def test_pictures_of_a_segment_are_held_until_their_time_and_no_jump_holds_them_for_long() -> None:
    now, shown = 100.0, []

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    pace = Pace(lambda: now, sleep)
    for at in (5.0, 5.1, 5.2, None, 900.0, 900.1, 3.0, 3.1):
        pace.wait(at)
        shown.append(now - 100.0)
    now += 2.0  # nothing came
    for at in (3.2, 3.3):
        pace.wait(at)
        shown.append(now - 100.0)
    assert shown == pytest.approx([0, 0.1, 0.2, 0.2, 0.2, 0.3, 0.3, 0.4, 2.4, 2.5])


# Playlists


def test_a_playlist_is_played_at_its_own_speed_and_no_picture_is_dropped() -> None:
    parts = {f"/{number}.ts": page("video/mp2t", encoded("mpegts", 20, number)) for number in range(2)}
    listed = playlist(segment("0.ts"), segment("1.ts"))
    with web_server({"/x.m3u8": page(PLAYLIST, listed), **parts}) as host:
        began = time.monotonic()
        times = camera_times(f"http://{host}/x.m3u8")
    assert time.monotonic() - began > 1.5
    np.testing.assert_allclose(np.diff(times), 1 / FRAME_RATE, atol=0.002)
    assert len(times) == 40


@pytest.mark.long
def test_a_live_playlist_grows_and_its_end_is_a_lost_connection() -> None:
    parts = {f"/{number}.ts": page("video/mp2t", encoded("mpegts", 20, number)) for number in range(4)}
    asked = iter(range(10_000))

    def grown(request: BaseHTTPRequestHandler) -> None:
        known = min(next(asked), 4)
        page("text/plain", playlist(*(segment(f"{n}.ts") for n in range(known)), ends=known == 4))(request)

    # The answer's kind is looked at with the second request, which is libav's first.
    next(asked)
    with web_server({"/x": grown, **parts}) as host:
        reader = LiveReader.of(parse_address(f"http://{host}/x", HERE))
        frames = frames_until(reader, lambda frames: "gap" in [frame.status for frame in frames])
    shown = [frame.pts for frame in frames if frame.status != "gap"]
    assert len(shown) == 80
    np.testing.assert_allclose(np.diff(shown), 1 / FRAME_RATE, atol=0.02)


def test_where_a_playlist_tells_of_a_break_times_go_on() -> None:
    parts = {
        "/a.ts": page("video/mp2t", encoded("mpegts", 20, 500)),
        "/b.ts": page("video/mp2t", encoded("mpegts", 20, 3, shade=90)),
    }
    listed = playlist(segment("a.ts"), "#EXT-X-DISCONTINUITY", segment("b.ts"))
    with web_server({"/x.m3u8": page(PLAYLIST, listed), **parts}) as host:
        reader = LiveReader.of(parse_address(f"http://{host}/x.m3u8", HERE))
        frames = frames_until(reader, lambda frames: len(frames) >= 40)
    times = [frame.pts for frame in frames if frame.status != "gap"]
    assert times == sorted(times)
    assert times[-1] < 15


def test_of_a_list_of_variants_one_is_downloaded_with_its_password() -> None:
    asked: list[str] = []

    def part(name: str) -> Page:
        def answer(request: BaseHTTPRequestHandler) -> None:
            asked.append(name)
            known = request.headers["Authorization"] is not None
            page("video/mp2t", *([data] if known else []), status=200 if known else 401, **wanted)(request)

        return answer

    wanted = {"WWW_Authenticate": 'Basic realm="x"'}
    data = encoded("mpegts", 20)
    variants = "#EXTM3U\n" + "".join(
        f"#EXT-X-STREAM-INF:BANDWIDTH={rate}\n{name}.m3u8\n" for name, rate in (("high", 900), ("low", 90))
    )
    pages = {"/all.m3u8": page(PLAYLIST, variants.encode())}
    for name in ("high", "low"):
        pages[f"/{name}.m3u8"] = page(PLAYLIST, playlist(*(segment(f"{name}-{n}.ts") for n in range(4))))
        pages |= {f"/{name}-{n}.ts": part(name) for n in range(4)}
    with web_server(pages) as host:
        assert len(camera_times(f"http://bob:hunter2@{host}/all.m3u8", 40)) == 40
    assert asked.count("low") < asked.count("high")


# Where nothing may lead


@pytest.mark.parametrize(
    "line",
    [
        "{file}",
        "file://{file}",
        "file:{file}",
        "concat:{file}|{file}",
        "subfile,,start,0,end,9999999,,:{file}",
        "crypto+file://{file}",
        "data:video/mp2t;base64,AAAA",
        "away.ts",
        '#EXT-X-MAP:URI="file://{file}"\n#EXTINF:1,\nnone.ts',
        '#EXT-X-KEY:METHOD=AES-128,URI="file://{file}"\n#EXTINF:1,\ngood.ts',
    ],
)
def test_no_playlist_and_no_redirection_opens_a_file(tmp_path: Path, video: bytes, line: str) -> None:
    file = tmp_path / "a.ts"
    os.mkfifo(file)
    opened = Event()

    def notice() -> None:
        with file.open("wb"):  # waits until somebody opens it to read
            opened.set()

    Thread(target=notice, daemon=True).start()
    pages: Mapping[str, Page] = {
        "/x.m3u8": page(PLAYLIST, playlist("#EXTINF:1.0,\n" + line.format(file=file))),
        "/away.ts": page(None, status=302, Location=f"file://{file}"),
        "/good.ts": page("video/mp2t", video),
    }
    with web_server(pages) as host, suppress(SourceError):
        camera_times(f"http://{host}/x.m3u8")
    assert not opened.is_set()
    os.close(os.open(file, os.O_RDONLY | os.O_NONBLOCK))  # let the thread go
    assert opened.wait(60)


def test_no_list_within_a_file_is_read(tmp_path: Path, video: bytes) -> None:
    (tmp_path / "a.ts").write_bytes(video)
    (tmp_path / "b.mp4").write_bytes(playlist(segment("a.ts")))
    with web_server({"/a.ts": page("video/mp2t", playlist(segment(f"file://{tmp_path}/a.ts")))}) as host:
        for address in (str(tmp_path / "b.mp4"), f"http://{host}/a.ts"):
            with pytest.raises(SourceError):
                connect(parse_address(address, HERE))


# What is told


def test_a_codec_that_cannot_be_decoded_is_told_with_what_to_set(video: bytes) -> None:
    with (
        tcp_sender(_as_avs2(video)) as host,
        pytest.raises(SourceError, match=r"set the camera to H\.264 or H\.265"),
    ):
        connect(parse_address(f"tcp://{host}", HERE))


def test_what_is_no_transport_stream_is_told(video: bytes) -> None:
    with (
        tcp_sender(b"no video" * 50_000) as host,
        pytest.raises(SourceError, match="no MPEG-TS; have the sender"),
    ):
        connect(parse_address(f"tcp://{host}", HERE))


@pytest.mark.parametrize("scheme", ["rtmp", "rtmps", "rtsp", "tcp"])
def test_nobody_at_a_port_is_told_without_the_password(scheme: str) -> None:
    user = "" if scheme == "tcp" else "bob:hunter2@"
    with pytest.raises(SourceError, match="Connection refused; check the port") as caught:
        connect(parse_address(f"{scheme}://{user}127.0.0.1:9{'' if scheme == 'tcp' else '/live/x'}", HERE))
    assert "hunter2" not in f"{caught.value!r} {caught.value.__cause__!r}"


@pytest.mark.skipif(has_protocol("srt"), reason="this libav has SRT")
def test_a_protocol_that_libav_lacks_is_told_before_anything_starts() -> None:
    with pytest.raises(SourceError, match=r"has no SRT; .* offer the stream over RTSP") as caught:
        require_source(parse_address("srt://10.0.0.1:9000?passphrase=hunter2", HERE))
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["udp://x", "udp://bob:pw@x:1", "udp://@:0", "tcp://:1", "tcp://x:1?listen=1", "udp://x:1?localaddr=a/b"],
)
def test_an_address_of_a_transport_stream_has_a_port_and_no_options_of_libav(text: str) -> None:
    with pytest.raises(ConfigError, match="udp://@:PORT"):
        parse_address(text, HERE)


def _as_avs2(transport_stream: bytes) -> bytes:
    """Say of a stream of H.264 that it is of AVS2."""
    data = bytearray(transport_stream)
    for at in range(0, len(data), 188):
        if int.from_bytes(data[at + 1 : at + 3], "big") & 0x1FFF == 0x1000:  # the map of the program
            table = at + 5
            end = table + 3 + (int.from_bytes(data[table + 1 : table + 3], "big") & 0xFFF) - 4
            data[table + 12 + (int.from_bytes(data[table + 10 : table + 12], "big") & 0xFFF)] = 0xD2
            data[end : end + 4] = _crc(bytes(data[table:end])).to_bytes(4, "big")
    return bytes(data)


def _crc(data: bytes) -> int:
    remainder = 0xFFFFFFFF
    for byte in data:
        remainder ^= byte << 24
        for _ in range(8):
            remainder = (remainder << 1 ^ (0x04C11DB7 if remainder & 1 << 31 else 0)) & 0xFFFFFFFF
    return remainder
