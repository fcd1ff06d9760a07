"""Cuts one clip out of a ring of packets or a video, as an MP4 file that browsers play.

H.264, H.265, VP9 and AV1 are copied, from the key frame before on; anything else, such as MJPEG, is encoded
anew. Sound is copied if MP4 takes it. Where a camera was away, the clip stands still.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import av.error
from av.audio.stream import AudioStream
from av.container import InputContainer, OutputContainer
from av.packet import Packet
from av.stream import Stream
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange
from av.video.stream import VideoStream

from orchestrator.clips.packet_ring import RingFile, ring_files
from orchestrator.sources.address import parse_address
from orchestrator.sources.libav import open_video
from orchestrator.storage.durable_files import publish, temporary_path

__all__ = ["CutRequest", "cut"]

#: What browsers play out of MP4, as far as they know the codec.
_COPIED = frozenset(("h264", "hevc", "vp9", "av1"))

#: For players that know H.265 under this name only.
_TAGS = {"hevc": "hvc1"}

_OPTIONS = {"movflags": "faststart"}
_ENCODER_OPTIONS = {"preset": "ultrafast", "crf": "26", "g": "50"}
_TICK = Fraction(1, 90_000)  # s
_TIMEOUT_S = 20.0

#: A file of the ring may be deleted just now, or have no whole packet yet.
_UNREADABLE = (av.error.FFmpegError, FileNotFoundError, IndexError)


@dataclass(frozen=True, slots=True)
class CutRequest:
    """A clip to be made.

    Attributes
    ----------
    begin, end : float
        s: since 1970 in a ring, since the first frame in a video.
    paths : tuple of str
        All files that it becomes.
    ring : str, optional
        Folder of packets.
    video : str, optional
        Or a video's path.
    """

    begin: float
    end: float
    paths: tuple[str, ...]
    ring: str | None = None
    video: str | None = None


@dataclass(frozen=True, slots=True)
class _TimedPacket:
    """A packet of a video stream, or of a sound stream, and when it is shown."""

    packet: Packet[Stream]
    time: float

    @property
    def is_video(self) -> bool:
        return isinstance(self.packet.stream, VideoStream)


def cut(request: CutRequest) -> bool:
    """Make a clip; return whether there was anything to show.

    Raises
    ------
    MlbsError, FFmpegError, OSError, ValueError
        If it cannot be made.
    """
    if request.video is not None:
        packets, copied = _from_video(Path(request.video), request.begin), True
    else:
        files = _files_between(Path(request.ring or ""), request.begin, request.end)
        packets, copied = _from_ring(files), len(set(map(_form, files)) - {None}) == 1
    first, *others = (Path(path) for path in request.paths)
    first.parent.mkdir(parents=True, exist_ok=True)
    draft = temporary_path(first)
    try:
        if not _write(draft, _from_key_frame(packets, request.begin, request.end), copied=copied):
            return False
        publish([first])
    finally:
        packets.close()
        draft.unlink(missing_ok=True)
    for other in others:
        _share(first, other)
    return True


def _share(clip: Path, other: Path) -> None:
    """Give a clip another name; where a disk has no links, a copy."""
    draft = temporary_path(other)
    draft.unlink(missing_ok=True)
    try:
        os.link(clip, draft)
    except OSError:
        shutil.copyfile(clip, draft)
    draft.replace(other)


def _files_between(folder: Path, begin: float, end: float) -> list[RingFile]:
    """Return the files of a ring from the one that has the beginning, or the first one after it."""
    files = [file for file in ring_files(folder) if file.begin < end]
    before = [place for place, file in enumerate(files) if file.begin <= begin]
    return files[before[-1] if before else 0 :]


def _form(file: RingFile) -> object:
    """Return what must be the same in all packets of one copied stream; None if there are none."""
    with suppress(*_UNREADABLE), av.open(str(file.path)) as container:
        coded = container.streams.video[0].codec_context
        return coded.name, coded.width, coded.height, coded.extradata
    return None


def _from_ring(files: Sequence[RingFile]) -> Generator[_TimedPacket, None, None]:
    for file in files:
        with suppress(*_UNREADABLE):
            # Not closed: that would free what the packets refer to, some of which are used later on. It is
            # closed with the last of them.
            container = av.open(str(file.path))
            for packet in container.demux(*_streams(container)):
                if packet.pts is not None:
                    yield _TimedPacket(packet, file.begin + float(packet.pts * packet.time_base))


def _from_video(path: Path, begin: float) -> Generator[_TimedPacket, None, None]:
    """Yield the packets of a video from the key frame before a time on, timed from its first frame."""
    container, stream, _ = open_video(parse_address(str(path), Path()), _TIMEOUT_S)
    with container:
        first = next(container.decode(stream), None)
        origin = 0.0 if first is None else first.time or 0.0
        container.seek(round((origin + begin) * av.time_base))
        for packet in container.demux(*_streams(container)):
            if packet.pts is not None:
                yield _TimedPacket(packet, float(packet.pts * packet.time_base) - origin)


def _streams(container: InputContainer) -> list[VideoStream | AudioStream]:
    return [*container.streams.video[:1], *container.streams.audio[:1]]


def _from_key_frame(packets: Iterator[_TimedPacket], begin: float, end: float) -> Iterator[_TimedPacket]:
    """Yield what lies before an end, from the last key frame before a beginning on, or the first one."""
    held: list[_TimedPacket] = []
    has_begun = False
    for one in packets:
        if one.is_video and one.time >= end:
            return
        if one.is_video and one.packet.is_keyframe and one.time <= begin:
            held = []
        is_first = one.is_video and one.packet.is_keyframe
        if has_begun:
            yield one
        elif held or is_first:
            held.append(one)
            if one.is_video and one.time > begin:
                has_begun = True
                yield from held


def _write(path: Path, packets: Iterator[_TimedPacket], *, copied: bool) -> bool:
    """Write packets into a file, copied if they are of one form; return whether there was one."""
    first = next(packets, None)
    if first is None:
        return False
    with av.open(str(path), "w", format="mp4", options=_OPTIONS) as container:
        writer = _Writer(container, first, copied=copied)
        writer.add(first)
        for one in packets:
            writer.add(one)
        writer.finish()
    return True


class _Writer:
    """Writes a clip; ``first`` is its first packet, of the video."""

    def __init__(self, container: OutputContainer, first: _TimedPacket, *, copied: bool) -> None:
        self._container = container
        self._begin = first.time
        source = first.packet.stream
        assert isinstance(source, VideoStream)  # so it begins
        codec = source.codec_context.name
        self._encoder: VideoStream | None = None
        self._tracks: dict[bool, VideoStream | AudioStream] = {}  # by whether it is the video's
        self._last: dict[bool, int] = {}
        if copied and codec in _COPIED:
            self._tracks[True] = container.add_stream_from_template(source)
            if codec in _TAGS:
                self._tracks[True].codec_context.codec_tag = _TAGS[codec]
        else:
            self._encoder = _encoder(container, source)
        for sound in source.container.streams.audio[:1]:
            if sound.codec_context.name in container.supported_codecs:
                self._tracks[False] = container.add_stream_from_template(sound)

    def add(self, one: _TimedPacket) -> None:
        """Add the next packet."""
        if one.is_video and self._encoder is not None:
            self._encode(self._encoder, one)
        elif one.is_video in self._tracks:
            self._copy(self._tracks[one.is_video], one)

    def finish(self) -> None:
        """Write what the encoder still has."""
        if self._encoder is not None:
            self._container.mux(self._encoder.encode(None))

    def _copy(self, track: VideoStream | AudioStream, one: _TimedPacket) -> None:
        packet, kind = one.packet, one.is_video
        assert packet.pts is not None  # it has a time
        shown = round((one.time - self._begin) / packet.time_base)
        reordered = 0 if packet.dts is None else packet.pts - packet.dts
        # Where a camera was away or its clock was set, times may not advance.
        decoded = max(shown - reordered, self._last.get(kind, shown - reordered - 1) + 1)
        # Only that of the last one counts: as long as the one before.
        packet.duration = max(decoded - self._last.get(kind, decoded), packet.duration or 0)
        packet.pts, packet.dts, packet.stream = max(shown, decoded), decoded, track
        self._last[kind] = decoded
        self._container.mux_one(packet)

    def _encode(self, encoder: VideoStream, one: _TimedPacket) -> None:
        packet = one.packet
        shift = one.time - self._begin - float((packet.pts or 0) * packet.time_base)
        with suppress(av.error.InvalidDataError):  # damaged in transmission
            for frame in packet.decode():
                if isinstance(frame, VideoFrame) and frame.time is not None:
                    # MJPEG uses the whole range of values, which browsers expect of no other video.
                    frame = frame.reformat(
                        encoder.width, encoder.height, "yuv420p", dst_color_range=ColorRange.MPEG
                    )
                    ticks = round((frame.time + shift) / _TICK)
                    self._last[True] = max(ticks, self._last.get(True, -1) + 1)
                    frame.pts, frame.time_base = self._last[True], _TICK
                    self._container.mux(encoder.encode(frame))


def _encoder(container: OutputContainer, source: VideoStream) -> VideoStream:
    stream = container.add_stream("libx264", rate=25)
    stream.width, stream.height = source.width + source.width % 2, source.height + source.height % 2
    stream.pix_fmt = "yuv420p"
    stream.codec_context.time_base = _TICK
    stream.codec_context.thread_count = 1  # the cores belong to the segmentation
    if source.sample_aspect_ratio:
        stream.codec_context.sample_aspect_ratio = source.sample_aspect_ratio
    stream.options = {**_ENCODER_OPTIONS}
    return stream
