"""The labels drawn over the video, as an mp4 file derived from the record."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import av.error
import cv2
import numpy as np
from av.packet import Packet
from av.video.frame import VideoFrame

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.events.zones import Zone
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.libav import reason
from orchestrator.sources.sound import SoundReader
from orchestrator.storage.durable_files import publish, temporary_path
from orchestrator.storage.segments import segment_folders

__all__ = [
    "TICK",
    "OverlayVideo",
    "forget_overlay",
    "move_overlay",
    "overlay_path",
    "overlay_remarks",
    "overlays",
    "presentation_times",
    "stream_remarks",
]

_TIME_BASE = Fraction(1, 90_000)
#: Least time between two frames, s.
TICK = float(_TIME_BASE)

_NOMINAL_RATE = 25  # only a hint to the encoder; every frame carries its own time
_SMALLEST_SIDE = 16  # least that H.264 encoders accept, px
_ERROR, _NOTE = _REMARKS = (".error", ".note")  # suffixes of the files beside a video
#: Options of the mp4 format: a fragment begins with every key frame, and none stays in a buffer.
_FRAGMENTS = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
_KEY_FRAMES = 32  # interval of key frames, to which players and reports can seek


def overlay_path(folder: Path, first: int) -> Path:
    """Return the path of the video that begins at frame ``first``: a resumed run begins another."""
    return folder / (f"overlay-{first:08d}.mp4" if first else "overlay.mp4")


def overlays(folder: Path) -> list[tuple[int, Path]]:
    """List first frames and files of a stream's videos, in order; those of its segments too."""
    if not folder.is_dir():
        return []
    folders = [folder, *segment_folders(folder)]
    paths = (path for place in folders for path in place.glob("overlay*.mp4"))
    return sorted((int(path.stem.partition("-")[2] or 0), path) for path in paths)


def overlay_remarks(path: Path) -> list[str]:
    """Return what was written beside a video: why there is none, or why it lacks sound."""
    beside = (path.with_suffix(suffix) for suffix in _REMARKS)
    return [remark.read_text(encoding="utf-8").strip() for remark in beside if remark.exists()]


def stream_remarks(folder: Path) -> list[str]:
    """Return what was written beside a stream's first video, or those of its newest segment."""
    newest = segment_folders(folder)[-1:] if folder.is_dir() else []
    videos = {path.with_suffix(".mp4") for place in newest for path in place.glob("overlay*")}
    return [remark for path in (overlay_path(folder, 0), *sorted(videos)) for remark in overlay_remarks(path)]


def forget_overlay(path: Path) -> None:
    """Delete a video, its draft, and what was written beside it, as far as they are there."""
    for one in (temporary_path(path), path, *(path.with_suffix(suffix) for suffix in _REMARKS)):
        one.unlink(missing_ok=True)


def move_overlay(path: Path, to: Path) -> None:
    """Rename a video, with what was written beside it."""
    for suffix in _REMARKS:
        if path.with_suffix(suffix).exists():
            path.with_suffix(suffix).replace(to.with_suffix(suffix))
    path.replace(to)


def presentation_times(pts: Array) -> Array:
    """Compute when the frames of an overlay are shown.

    Parameters
    ----------
    pts : (n,) float64
        Times of all its frames in the source, s.

    Returns
    -------
    (n,) float64
        s; a time that does not advance is one :data:`TICK` after the one before it.
    """
    step = np.arange(len(pts))
    ticks = np.maximum.accumulate(np.round(pts / TICK) - step) + step
    return np.asarray(ticks * TICK)


class OverlayVideo:
    """An overlay being written; an error ends the overlay alone.

    The first frame's size and aspect are the video's; frames of another size are scaled to it. The file has
    its name only once it is closed: an mp4 without its index cannot be played. One that is growing is written
    in fragments, each with an index of its own, so that a kill loses the last one alone.

    Parameters
    ----------
    path : Path
        The mp4 file; ``overlay.error`` beside it says why there is none, if so, and ``overlay.note`` why it
        lacks sound.
    sound : SourceAddress, optional
        The source, whose sound is copied if it is a file that has some.
    zones : sequence of Zone
        Drawn over every frame; may be replaced later.
    drawing : Drawing
        What is drawn beside them. A private one has no sound.
    growing : bool
        Whether it can be played before it is closed.
    """

    def __init__(
        self,
        path: Path,
        sound: SourceAddress | None = None,
        zones: Sequence[Zone] = (),
        drawing: Drawing = DEFAULT_DRAWING,
        *,
        growing: bool = False,
    ) -> None:
        self._path = path
        self._growing = growing
        self.zones = zones
        self._drawing = drawing
        self._source_of_sound = None if drawing.private else sound
        self._sound: SoundReader | None = None
        self._sound_stream: av.AudioStream | None = None
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._failed = False
        self._first_pts, self._last_pts, self._frames = 0, -1, 0

    def add(self, picture: LabelledPicture) -> None:
        """Append a frame; times that do not advance are moved by 1/90,000 s."""
        if self._failed:
            return
        try:
            container, stream = self._opened(picture.image.shape, picture.pixel_aspect)
            size = (stream.width, stream.height)
            drawn = _padded(picture.drawn(self.zones, self._drawing))
            if (drawn.shape[1], drawn.shape[0]) != size:
                drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
            # OpenCV converts in half of the time that the encoder's library takes.
            planes = np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2YUV_I420), np.uint8)
            frame = VideoFrame.from_numpy_buffer(planes, format="yuv420p")
            self._last_pts = max(self._last_pts + 1, round(picture.pts / TICK))
            if not self._frames:
                self._first_pts = self._last_pts
            self._frames += 1
            frame.pts, frame.time_base = self._last_pts, _TIME_BASE
            self._mux(container, stream.encode(frame))
            self._copy_sound(self._last_pts * TICK)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._give_up(error)

    def close(self) -> None:
        """Finish the file; may be called twice."""
        if self._failed or self._container is None or self._stream is None:
            return
        try:
            self._mux(self._container, self._stream.encode(None))
            self._copy_sound((self._last_pts + self._duration) * TICK)
            self._container.close()
            if not self._growing:
                publish([self._path])
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._give_up(error)
        self._container = self._stream = None
        self._end_sound()

    @property
    def _duration(self) -> int:
        """Mean duration of a frame so far, ticks."""
        if self._frames < 2:
            return round(1 / _NOMINAL_RATE / TICK)
        return round((self._last_pts - self._first_pts) / (self._frames - 1))

    def _mux(self, container: av.container.OutputContainer, packets: list[Packet[av.VideoStream]]) -> None:
        # Only the last one counts, for nothing follows it. With any other duration the file would have
        # another frame rate than its frames have.
        for packet in packets:
            packet.duration = self._duration
        container.mux(packets)

    def _copy_sound(self, until: float) -> None:
        """Copy the sound before a time, s; a fault there ends the sound alone."""
        if self._sound is None or self._sound_stream is None or self._container is None:
            return
        try:
            for packet in self._sound.until(until):
                # One that ends at the first frame is kept, too: decoding the next one begins with it.
                if _end_of(packet) >= self._first_pts * TICK:
                    packet.stream = self._sound_stream
                    self._container.mux(packet)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._note(f"The sound ends at {until:.1f} s: {reason(error)}.")
            self._end_sound()

    def _open_sound(self, container: av.container.OutputContainer) -> None:
        if self._source_of_sound is None:
            return
        try:
            self._sound = SoundReader.of(self._source_of_sound)
            if self._sound is not None:
                codec = self._sound.stream.codec_context.name
                if codec in container.supported_codecs:
                    self._sound_stream = container.add_stream_from_template(self._sound.stream)
                    return
                self._note(f"The overlay has no sound: {codec} cannot be put into an mp4 file.")
        except SourceError as error:
            self._note(f"The overlay has no sound. {error}")
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._note(f"The overlay has no sound: {reason(error)}.")
        self._end_sound()

    def _end_sound(self) -> None:
        if self._sound is not None:
            self._sound.close()
        self._sound = self._sound_stream = None

    def _opened(
        self, shape: tuple[int, ...], pixel_aspect: float
    ) -> tuple[av.container.OutputContainer, av.VideoStream]:
        if self._container is None or self._stream is None:
            path = self._path if self._growing else temporary_path(self._path)
            options = _FRAGMENTS if self._growing else {}
            self._container = av.open(str(path), "w", format="mp4", options=options)
            self._stream = self._container.add_stream("libx264", rate=_NOMINAL_RATE)
            self._stream.width, self._stream.height = _even(shape[1]), _even(shape[0])
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.sample_aspect_ratio = Fraction(pixel_aspect).limit_denominator(999)
            self._stream.codec_context.time_base = _TIME_BASE
            # One thread: the cores belong to the segmentation.
            self._stream.codec_context.thread_count = 1
            # A fixed quantiser: choosing one for each frame takes a sixth of the encoder's time.
            self._stream.options = {"preset": "ultrafast", "qp": "26", "g": str(_KEY_FRAMES)}
            self._open_sound(self._container)
        return self._container, self._stream

    def _give_up(self, error: Exception) -> None:
        self._failed = True
        self._container = self._stream = None
        self._end_sound()
        temporary_path(self._path).unlink(missing_ok=True)
        self._say(_ERROR, f"The overlay could not be written: {error}")

    def _note(self, sentence: str) -> None:
        self._say(_NOTE, sentence)

    def _say(self, suffix: str, sentence: str) -> None:
        try:
            self._path.with_suffix(suffix).write_text(f"{sentence}\n", encoding="utf-8")
        except OSError:
            return  # the same full or lost disk; the record reports it


def _end_of(packet: Packet[av.AudioStream]) -> float:
    return float(((packet.pts or 0) + (packet.duration or 0)) * packet.time_base)


def _even(length: int) -> int:
    """Return the smallest even length, as 4:2:0 video needs, of at least ``length``."""
    return max(_SMALLEST_SIDE, length + length % 2)


def _padded(image: Array) -> Array:
    height, width = image.shape[:2]
    below, right = _even(height) - height, _even(width) - width
    if below == right == 0:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE))
