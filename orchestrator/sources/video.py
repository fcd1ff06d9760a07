"""Video files, decoded by libav (PyAV).

Damage does not end a file: everything that can be decoded is delivered. libav conceals damage (a flipped bit
gives a plausible picture and no error), so its log and its mark of corrupt frames count too;
:attr:`VideoReader.problem` reports them.
"""

from __future__ import annotations

from collections.abc import Generator

import av
import av.error
import av.logging
from av.video.frame import VideoFrame

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame, SourceStatus
from mlbs_actors.wording import count_of
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.libav import open_video, reason, upright_bgr

__all__ = ["VideoReader"]

_TIMEOUT_S = 20.0

#: Containers whose headers also count hidden frames (edit lists).
_COUNTS_HIDDEN_FRAMES = "mov,mp4"

#: Times that jump back by more than both begin anew: seconds, and frames that a codec may reorder.
_LEAST_RESTART_S, _MOST_REORDERED = 1.0, 16


class VideoReader:
    """Reads the frames of one video.

    Parameters
    ----------
    address : SourceAddress
        Of kind PATH, a file.

    Raises
    ------
    SourceError
        If it cannot be opened or holds no video; the message hides credentials.
    """

    def __init__(self, address: SourceAddress) -> None:
        self._address = address
        self._corrupt_frames = 0
        self._lost_packets = 0
        self._broken_off: str | None = None
        self._ended = False
        self._count = 0
        self._origin: float | None = None  # the file's time at which the video begins
        self._last_pts = 0.0
        self._container, self._stream, self._log_errors = open_video(address, _TIMEOUT_S)
        rate = self._stream.average_rate or self._stream.guessed_rate
        self._frame_time = 1.0 / float(rate) if rate else 0.0
        counts_shown_frames = not self._container.format.name.startswith(_COUNTS_HIDDEN_FRAMES)
        self._declared = self._stream.frames if counts_shown_frames else 0
        self._length = self._stated_length()
        self._frames = self._decode()

    @property
    def problem(self) -> str | None:
        """Damage and missing parts so far."""
        found: list[str] = []
        if self._broken_off is not None:
            found.append(f"reading broke off after {count_of(self._count, 'frame')} ({self._broken_off})")
        if self._ended and self._count < self._declared:
            found.append(f"it holds {self._count} of the {self._declared} frames that its header states")
        if self._log_errors or self._corrupt_frames or self._lost_packets:
            found.append(
                f"the decoder reported {self._log_errors} errors, {self._corrupt_frames} damaged frames "
                f"and {self._lost_packets} undecodable packets"
            )
        return f"The video {self._address} is damaged or cut off: {'; '.join(found)}." if found else None

    def read(self) -> SourceFrame | None:
        """Return the next frame, or None at the end.

        Raises
        ------
        SourceError
            If not a single frame can be decoded.
        """
        if self._ended:
            return None
        with av.logging.Capture() as log:
            frame = next(self._frames, None)
        self._log_errors += len(log)
        if frame is None:
            self._ended = True
            if self._count == 0:
                raise SourceError(f"Not one frame of {self._address} can be decoded; is it a video?")
            return None
        index, self._count = self._count, self._count + 1
        self._corrupt_frames += frame.is_corrupt
        pts = self._pts(frame)
        image = upright_bgr(frame)
        status: SourceStatus = "ok" if image is not None else "quarantined"
        # Of joined files the header tells the length of the first.
        length = None if self._length is None else max(self._length, self._count)
        return SourceFrame(
            index,
            image,
            pts,
            f"{index:05d}",
            status,
            length=length,
            pixel_aspect=self._pixel_aspect(frame, image),
            concealed=frame.is_corrupt,
        )

    def close(self) -> None:
        """Close the file or connection."""
        self._ended = True
        self._frames.close()
        self._container.close()

    def _stated_length(self) -> int | None:
        """Return the number of frames according to the header's count or duration."""
        length = self._stream.frames
        if not length and self._frame_time:
            length = round((self._container.duration or 0) / av.time_base / self._frame_time)
        return length if length > 0 else None

    def _decode(self) -> Generator[VideoFrame, None, None]:
        try:
            for packet in self._container.demux(self._stream):
                try:
                    yield from packet.decode()
                except av.error.InvalidDataError:
                    self._lost_packets += 1
        except (av.error.FFmpegError, OSError) as error:
            self._broken_off = reason(error)

    def _pixel_aspect(self, frame: VideoFrame, image: Array | None) -> float:
        """Return the width of a pixel for its height, in the picture as it is shown."""
        aspect = float(self._stream.sample_aspect_ratio or 1)
        is_turned = image is not None and image.shape[1] != frame.width
        return 1 / aspect if is_turned else aspect

    def _pts(self, frame: VideoFrame) -> float:
        """Return seconds since the first frame, never fewer than before.

        A frame without a time follows the one before it, and so does one whose time is not later: some files
        (AVI with B-frames) tell the times in another order, and where files were joined they begin anew.
        """
        pts = expected = self._last_pts + self._frame_time if self._count > 1 else 0.0
        if frame.time is not None:
            if self._origin is None:
                self._origin = frame.time - expected
            pts = frame.time - self._origin
            if self._count > 1 and pts <= self._last_pts:
                if self._last_pts - pts > max(_LEAST_RESTART_S, _MOST_REORDERED * self._frame_time):
                    self._origin = frame.time - expected
                pts = expected
        self._last_pts = pts
        return pts
