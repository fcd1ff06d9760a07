"""Common code of videos, network streams and cameras: opening by libav (PyAV) and converting pictures.

Decoding is single-threaded: its result and its log then belong to the call, and one core serves several
streams better. A file is opened by libav's ``file:`` protocol alone and as one of the known containers:
playlists and ``concat:`` lists, which can name any file or address, are refused.
"""

from __future__ import annotations

from typing import cast

import av
import av.error
import av.logging
import numpy as np
from av.container import InputContainer
from av.sidedata.sidedata import SideDataContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.credentials import mask
from orchestrator.sources.address import SourceAddress, SourceKind

__all__ = ["open_video", "reason", "upright_bgr"]

_CONTAINERS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,m4v,h264,hevc,av1,obu,ivf,vc1,flv,asf,"
    "ogg,mjpeg,mxf,dv,gif,yuv4mpegpipe,nut,rm,wtv,dhav"
)
_OPTIONS = {
    SourceKind.PATH: {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS},
    SourceKind.NETWORK: {
        "protocol_whitelist": "rtsp,rtp,srtp,udp,tcp,tls,crypto",
        "format_whitelist": "rtsp,sdp,rtp,mpegts,asf",
        # TCP loses no packets; but some cameras have UDP only.
        "rtsp_transport": "udp+tcp",
        "rtsp_flags": "prefer_tcp",
    },
    SourceKind.CAMERA: {"format_whitelist": "video4linux2,v4l2"},
}
_HTTP_OPTIONS = {
    "protocol_whitelist": "http,https,httpproxy,tcp,tls,crypto",
    "format_whitelist": "mpjpeg,mjpeg",
    # The pictures have no times: libav would make some up.
    "use_wallclock_as_timestamps": "1",
}


def open_video(address: SourceAddress, timeout_s: float) -> tuple[InputContainer, VideoStream, int]:
    """Open a source and choose its first video stream.

    Parameters
    ----------
    address : SourceAddress
        Of kind PATH (a file), NETWORK or CAMERA.
    timeout_s : float
        Longest wait for an answer, here and in each later read, s.

    Returns
    -------
    InputContainer, VideoStream
    int
        Number of errors that libav has logged: it reads ahead to identify a file, in a short one up to where
        it is cut off.

    Raises
    ------
    SourceError
        If it cannot be opened or holds no video; the message hides credentials.
    """
    # Repeated lines are counted too. All logging goes to captures, here and where frames are read.
    av.logging.set_level(av.logging.ERROR)
    av.logging.set_skip_repeated(False)
    kind, location = address.kind, address.location
    is_http = kind is SourceKind.NETWORK and location.startswith("http")
    try:
        with av.logging.Capture() as log:
            container = av.open(
                f"file:{location}" if kind is SourceKind.PATH else location,
                format="v4l2" if kind is SourceKind.CAMERA else None,
                # Not as options: PyAV frees more of those than it has where streams turn up late (MPEG-TS).
                container_options=_HTTP_OPTIONS if is_http else _OPTIONS[kind],
                timeout=timeout_s,
            )
    except (av.error.FFmpegError, OSError, ValueError) as error:
        # Neither the message nor the chained error may contain libav's text: it quotes the address.
        other = is_http and isinstance(error, av.error.InvalidDataError)
        why = (
            "it sends no MJPEG, and nothing else is read over HTTP; download a video and name its file"
            if other
            else reason(error)
        )
        raise SourceError(f"Cannot open {address}: {why}.") from None
    if not container.streams.video:
        container.close()
        raise SourceError(f"{address} holds no video.")
    stream = container.streams.video[0]
    stream.thread_type = "NONE"
    stream.codec_context.thread_count = 1
    return container, stream, len(log)


def reason(error: Exception) -> str:
    """Describe in a few words, without credentials, an error of libav."""
    if isinstance(error, av.error.ExitError):
        return "no answer in time"
    if isinstance(error, av.error.HTTPUnauthorizedError):
        return "user name or password refused (a % in them is written %25 in the address)"
    if isinstance(error, av.error.InvalidDataError):
        return "it is no video, or one whose recording was cut off before it was finished"
    text = getattr(error, "strerror", None) or type(error).__name__
    return mask(str(text)).rstrip(".")


def upright_bgr(frame: VideoFrame) -> Array | None:
    """Convert to (H, W, 3) uint8 BGR, turned and mirrored as the source states; None if impossible."""
    try:
        image = frame.to_ndarray(format="bgr24")
    except (av.error.FFmpegError, ValueError):
        return None
    try:
        # PyAV declares another type than it returns.
        display = cast(SideDataContainer, frame.side_data).get("DISPLAYMATRIX")
    except ValueError:
        # Beside it lies something that PyAV does not know yet; the turn, at least, can be had without it.
        return np.ascontiguousarray(np.rot90(image, round(frame.rotation / 90) % 4))
    if display is None:
        return image
    # Shown at x' = a·x + c·y and y' = b·x + d·y; only quarter turns and mirrors occur.
    a, b, _, c, d = np.frombuffer(display, np.int32, count=5).tolist()
    if abs(a) + abs(d) < abs(b) + abs(c):
        image, a, d = image.swapaxes(0, 1), c, b
    return np.ascontiguousarray(image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1])
