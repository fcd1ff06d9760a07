"""Short videos as they come over a network: encoded anew, as MPEG-TS, FLV or segments of a playlist."""

from __future__ import annotations

import io
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from threading import Event, Thread

import av
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

__all__ = ["FRAME_RATE", "encoded", "tcp_sender", "udp_sender"]

FRAME_RATE = 20

_PACKETS = 7 * 188  # of a transport stream, in a datagram


def encoded(container: str, frames: int, start_s: float = 0.0, shade: int = 60) -> bytes:
    """Encode a square that moves over grey, 160×120 at 20 frames/s, with H.264."""
    file = io.BytesIO()
    start = round(start_s * FRAME_RATE)
    with av.open(file, "w", format=container) as video:
        stream = video.add_stream("libx264", rate=FRAME_RATE)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        stream.codec_context.thread_count = 1
        stream.options = {"g": "10", "tune": "zerolatency"}
        for number in range(frames):
            image = np.full((120, 160, 3), shade, np.uint8)
            image[40:60, 2 * number % 140 :][:, :20] = 220
            frame = VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = number + start, Fraction(1, FRAME_RATE)
            video.mux(stream.encode(frame))
        video.mux(stream.encode(None))
    return file.getvalue()


@contextmanager
def udp_sender(port: int, transport_stream: bytes, seconds: float) -> Iterator[None]:
    """Send a stream to a port of this machine in so many seconds, again and again."""
    ended = Event()
    parts = [transport_stream[at : at + _PACKETS] for at in range(0, len(transport_stream), _PACKETS)]

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while True:
                for part in parts:
                    if ended.wait(seconds / len(parts)):
                        return
                    with suppress(OSError):  # nobody listens yet
                        sender.sendto(part, ("127.0.0.1", port))

    thread = Thread(target=send, daemon=True)
    thread.start()
    yield
    ended.set()
    thread.join()


@contextmanager
def tcp_sender(transport_stream: bytes) -> Iterator[str]:
    """Send a stream to everyone who connects; yields HOST:PORT."""

    def listen() -> None:
        with suppress(OSError):  # the listener was closed, or the client has gone
            while True:
                client, _ = listener.accept()
                with client:
                    client.sendall(transport_stream)
                    time.sleep(0.1)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        Thread(target=listen, daemon=True).start()
        yield f"127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)
