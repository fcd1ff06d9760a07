"""The sound of a video file, packet by packet and undecoded, to be copied beside other pictures."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from contextlib import suppress
from typing import cast

import av.error
import av.logging
from av.audio.stream import AudioStream
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from orchestrator.sources.address import SourceAddress, SourceKind
from orchestrator.sources.animation import is_animation
from orchestrator.sources.libav import open_video
from orchestrator.sources.presence import holds_images

__all__ = ["SoundReader"]

_TIMEOUT_S = 20.0


class SoundReader:
    """Reads the first audio stream of a file, timed from the first frame that can be decoded.

    Parameters
    ----------
    container : InputContainer
    video : VideoStream
        What :class:`~orchestrator.sources.video.VideoReader` reads.
    audio : AudioStream

    Attributes
    ----------
    stream : AudioStream
        Template for the copy.
    """

    def __init__(self, container: InputContainer, video: VideoStream, audio: AudioStream) -> None:
        self.stream = audio
        self._container = container
        self._packets = self._from_the_first_frame(video)
        self._next: Packet[AudioStream] | None = None

    @classmethod
    def of(cls, address: SourceAddress) -> SoundReader | None:
        """Open the sound of a source; None if it has none.

        Raises
        ------
        SourceError
            If the file cannot be opened.
        """
        is_file = address.kind is SourceKind.PATH
        if not is_file or holds_images(address) or is_animation(address.location):
            return None
        container, video, _ = open_video(address, _TIMEOUT_S)
        if not container.streams.audio:
            container.close()
            return None
        return cls(container, video, container.streams.audio[0])

    def until(self, seconds: float) -> Iterator[Packet[AudioStream]]:
        """Yield the next packets that begin before a time, s since the first frame.

        Raises
        ------
        FFmpegError, OSError
            If reading breaks off.
        """
        with av.logging.Capture():
            while True:
                if self._next is None:
                    self._next = next(self._packets, None)
                packet = self._next
                if packet is None or packet.pts is None or packet.pts * packet.time_base >= seconds:
                    return
                self._next = None
                yield packet

    def close(self) -> None:
        """Close the file."""
        self._packets.close()
        self._container.close()

    def _from_the_first_frame(self, video: VideoStream) -> Generator[Packet[AudioStream], None, None]:
        """Yield packets with their new times, in ascending order; others cannot be written."""
        held: deque[Packet[AudioStream]] = deque()  # until the time of the first frame is known
        origin: float | None = None
        last: int | None = None
        for packet in self._container.demux(video, self.stream):
            if isinstance(packet.stream, AudioStream):
                held.append(cast("Packet[AudioStream]", packet))
            elif origin is None:
                with suppress(av.error.InvalidDataError):
                    frames = [frame for frame in packet.decode() if isinstance(frame, VideoFrame)]
                    origin = next((frame.time or 0.0 for frame in frames), None)
            while origin is not None and held:
                one = held.popleft()
                if one.pts is None or one.dts is None or (last is not None and one.dts <= last):
                    continue
                last = one.dts
                shift = round(origin / one.time_base)
                one.pts, one.dts = one.pts - shift, one.dts - shift
                yield one
