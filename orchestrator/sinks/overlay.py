"""The labels drawn over the video, as an mp4 file derived from the record."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import av
import av.error
import cv2
import numpy as np
from av.video.frame import VideoFrame

from mlbs_actors.messages import Array, Region
from orchestrator.run.durable_files import publish, temporary_path
from orchestrator.sinks.drawing import draw_caption, draw_labels

__all__ = ["TICK", "OverlayVideo", "overlay_path", "overlays", "presentation_times"]

_TIME_BASE = Fraction(1, 90_000)
#: Least time between two frames, s.
TICK = float(_TIME_BASE)

_NOMINAL_RATE = 25  # only a hint to the encoder; every frame carries its own time
_SMALLEST_SIDE = 16  # least that H.264 encoders accept, px
_KEY_FRAMES = 32  # interval of key frames, to which players and reports can seek


def overlay_path(folder: Path, first: int) -> Path:
    """Return the path of the video that begins at frame ``first``: a resumed run begins another."""
    return folder / (f"overlay-{first:08d}.mp4" if first else "overlay.mp4")


def overlays(folder: Path) -> list[tuple[int, Path]]:
    """List first frames and files of a stream's videos, in order."""
    return sorted((int(path.stem.partition("-")[2] or 0), path) for path in folder.glob("overlay*.mp4"))


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
    its name only once it is closed: an mp4 without its index cannot be played.

    Parameters
    ----------
    path : Path
        The mp4 file; ``overlay.error`` beside it says why there is none, if so.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._failed = False
        self._last_pts = -1

    def add(
        self,
        image: Array,
        labels: Array,
        index: int,
        pts: float,
        regions: Mapping[int, Region] | None = None,
        pixel_aspect: float = 1.0,
    ) -> None:
        """Append frame ``index``, shown at ``pts`` seconds; times that do not advance are moved by 1/90,000
        s.

        ``regions`` are the layers' bounding boxes, where they are known; ``pixel_aspect`` is how wide a pixel
        is to be shown for its height.
        """
        if self._failed:
            return
        try:
            container, stream = self._opened(image.shape, pixel_aspect)
            size = (stream.width, stream.height)
            drawn = draw_labels(image, labels, regions)
            draw_caption(drawn, f"frame {index}")
            drawn = _padded(drawn)
            if (drawn.shape[1], drawn.shape[0]) != size:
                drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
            # OpenCV converts in half of the time that the encoder's library takes.
            planes = np.asarray(cv2.cvtColor(drawn, cv2.COLOR_BGR2YUV_I420), np.uint8)
            frame = VideoFrame.from_numpy_buffer(planes, format="yuv420p")
            self._last_pts = max(self._last_pts + 1, round(pts / TICK))
            frame.pts, frame.time_base = self._last_pts, _TIME_BASE
            container.mux(stream.encode(frame))
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._give_up(error)

    def close(self) -> None:
        """Finish the file; may be called twice."""
        if self._failed or self._container is None or self._stream is None:
            return
        try:
            self._container.mux(self._stream.encode(None))
            self._container.close()
            publish([self._path])
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._give_up(error)
        self._container = self._stream = None

    def _opened(
        self, shape: tuple[int, ...], pixel_aspect: float
    ) -> tuple[av.container.OutputContainer, av.VideoStream]:
        if self._container is None or self._stream is None:
            self._container = av.open(str(temporary_path(self._path)), "w", format="mp4")
            self._stream = self._container.add_stream("libx264", rate=_NOMINAL_RATE)
            self._stream.width, self._stream.height = _even(shape[1]), _even(shape[0])
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.sample_aspect_ratio = Fraction(pixel_aspect).limit_denominator(999)
            self._stream.codec_context.time_base = _TIME_BASE
            # One thread: the cores belong to the segmentation.
            self._stream.codec_context.thread_count = 1
            # A fixed quantiser: choosing one for each frame takes a sixth of the encoder's time.
            self._stream.options = {"preset": "ultrafast", "qp": "26", "g": str(_KEY_FRAMES)}
        return self._container, self._stream

    def _give_up(self, error: Exception) -> None:
        self._failed = True
        self._container = self._stream = None
        temporary_path(self._path).unlink(missing_ok=True)
        try:
            self._path.with_suffix(".error").write_text(f"The overlay could not be written: {error}\n")
        except OSError:
            return  # the same full or lost disk; the record reports it


def _even(length: int) -> int:
    """Return the smallest even length, as 4:2:0 video needs, of at least ``length``."""
    return max(_SMALLEST_SIDE, length + length % 2)


def _padded(image: Array) -> Array:
    height, width = image.shape[:2]
    below, right = _even(height) - height, _even(width) - width
    if below == right == 0:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE))
