"""Write frames as a video file, and read such a file in a loop."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import av
import numpy as np
from av.video.frame import VideoFrame

from mlbs_actors.messages import Array
from mlbs_actors.source import FrameReader, SourceFrame
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["EndlessReader", "open_video", "write_video"]

_RATE = 25
#: H.264 that preserves the sensor's noise.
_QUALITY = {"crf": "18", "preset": "veryfast"}


def write_video(frames: Iterable[Array], path: Path) -> None:
    """Write (H, W, 3) uint8 BGR frames of one size as H.264 in mp4; an odd side loses a row or column."""
    with av.open(str(path), "w") as container:
        stream = None
        for whole in frames:
            height, width = whole.shape[:2]
            frame = np.ascontiguousarray(whole[: height // 2 * 2, : width // 2 * 2])
            if stream is None:
                stream = container.add_stream("libx264", rate=_RATE, options=_QUALITY)
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(stream.encode(VideoFrame.from_ndarray(frame, format="bgr24")))
        if stream is not None:
            container.mux(stream.encode())


def open_video(path: Path) -> FrameReader:
    """Open a video file as a run does."""
    return open_reader(parse_address(str(path), path.parent))


@dataclass
class EndlessReader:
    """A reader that plays a video in a loop, without a cut if it runs forward and back.

    Attributes
    ----------
    path : Path
        The video file.
    """

    path: Path
    problem: str | None = None
    _reader: FrameReader | None = field(default=None, repr=False)
    _next: int = 0

    def read(self) -> SourceFrame | None:
        """Return the next frame; never None."""
        frame = None if self._reader is None else self._reader.read()
        if not isinstance(frame, SourceFrame):
            self.close()
            self._reader = open_video(self.path)
            frame = self._reader.read()
            assert isinstance(frame, SourceFrame)  # a video that was written here holds one
        index, self._next = self._next, self._next + 1
        return replace(frame, index=index, pts=index / _RATE, name=f"{index:05d}")

    def close(self) -> None:
        """Release the file."""
        if self._reader is not None:
            self._reader.close()
