"""Video files, network streams and cameras, decoded by libav (PyAV).

Decoding is single-threaded: its result and its log then belong to the call, and one core serves several
streams better. Damage does not end a file: what can be decoded is delivered. libav conceals damage (a
flipped bit gives a plausible picture and no error), so its log and its mark of corrupt frames count too,
and :attr:`VideoReader.problem` says what was seen.

A file is opened by libav's ``file:`` protocol alone and as one of the known containers: playlists and
``concat:`` lists, which can name any file or address, are no videos here.
"""

from __future__ import annotations

from collections.abc import Generator

import av
import av.error
import av.logging
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.credentials import mask
from orchestrator.sources.address import SourceAddress, SourceKind

__all__ = ["VideoReader"]

_CONTAINERS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,m4v,h264,hevc,av1,obu,ivf,vc1,flv,asf,"
    "ogg,mjpeg,mxf,dv,gif,yuv4mpegpipe,nut,rm,wtv"
)
_OPTIONS = {
    SourceKind.PATH: {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS},
    SourceKind.NETWORK: {
        "protocol_whitelist": "rtsp,rtp,srtp,udp,tcp,tls,crypto",
        "format_whitelist": "rtsp,sdp,rtp,mpegts,asf",
        "rtsp_transport": "tcp",
    },
    SourceKind.CAMERA: {"format_whitelist": "video4linux2,v4l2"},
}
_OPEN_TIMEOUT_S, _READ_TIMEOUT_S = 10.0, 20.0

#: Containers whose headers count frames that are not to be shown (edit lists).
_COUNTS_HIDDEN_FRAMES = "mov,mp4"


class VideoReader:
    """Reads the frames of one video.

    Parameters
    ----------
    address : SourceAddress
        Of kind PATH (a file), NETWORK or CAMERA.

    Raises
    ------
    SourceError
        If it cannot be opened or holds no video; the message hides credentials.
    """

    def __init__(self, address: SourceAddress) -> None:
        self._address = address
        self._log_errors = 0
        self._corrupt_frames = 0
        self._lost_packets = 0
        self._broken_off: str | None = None
        self._ended = False
        self._count = 0
        self._first_pts: float | None = None
        self._last_pts = 0.0
        # Repeated lines are counted too. Whatever is logged goes to the captures below.
        av.logging.set_level(av.logging.ERROR)
        av.logging.set_skip_repeated(False)
        with av.logging.Capture():
            self._container = self._open()
        if not self._container.streams.video:
            self._container.close()
            raise SourceError(f"{address} holds no video.")
        self._stream: VideoStream = self._container.streams.video[0]
        self._stream.thread_type = "NONE"
        self._stream.codec_context.thread_count = 1
        rate = self._stream.average_rate
        self._frame_time = 1.0 / float(rate) if rate else 0.0
        self._frames = self._decode()

    @property
    def problem(self) -> str | None:
        """What was damaged or missing so far."""
        found: list[str] = []
        if self._broken_off is not None:
            found.append(f"reading broke off after {self._count} frames ({self._broken_off})")
        declared = self._stream.frames
        counts_shown_frames = not self._container.format.name.startswith(_COUNTS_HIDDEN_FRAMES)
        if self._ended and counts_shown_frames and self._count < declared:
            found.append(f"it holds {self._count} of the {declared} frames that its header states")
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
        image = _upright_bgr(frame)
        return SourceFrame(index, image, pts, f"{index:05d}", "ok" if image is not None else "quarantined")

    def close(self) -> None:
        """Close the file or connection."""
        self._ended = True
        self._frames.close()
        self._container.close()

    def _open(self) -> av.container.InputContainer:
        kind, location = self._address.kind, self._address.location
        try:
            return av.open(
                f"file:{location}" if kind is SourceKind.PATH else location,
                format="v4l2" if kind is SourceKind.CAMERA else None,
                options=_OPTIONS[kind],
                timeout=(_OPEN_TIMEOUT_S, _READ_TIMEOUT_S),
            )
        except (av.error.FFmpegError, OSError, ValueError) as error:
            # Neither the message nor the chained error may carry libav's text: it quotes the address.
            raise SourceError(f"Cannot open {self._address}: {_reason(error)}.") from None

    def _decode(self) -> Generator[VideoFrame, None, None]:
        try:
            for packet in self._container.demux(self._stream):
                try:
                    yield from packet.decode()
                except av.error.InvalidDataError:
                    self._lost_packets += 1
        except (av.error.FFmpegError, OSError) as error:
            self._broken_off = _reason(error)

    def _pts(self, frame: VideoFrame) -> float:
        """Seconds since the first frame; a frame without a time follows the one before it."""
        expected = self._last_pts + self._frame_time if self._count > 1 else 0.0
        if frame.time is None:
            self._last_pts = expected
        else:
            if self._first_pts is None:
                self._first_pts = frame.time - expected
            self._last_pts = frame.time - self._first_pts
        return self._last_pts


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or type(error).__name__
    return mask(str(text)).rstrip(".")


def _upright_bgr(frame: VideoFrame) -> Array | None:
    """Convert to (H, W, 3) uint8 BGR and undo the rotation that the file states; None if it cannot be."""
    try:
        image = frame.to_ndarray(format="bgr24")
    except (av.error.FFmpegError, ValueError):
        return None
    quarter_turns = round(frame.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, quarter_turns))
