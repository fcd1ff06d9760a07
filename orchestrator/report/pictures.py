"""A few pictures from the overlay videos of a stream, small enough to be embedded in a page."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path

import av
import av.error
import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.report.history import StreamHistory
from orchestrator.sinks.overlay import TICK, overlays, presentation_times

__all__ = ["StripPicture", "overlay_strip"]

_WIDTH = 320  # px
_JPEG_QUALITY = 75


@dataclass(frozen=True, slots=True)
class StripPicture:
    """One picture.

    Attributes
    ----------
    frame : int
    seconds : float
        Since the first frame.
    width, height : int
        px.
    data : str
        A ``data:`` address with the JPEG.
    """

    frame: int
    seconds: float
    width: int
    height: int
    data: str


def overlay_strip(folder: Path, history: StreamHistory, count: int) -> list[StripPicture]:
    """Take up to ``count`` pictures, evenly spread, first and last among them.

    Parameters
    ----------
    folder : Path
        Of the stream; one that was resumed has more than one video.
    history : StreamHistory
    count : int

    Returns
    -------
    list of StripPicture
        Without those whose video is missing or cannot be read.
    """
    seconds = presentation_times(history.pts)
    places = np.unique(np.linspace(0, len(seconds) - 1, min(count, len(seconds))).round().astype(int))
    videos = overlays(folder)
    by_video: dict[tuple[int, Path], list[int]] = {}
    for place in places.tolist():
        begun = [video for video in videos if video[0] <= history.frames[place]]
        if begun:
            by_video.setdefault(begun[-1], []).append(place)
    pictures: list[StripPicture] = []
    for (first, path), wanted in by_video.items():
        # One that began before the history cannot be timed, unless it began with the stream.
        if first >= history.frames[0] or not first:
            begin = float(seconds[np.searchsorted(history.frames, first)]) if first else None
            pictures += _pictures(path, wanted, seconds, begin, history)
    return pictures


def _pictures(
    path: Path, places: list[int], seconds: Array, begin: float | None, history: StreamHistory
) -> list[StripPicture]:
    """Take pictures from a video that begins at a time of the stream, s, or with it."""
    pictures: list[StripPicture] = []
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            # Some count from there, others, of a resumed file, from the stream's beginning.
            started = float((stream.start_time or 0) * (stream.time_base or 0))
            offset = 0.0 if begin is None else begin - started
            for place in places:
                wanted = seconds[place] - offset
                container.seek(max(int(wanted * av.time_base), 0))  # to the key frame before it
                for frame in container.decode(stream):
                    if frame.time is not None and frame.time >= wanted - TICK / 2:
                        image = frame.to_ndarray(format="bgr24")
                        aspect = float(stream.sample_aspect_ratio or 1)
                        pictures.append(
                            _picture(image, aspect, int(history.frames[place]), history.pts[place])
                        )
                        break
    except (av.error.FFmpegError, OSError, IndexError):
        return pictures
    return pictures


def _picture(image: Array, aspect: float, frame: int, seconds: float) -> StripPicture:
    width = min(_WIDTH, image.shape[1])
    height = max(1, round(image.shape[0] * width / (image.shape[1] * aspect)))
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    data = "data:image/jpeg;base64," + b64encode(jpeg.tobytes()).decode("ascii")
    return StripPicture(frame, float(seconds), width, height, data)
