"""Common code of videos, network streams and cameras: opening by libav (PyAV) and converting pictures.

Decoding is single-threaded: its result and its log then belong to the call, and one core serves several
streams better. What may be opened is limited by :mod:`orchestrator.sources.libav_policy`: a playlist or a
``concat:`` list could name any file or address.
"""

from __future__ import annotations

from errno import EIO
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
from orchestrator.sources.libav_policy import LibavPolicy, policy_of

__all__ = ["open_video", "reason", "upright_bgr"]

_UNKNOWN_CODEC = (
    "holds a video of a codec that cannot be decoded here; set the camera to H.264 or H.265, "
    "or convert the file."
)

_REASONS: dict[type[Exception], str] = {
    av.error.ExitError: "no answer in time",
    av.error.HTTPUnauthorizedError: (
        "user name or password refused (a % in them is written %25 in the address)"
    ),
    av.error.HTTPForbiddenError: "the user of the address may not see this stream; check the camera's rights",
    av.error.HTTPNotFoundError: "there is no stream at this path; the camera's manual names the right one",
    av.error.ConnectionRefusedError: "Connection refused; check the port, and whether the camera is on",
    av.error.InvalidDataError: "it is no video, or one whose recording was cut off before it was finished",
}


def open_video(
    address: SourceAddress, timeout_s: float, policy: LibavPolicy | None = None
) -> tuple[InputContainer, VideoStream, int]:
    """Open a source and choose its first video stream.

    Parameters
    ----------
    address : SourceAddress
        Of kind PATH (a file), NETWORK or CAMERA.
    timeout_s : float
        Longest wait for an answer, here and in each later read, s.
    policy : LibavPolicy, optional
        What may be opened; by default that of the address.

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
    policy = policy or policy_of(address)
    try:
        with av.logging.Capture() as log:
            container = av.open(
                f"file:{location}" if kind is SourceKind.PATH else location,
                format=policy.container,
                # Not as options: PyAV frees more of those than it has where streams turn up late (MPEG-TS).
                container_options=policy.container_options(location),
                timeout=timeout_s,
            )
    except (av.error.FFmpegError, OSError, ValueError) as error:
        # Neither the message nor the chained error may contain libav's text: it quotes the address.
        why = (
            policy.other
            if isinstance(error, av.error.InvalidDataError)
            else reason(error, of_network=kind is SourceKind.NETWORK)
        )
        raise SourceError(f"Cannot open {address}: {why}.") from None
    if not container.streams.video:
        container.close()
        raise SourceError(f"{address} holds no video.")
    stream = container.streams.video[0]
    if not stream.codec_context:  # PyAV declares that there is always one
        container.close()
        raise SourceError(f"{address} {_UNKNOWN_CODEC}")
    stream.thread_type = "NONE"
    stream.codec_context.thread_count = 1
    return container, stream, len(log)


def reason(error: Exception, *, of_network: bool = False) -> str:
    """Describe in a few words, without credentials, an error of libav."""
    for kind, words in _REASONS.items():
        if isinstance(error, kind):
            return words
    if of_network and getattr(error, "errno", None) == EIO:
        return "the connection broke off, or its host is unknown"  # libav does not tell them apart
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
