"""A camera's newest packets on disk, as it sent them: what clips begin with lies before their events.

``.packets/`` of a stream holds Matroska files of a few seconds, which begin with a key frame and are named by
the time of day at which that was taken, in ms since 1970. Matroska takes every codec that cameras have. It is
written a second at a time, so that a file that was cut off by a kill can be read up to there. The oldest
files go when enough is recorded after them, however long ago: what a killed run has left is there for the
clips that it owes until the next run has as much of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import av
import av.error
import av.logging
from av.audio.stream import AudioStream
from av.packet import Packet
from av.stream import Stream
from av.video.stream import VideoStream

__all__ = ["PACKETS", "JpegRecorder", "PacketRecorder", "PacketRing", "RingFile", "ring_files"]

#: Folder of the ring, in the stream's.
PACKETS = ".packets"

#: Least length of a file, s, and that after which one ends though there is no key frame.
_FILE_SECONDS, _MOST_FILE_SECONDS = 4.0, 120.0

#: A camera's time that jumps by more than this against the machine's begins anew, s; as for its frames.
_MOST_DRIFT_SECONDS = 5.0

#: How wrong the name of a file may be, ms.
_NAME_TOLERANCE_MS = 100

#: After a fault of the disk, until the next attempt, s.
_PAUSE_SECONDS = 10.0

#: A cluster of so many ms is written at once.
_OPTIONS = {"cluster_time_limit": "1000", "flush_packets": "1"}

_MILLISECOND = Fraction(1, 1000)

#: Not compressed: a file of them would be huge.
_UNCOMPRESSED = ("rawvideo", "v210", "yuv4")


@dataclass(frozen=True, slots=True)
class RingFile:
    """A file of a ring.

    Attributes
    ----------
    path : Path
    begin : float
        When its first frame was taken, seconds since 1970.
    """

    path: Path
    begin: float


def ring_files(folder: Path) -> list[RingFile]:
    """Return the files of a ring, the oldest one first; none if there is no ring."""
    names = sorted(path.stem for path in folder.glob("*.mkv") if path.stem.isdecimal())
    return [RingFile(folder / f"{name}.mkv", int(name) / 1000) for name in names]


def _ring_path(folder: Path, begin: float) -> Path:
    return folder / f"{round(begin * 1000):013d}.mkv"


@dataclass(frozen=True, slots=True)
class PacketRing:
    """Where a camera's packets are kept.

    Attributes
    ----------
    folder : Path
    seconds : float
        How much of them stays, at least.
    """

    folder: Path
    seconds: float

    def recorder(self, streams: Sequence[VideoStream | AudioStream]) -> PacketRecorder:
        """Record a new connection with these streams, of which the first one is the video."""
        return PacketRecorder(self, streams)

    def jpeg_recorder(self) -> JpegRecorder:
        """Record a new connection that sends JPEGs."""
        return JpegRecorder(self)

    def delete_oldest(self) -> None:
        """Delete the files that are not needed any more."""
        recorded = 0.0
        for file in reversed(ring_files(self.folder)):
            if recorded > self.seconds:
                file.path.unlink(missing_ok=True)
            else:
                recorded += max(file.path.stat().st_mtime - file.begin, 0.0)


class PacketRecorder:
    """Records the packets of one connection. A fault of the disk is a gap in them, and nothing else.

    Parameters
    ----------
    ring : PacketRing
    streams : sequence of VideoStream or AudioStream
        Of the connection; sound is left out if Matroska does not take it.
    clock : callable
        Seconds since 1970.
    """

    def __init__(
        self,
        ring: PacketRing,
        streams: Sequence[VideoStream | AudioStream],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._ring = ring
        self._streams = streams
        self._clock = clock
        self._camera_clock = _CameraClock()
        self._file: _OpenFile | None = None
        self._not_before = 0.0  # after a fault
        self._usable = streams[0].codec_context.name not in _UNCOMPRESSED

    def keep(self, packet: Packet[Stream]) -> None:
        """Record a packet, whose times are changed thereby."""
        stamp = packet.pts if packet.pts is not None else packet.dts
        if not self._usable or stamp is None:
            return
        seconds, now = float(stamp * packet.time_base), self._clock()
        with av.logging.Capture():
            try:
                self._keep(packet, seconds, now)
            except (av.error.FFmpegError, OSError, ValueError):
                self._not_before = now + _PAUSE_SECONDS
                self.close()

    def close(self) -> None:
        """End the newest file."""
        file, self._file = self._file, None
        if file is not None:
            with suppress(av.error.FFmpegError, OSError, ValueError):
                file.container.close()

    def _keep(self, packet: Packet[Stream], seconds: float, now: float) -> None:
        if packet.stream is self._streams[0]:
            taken, is_new = self._camera_clock.taken(seconds, now)
            length = 0.0 if self._file is None else seconds - self._file.first
            if is_new or length > _MOST_FILE_SECONDS:
                self.close()
            if packet.is_keyframe and (self._file is None or length >= _FILE_SECONDS):
                self.close()
                if now >= self._not_before:
                    self._file = self._begun(seconds, taken)
            if self._file is not None:
                self._file.name(taken - (seconds - self._file.first))
        if self._file is not None:
            self._file.add(packet)

    def _begun(self, first: float, taken: float) -> _OpenFile:
        folder = self._ring.folder
        folder.mkdir(parents=True, exist_ok=True)
        self._ring.delete_oldest()
        return _OpenFile(_ring_path(folder, taken), self._streams, first)


class JpegRecorder:
    """Records the JPEGs of one connection that libav has no part in.

    Parameters
    ----------
    ring : PacketRing
    clock : callable
        Seconds since 1970, at which a JPEG comes; it has no other time.
    """

    def __init__(self, ring: PacketRing, clock: Callable[[], float] = time.time) -> None:
        self._ring = ring
        self._clock = clock
        self._recorder: PacketRecorder | None = None
        self._stream: VideoStream | None = None

    def keep(self, jpeg: bytes) -> None:
        """Record the next one."""
        if self._recorder is None or self._stream is None:
            try:
                with av.logging.Capture():
                    # The first one tells what kind of packets they are.
                    [stream] = av.open(BytesIO(jpeg), format="mjpeg").streams.video
            except (av.error.FFmpegError, ValueError):
                return
            if not stream.width:
                return  # it is damaged
            self._stream = stream
            self._recorder = PacketRecorder(self._ring, [stream], self._clock)
        packet: Packet[Stream] = Packet(jpeg)
        packet.stream, packet.time_base, packet.is_keyframe = self._stream, _MILLISECOND, True
        packet.pts = packet.dts = round(self._clock() / _MILLISECOND)
        self._recorder.keep(packet)

    def close(self) -> None:
        """End the newest file."""
        if self._recorder is not None:
            self._recorder.close()


class _CameraClock:
    """When a camera took what it sends: the quickest packet's way here counts as none."""

    def __init__(self) -> None:
        self._offset: float | None = None

    def taken(self, camera_time: float, now: float) -> tuple[float, bool]:
        """Return when a packet was taken that arrives now, and whether the camera's times begin anew."""
        late = now - camera_time
        is_new = self._offset is None or abs(late - self._offset) > _MOST_DRIFT_SECONDS
        self._offset = late if self._offset is None or is_new else min(late, self._offset)
        return camera_time + self._offset, is_new


class _OpenFile:
    """A file that is being written; ``first`` is the camera's time of its first frame, s."""

    def __init__(self, path: Path, streams: Sequence[VideoStream | AudioStream], first: float) -> None:
        self.container = av.open(str(path), "w", format="matroska", options=_OPTIONS)
        self.first = first
        self._path = path
        self._copies: dict[int, VideoStream | AudioStream] = {}
        for stream in streams:
            if stream.codec_context.name in self.container.supported_codecs:
                self._copies[stream.index] = self.container.add_stream_from_template(stream)

    def name(self, begin: float) -> None:
        """Correct when its first frame was taken: a connection may begin with packets that waited for it."""
        path = _ring_path(self._path.parent, begin)
        if abs(int(path.stem) - int(self._path.stem)) > _NAME_TOLERANCE_MS:
            self._path = self._path.rename(path)

    def add(self, packet: Packet[Stream]) -> None:
        copy = self._copies.get(packet.stream.index)
        if copy is None:
            return
        shift = round(self.first / packet.time_base)
        shown = packet.pts if packet.pts is not None else packet.dts
        decoded = packet.dts if packet.dts is not None else packet.pts
        assert shown is not None  # one of them is there
        assert decoded is not None
        if shown < shift:
            return  # sound from before, or a frame that cannot be decoded without those before
        packet.pts, packet.dts, packet.stream = shown - shift, decoded - shift, copy
        self.container.mux_one(packet)
