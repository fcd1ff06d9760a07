"""Made packets of a camera: a short video in any codec, and a ring that has recorded it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.audio.stream import AudioStream
from av.packet import Packet
from av.stream import Stream
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from orchestrator.clips.packet_ring import PacketRecorder, PacketRing

__all__ = ["KEY_SECONDS", "RATE", "packets_of", "record", "write_video"]

#: Frames a second, and seconds between key frames (of MJPEG every frame is one).
RATE, KEY_SECONDS = 5, 2


def write_video(path: Path, seconds: float, codec: str = "libx264", size: tuple[int, int] = (64, 48)) -> Path:
    """Write a video whose brightness grows by one each frame, from 20 on."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, RATE)
        if codec != "mjpeg":
            once = str(KEY_SECONDS * RATE)
            x265 = f"log-level=none:bframes=0:scenecut=0:keyint={once}:min-keyint={once}"
            stream.options = {"g": once, "keyint_min": once, "bf": "0", "sc_threshold": "0"}
            if codec == "libx265":
                stream.options = {"x265-params": x265}
        for number in range(round(seconds * RATE)):
            image = np.full((size[1], size[0], 3), 20 + number % 200, np.uint8)
            container.mux(stream.encode(VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def packets_of(path: Path) -> Iterator[tuple[list[VideoStream | AudioStream], Packet[Stream]]]:
    """Yield the packets of a video with its streams."""
    with av.open(str(path)) as container:
        streams: list[VideoStream | AudioStream] = [*container.streams.video, *container.streams.audio]
        for packet in container.demux(*streams):
            if packet.pts is not None:
                yield streams, packet


def record(
    video: Path,
    ring: PacketRing,
    began: float,
    *,
    late: Callable[[float], float] = lambda seconds: 0.1,
    close: bool = True,
) -> PacketRecorder:
    """Record a video as a camera's that began to send it then; each packet arrives late by some seconds."""
    recorder: PacketRecorder | None = None
    now = [began]
    for streams, packet in packets_of(video):
        seconds = float((packet.pts or 0) * packet.time_base)
        now[0] = began + seconds + late(seconds)
        recorder = recorder or PacketRecorder(ring, streams, lambda: now[0])
        recorder.keep(packet)
    assert recorder is not None
    if close:
        recorder.close()
    return recorder
