"""A scripted network camera: an RTSP server on this machine that can stall and refuse.

It implements as much RTSP (RFC 2326) as libav requests: DESCRIBE, SETUP, PLAY, with RTP interleaved in the
same connection (10.12). The video is an MPEG transport stream (RFC 2250) of key frames alone. A script
decides which pictures a connection sends, and when.
"""

from __future__ import annotations

import io
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from fractions import Fraction

import av
from av.video.stream import VideoStream

from mlbs_actors.messages import Array

__all__ = ["RATE", "Camera", "as_received", "play"]

#: Pictures a second.
RATE = 20

_SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
    "m=video 0 RTP/AVP 33\r\na=rtpmap:33 MP2T/90000\r\na=control:track\r\n"
)
_ANSWERS = {
    "OPTIONS": ("Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN", ""),
    "DESCRIBE": ("Content-Type: application/sdp", _SDP),
    "SETUP": ("Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 1", ""),
    "PLAY": ("Session: 1", ""),
}

_PACKET_BYTES = 7 * 188  # transport packets that fit a network packet
_CLOCK = 90_000


def as_received(pictures: Sequence[Array], count: int) -> list[Array]:
    """Decode a camera's first ``count`` pictures as a client receives them: (H, W, 3) uint8 each."""
    with _Packets(*pictures[0].shape[:2]) as packets:
        sent = b"".join(packets.of(pictures[number % len(pictures)], number) for number in range(count + 1))
    with av.open(io.BytesIO(sent), "r", format="mpegts") as container:
        # The last picture is left out: nothing after it shows that it is whole.
        return [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)][:count]


def play(first: int, last: int, began: float) -> Iterator[int]:
    """Yield ``first`` to ``last`` (excluded), each when a camera that started at ``began`` sends it."""
    for number in range(first, last):
        time.sleep(max(0.0, began + number / RATE - time.monotonic()))
        yield number


class Camera:
    """A camera that serves while the ``with`` block runs.

    Parameters
    ----------
    pictures : sequence of (H, W, 3) uint8
        What it shows, over and over.
    script : callable
        Number of the connection, from 0 → the numbers of the pictures to send; None refuses the connection.
    port : int
        0 for a free one.

    Attributes
    ----------
    address : str
        With a password.
    connected : list of float
        When connections were requested, monotonic time, s.
    """

    #: Must not appear in any message or file.
    password = "hunter2"

    def __init__(
        self, pictures: Sequence[Array], script: Callable[[int], Iterator[int] | None], port: int = 0
    ) -> None:
        self._pictures = pictures
        self._script = script
        self._listener = socket.create_server(("127.0.0.1", port))
        self.address = f"rtsp://bob:{self.password}@127.0.0.1:{self._listener.getsockname()[1]}/door"
        self.connected: list[float] = []

    def __enter__(self) -> Camera:
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _serve(self) -> None:
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            script = self._script(len(self.connected))
            self.connected.append(time.monotonic())
            threading.Thread(target=self._serve_connection, args=(line, script), daemon=True).start()

    def _serve_connection(self, line: socket.socket, script: Iterator[int] | None) -> None:
        with line, suppress(OSError):
            requests = line.makefile("r", encoding="ascii", newline="\r\n")
            while script is not None:
                words, headers = requests.readline().split(), {}
                while (header := requests.readline().strip()) != "":
                    name, _, value = header.partition(":")
                    headers[name.lower()] = value.strip()
                if not words:
                    return
                _answer(line, words[0], headers.get("cseq", "0"))
                if words[0] == "PLAY":
                    self._send(line, script)
                    return

    def _send(self, line: socket.socket, script: Iterator[int]) -> None:
        sequence = 0
        with _Packets(*self._pictures[0].shape[:2]) as packets:
            for number in script:
                data = packets.of(self._pictures[number % len(self._pictures)], number)
                for start in range(0, len(data), _PACKET_BYTES):
                    payload = data[start : start + _PACKET_BYTES]
                    stamp = number * _CLOCK // RATE
                    head = struct.pack(">BBHII", 0x80, 33, sequence % 2**16, stamp % 2**32, 1)
                    line.sendall(struct.pack(">cBH", b"$", 0, len(head) + len(payload)) + head + payload)
                    sequence += 1


def _answer(line: socket.socket, method: str, number: str) -> None:
    header, body = _ANSWERS.get(method, ("Session: 1", ""))
    text = f"RTSP/1.0 200 OK\r\nCSeq: {number}\r\n{header}\r\nContent-Length: {len(body)}\r\n\r\n{body}"
    line.sendall(text.encode("ascii"))


class _Packets:
    """Pictures as parts of one transport stream."""

    def __init__(self, height: int, width: int) -> None:
        self._file = io.BytesIO()
        # Nothing is held back: a picture is complete when it is sent.
        options = {"flush_packets": "1"}
        self._container = av.open(self._file, "w", format="mpegts", options=options)
        stream = self._container.add_stream("mpeg2video", RATE)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
        stream.bit_rate = 4_000_000
        stream.gop_size = 1
        stream.max_b_frames = 0
        self._stream = stream

    def __enter__(self) -> _Packets:
        return self

    def __exit__(self, *_: object) -> None:
        self._container.close()

    def of(self, picture: Array, number: int) -> bytes:
        """Return the packets of one picture."""
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        frame.pts, frame.time_base = number, Fraction(1, RATE)
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        data = self._file.getvalue()
        self._file.seek(0)
        self._file.truncate()
        return data
