"""A video being written, opaque or with opacity, with the sound of what it is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import av.error
import cv2
import numpy as np
from av.packet import Packet
from av.video.frame import VideoFrame

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.libav import reason
from orchestrator.sources.sound import SoundReader

__all__ = ["FORMS", "VideoFile"]

_TIME_BASE = Fraction(1, 90_000)
_NOMINAL_RATE = 25  # of a single frame; else every frame has its own time
_LEAST_SIDE = 16  # that H.264 encoders accept, px
_BT601 = 6  # the matrix with which colours are converted, as H.273 numbers it


@dataclass(frozen=True, slots=True)
class _Form:
    """A kind of video file.

    Attributes
    ----------
    container, codec, pixels : str
        As libav names them.
    options : mapping of str to str
        Of the codec.
    opaque : bool
    """

    container: str
    codec: str
    pixels: str
    options: Mapping[str, str]
    opaque: bool = True


_H264 = {"preset": "veryfast", "crf": "20"}

#: ProRes by one thread: with several, libav's encoder writes stray pixels into the opacity now and then.
_PRORES = {"profile": "4444", "alpha_bits": "16", "threads": "1"}

#: What is written under which ending. Those of ``VP9`` with opacity allow no alternate reference frames.
FORMS = {
    ".mp4": _Form("mp4", "libx264", "yuv420p", _H264),
    ".mkv": _Form("matroska", "libx264", "yuv420p", _H264),
    ".mov": _Form("mov", "prores_ks", "yuva444p10le", _PRORES, opaque=False),
    ".webm": _Form(
        "webm",
        "libvpx-vp9",
        "yuva420p",
        {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "5", "auto-alt-ref": "0"},
        opaque=False,
    ),
}


class VideoFile:
    """A video, frame by frame; its form is that of its ending.

    The first frame's size and aspect are the video's; frames of another size are scaled to it. It may consist
    of several parts of its source, each of which follows the one before without a pause.

    Parameters
    ----------
    path : Path
    sound : SourceAddress, optional
        The source, whose sound is copied if it is a file that has some.

    Attributes
    ----------
    remarks : list of str
        Why it lacks sound, if so.
    """

    def __init__(self, path: Path, sound: SourceAddress | None = None) -> None:
        self.remarks: list[str] = []
        self._form = FORMS[path.suffix]
        self._name = path.name
        options = {"movflags": "+faststart"} if self._form.container == "mp4" else {}
        self._container = av.open(str(path), "w", format=self._form.container, options=options)
        self._stream: av.VideoStream | None = None
        self._source = sound
        self._sound: SoundReader | None = None
        self._sound_stream: av.AudioStream | None = None
        self._begin: float | None = None  # of this part in the source, s
        self._shown = 0  # where it begins in the video, ticks
        self._last, self._frames = -1, 0

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file, or leave it unfinished after an error."""
        if kind is None:
            self._finish()
        else:
            self._end_sound()

    def cut(self) -> float:
        """End this part of the source: the next frame follows at once, wherever it comes from.

        Returns
        -------
        float
            When that is shown, s.
        """
        end = self._last + self._duration if self._frames else 0
        if self._begin is not None:
            self._copy_sound(self._begin + (end - self._shown) * float(_TIME_BASE))
            self._begin = None
        return float(end * _TIME_BASE)

    def add(self, picture: Array, pts: float, pixel_aspect: float = 1.0) -> None:
        """Append a frame.

        Parameters
        ----------
        picture : (H, W, 3) or (H, W, 4) uint8
            BGR, and opacity in a form that has it.
        pts : float
            Of its source, s; a time that does not advance is moved by 1/90,000 s.
        pixel_aspect : float
        """
        stream = self._opened(picture.shape, pixel_aspect)
        if self._begin is None:
            self._begin = pts
            self._shown = self._last + self._duration if self._frames else 0
        size = (stream.width, stream.height)
        if (picture.shape[1], picture.shape[0]) != size:
            picture = _fitted(picture, size)
        shown = self._shown + round((pts - self._begin) / _TIME_BASE)
        self._last = max(self._last + 1, shown)
        self._frames += 1
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format=self._layout)
        frame.pts, frame.time_base = self._last, _TIME_BASE
        self._mux(stream.encode(frame))
        self._copy_sound(pts)

    @property
    def _layout(self) -> str:
        return "bgr24" if self._form.opaque else "bgra"

    @property
    def _duration(self) -> int:
        """Mean duration of a frame so far, ticks."""
        if self._frames < 2:
            return round(1 / _NOMINAL_RATE / _TIME_BASE)
        return round(self._last / (self._frames - 1))

    def _opened(self, shape: tuple[int, ...], pixel_aspect: float) -> av.VideoStream:
        if self._stream is None:
            stream = self._container.add_stream(self._form.codec, rate=_NOMINAL_RATE)
            assert isinstance(stream, av.VideoStream)
            stream.width, stream.height = _even(shape[1]), _even(shape[0])
            stream.pix_fmt = self._form.pixels
            stream.codec_context.sample_aspect_ratio = Fraction(pixel_aspect).limit_denominator(999)
            stream.codec_context.time_base = _TIME_BASE
            stream.codec_context.colorspace = _BT601
            stream.options = dict(self._form.options)
            self._stream = stream
            self._open_sound()
        return self._stream

    def _mux(self, packets: list[Packet[av.VideoStream]]) -> None:
        for packet in packets:
            packet.duration = self._duration  # only the last one counts, for nothing follows it
        self._container.mux(packets)

    def _finish(self) -> None:
        if self._stream is not None:
            self._mux(self._stream.encode(None))
            self.cut()
        self._container.close()
        self._end_sound()

    def _open_sound(self) -> None:
        if self._source is None:
            return
        try:
            self._sound = SoundReader.of(self._source)
        except SourceError as error:
            self.remarks.append(f"{self._name} has no sound. {error}")
        if self._sound is None:
            return
        codec = self._sound.stream.codec_context.name
        try:
            if codec in self._container.supported_codecs:
                self._sound_stream = self._container.add_stream_from_template(self._sound.stream)
                return
        except (av.error.FFmpegError, ValueError):
            pass  # told below
        advice = "; .mkv takes it" if self._form.opaque and self._form.container != "matroska" else ""
        self.remarks.append(
            f"{self._name} has no sound: {codec} cannot be copied into a file of this kind{advice}."
        )
        self._end_sound()

    def _copy_sound(self, until: float) -> None:
        """Copy the sound of this part before a time of the source, s; a fault there ends the sound alone."""
        if self._sound is None or self._sound_stream is None or self._begin is None:
            return
        offset = self._shown * float(_TIME_BASE) - self._begin
        # The packet before the first is kept, too, for decoding begins with it; elsewhere it has no place.
        before = 0 if self._shown else 1
        try:
            for packet in self._sound.until(until):
                if packet.pts is None or packet.dts is None:
                    continue
                if (packet.pts + before * (packet.duration or 0)) * packet.time_base < self._begin:
                    continue
                shift = round(offset / packet.time_base)
                packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
                packet.stream = self._sound_stream
                self._container.mux(packet)
        except (av.error.FFmpegError, ValueError) as error:
            self.remarks.append(f"The sound of {self._name} ends at {until:.1f} s: {reason(error)}.")
            self._end_sound()

    def _end_sound(self) -> None:
        if self._sound is not None:
            self._sound.close()
        self._sound = self._sound_stream = None


def _even(length: int) -> int:
    """Return the least even length, as 4:2:0 video needs, of at least ``length``."""
    return max(_LEAST_SIDE, length + length % 2)


def _fitted(picture: Array, size: tuple[int, int]) -> Array:
    """Pad a picture to the even size that is above its own, or scale it to any other."""
    below, right = size[1] - picture.shape[0], size[0] - picture.shape[1]
    if below in (0, 1) and right in (0, 1):
        return np.asarray(cv2.copyMakeBorder(picture, 0, below, 0, right, cv2.BORDER_REPLICATE))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
