"""Connections to cameras: by libav, or over HTTP as the camera's answer wants it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from typing import Protocol

import av
import av.error
import av.logging
from av.audio.stream import AudioStream
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from mlbs_actors.errors import SourceError
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.http_answer import HttpCamera
from orchestrator.sources.libav import open_video, reason, upright_bgr
from orchestrator.sources.libav_policy import HLS, HTTP_VIDEO, LibavPolicy
from orchestrator.sources.live_buffer import STALL_SECONDS, Picture
from orchestrator.sources.mjpeg import JpegConnection
from orchestrator.sources.packets import PacketKeeper, PacketStore

__all__ = ["Connection", "LibavConnection", "Pace", "connect"]

#: Silence after which a connection is given up, s.
_DEAD_SECONDS = 2 * STALL_SECONDS

#: A picture that is due later than this is one after a jump of the camera's clock, s.
_LONGEST_PAUSE_SECONDS = STALL_SECONDS

_JPEGS = frozenset(
    {"image/jpeg", "image/jpg", "image/pjpeg", "image/x-mjpeg"}
    | {"video/x-motion-jpeg", "video/x-mjpeg", "video/mjpeg", "video/x-jpeg"}
)
_PLAYLISTS = frozenset(
    {"application/vnd.apple.mpegurl", "application/x-mpegurl", "audio/mpegurl", "audio/x-mpegurl"}
)
#: What servers call that which they do not know.
_UNSPECIFIC = frozenset({"", "application/octet-stream", "binary/octet-stream", "text/plain"})
_WHAT_IS_READ = (
    "over HTTP are read MJPEG, single JPEGs, HLS, and live MPEG-TS, FLV, Matroska and MP4; the manual of the "
    "camera names the address of such a stream, or one that begins with rtsp://"
)


class Connection(Protocol):
    """An open connection to a camera."""

    def pictures(self) -> Iterator[Picture | None]:
        """Yield the camera's pictures as they come; SourceError if the connection is lost.

        None is a sign of life: the camera has no newer picture.
        """

    def close(self) -> None:
        """Close the connection."""


def connect(address: SourceAddress, packets: PacketStore | None = None) -> Connection:
    """Connect to a camera.

    Parameters
    ----------
    address : SourceAddress
        Of kind NETWORK or CAMERA.
    packets : PacketStore, optional
        Keeps what the camera sends, its sound included.

    Raises
    ------
    SourceError
        If the camera cannot be reached or sends no video; the message hides credentials.
    """
    if not address.location.startswith("http"):
        return LibavConnection(address, packets=packets)
    try:
        return _connect_over_http(address, packets)
    except SourceError as error:
        why = str(error).removeprefix(f"Cannot open {address}: ").rstrip(".")
        raise SourceError(f"Cannot open {address}: {why}.") from None


def _connect_over_http(address: SourceAddress, packets: PacketStore | None) -> Connection:
    camera = HttpCamera(address.location, _DEAD_SECONDS)
    answer = camera.get()
    if answer is None:
        raise SourceError("it has no picture for whoever asks for the first time (304)")
    with ExitStack() as opened:
        opened.callback(answer.close)
        kind, head = answer.content_type, answer.read()
        if kind in _UNSPECIFIC:
            kind = _sniffed(head) or kind
        if kind in _JPEGS or kind.startswith("multipart/"):
            opened.pop_all()
            return JpegConnection(camera, answer, head, patience_s=_DEAD_SECONDS, packets=packets)
    if kind in _PLAYLISTS:
        return LibavConnection(address, HLS, packets=packets)
    if kind.startswith("video/") and answer.length is None:
        return LibavConnection(address, HTTP_VIDEO, packets=packets)
    if kind.startswith("video/"):
        raise SourceError("it is a finished video, no camera; download it and name its file")
    told = f"of the type {kind[:60]!r}" if kind else "of no stated type"
    raise SourceError(f"it sends no video but something {told}; {_WHAT_IS_READ}")


def _sniffed(head: bytes) -> str | None:
    """Tell by its first bytes what a body is that its header does not describe."""
    if head.removeprefix(b"\xef\xbb\xbf").startswith(b"#EXTM3U"):
        return "application/vnd.apple.mpegurl"
    if b"\xff\xd8\xff" in head[:1024] or b"image/jpeg" in head[:1024].lower():
        return "image/jpeg"
    if head.startswith(b"FLV\x01") or (head[:1] == head[188:189] == b"G"):
        return "video/mp2t"
    return None


class LibavConnection:
    """A connection made by libav.

    Parameters
    ----------
    address : SourceAddress
        Of kind NETWORK or CAMERA.
    policy : LibavPolicy, optional
        What may be opened; by default that of the address.
    clock : callable
        Monotonic time, s.
    packets : PacketStore, optional
        Keeps what the camera sends, its sound included.

    Raises
    ------
    SourceError
        If the camera cannot be reached or sends no video; the message hides credentials.
    """

    def __init__(
        self,
        address: SourceAddress,
        policy: LibavPolicy | None = None,
        clock: Callable[[], float] = time.monotonic,
        packets: PacketStore | None = None,
    ) -> None:
        self._container, self._stream, _ = open_video(address, _DEAD_SECONDS, policy)
        self._clock = clock
        self._streams: list[VideoStream | AudioStream] = [self._stream]
        self._keeper: PacketKeeper | None = None
        if packets is not None:
            self._streams += self._container.streams.audio[:1]
            self._keeper = packets.recorder(self._streams)
        # A playlist's pictures come a segment at once.
        self._pace = Pace(clock) if policy is HLS else None
        if policy is HLS:
            self._leave_out_variants()

    def pictures(self) -> Iterator[Picture]:
        """Yield the camera's pictures; those damaged in transmission are skipped, as players do."""
        with av.logging.Capture():
            try:
                asked = self._clock()
                for packet in self._container.demux(*self._streams):
                    # After its timeout libav returns a partial picture and continues.
                    if self._clock() - asked >= _DEAD_SECONDS:
                        raise SourceError("no answer in time")
                    if packet.stream is self._stream:
                        with suppress(av.error.InvalidDataError):
                            frames = (frame for frame in packet.decode() if isinstance(frame, VideoFrame))
                            for frame in frames:
                                if self._pace is not None:
                                    self._pace.wait(frame.time)
                                yield Picture(frame.time, partial(upright_bgr, frame), frame.is_corrupt)
                    if self._keeper is not None:  # last, as it changes the packet's times
                        self._keeper.keep(packet)
                    asked = self._clock()
            except (av.error.FFmpegError, OSError) as error:
                raise SourceError(reason(error, of_network=True)) from None

    def close(self) -> None:
        """Close the connection."""
        if self._keeper is not None:
            self._keeper.close()
        self._container.close()

    def _leave_out_variants(self) -> None:
        """Download only what is read or kept, not the same picture in other sizes."""
        for stream in self._container.streams:
            # Before version 16 PyAV has no such switch; then everything is downloaded.
            if stream not in self._streams and hasattr(stream, "discard"):
                stream.discard = type(stream.discard).all


class Pace:
    """Holds pictures back until their time.

    Parameters
    ----------
    clock, sleep : callable
        Monotonic time and a pause, s.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self._offset: float | None = None

    def wait(self, camera_time: float | None) -> None:
        """Return when a picture is due; those after one that came late are due later by as much."""
        if camera_time is None:
            return
        now = self._clock()
        early = 0.0 if self._offset is None else camera_time + self._offset - now
        if self._offset is None or not 0.0 < early <= _LONGEST_PAUSE_SECONDS:
            self._offset = now - camera_time
        else:
            self._sleep(early)
