"""What libav may open for an address of each kind: protocols, containers, and how it reads them.

An address, and what a server answers, may come from somebody who should not read this machine's files. A
playlist names further addresses, and so does a redirection: both may lead to other hosts, as those of content
networks do, but never out of the protocols here, so never to ``file:``, ``concat:`` or ``data:``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import av
import av.error

from orchestrator.loopback import is_loopback
from orchestrator.sources.address import SourceAddress, SourceKind

__all__ = ["HLS", "HTTP_VIDEO", "LibavPolicy", "has_protocol", "policy_of"]

_FILES = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,m4v,h264,hevc,av1,obu,ivf,vc1,flv,asf,"
    "ogg,mjpeg,mxf,dv,gif,yuv4mpegpipe,nut,rm,wtv,dhav"
)
_OVER_HTTP = "http,https,httpproxy,tcp,tls"


@dataclass(frozen=True, slots=True)
class LibavPolicy:
    """What may be opened.

    Attributes
    ----------
    protocols, containers : str
        As libav's whitelists have them; empty for all.
    other : str
        What to say of data in no such container.
    options : mapping of str to str
        Further options of libav.
    container : str, optional
        The one that it must be, whatever it looks like.
    """

    protocols: str
    containers: str
    other: str
    options: Mapping[str, str] = field(default_factory=dict)
    container: str | None = None

    def container_options(self, location: str) -> dict[str, str]:
        """Return all of it as options of libav, for one address."""
        whitelists = {"protocol_whitelist": self.protocols, "format_whitelist": self.containers}
        chosen = {name: names for name, names in whitelists.items() if names} | dict(self.options)
        if location.startswith("http") and is_loopback(urlsplit(location).hostname or ""):
            chosen["http_proxy"] = ""  # not even the one that the environment names
        return chosen


#: A playlist over HTTP. Its segments may be encrypted.
HLS = LibavPolicy(
    f"{_OVER_HTTP},crypto",
    "hls,mpegts,mov,mp4,m4a,3gp,3g2,mj2,aac,mp3,ac3,eac3,webvtt",
    "its playlist names no segment that can be read; try the playlist in a player",
    # By itself libav believes neither the address nor the type that many servers state.
    container="hls",
)

#: A video over HTTP that has no end.
HTTP_VIDEO = LibavPolicy(
    _OVER_HTTP,
    "mpegts,flv,live_flv,matroska,webm,mov,mp4,m4a,3gp,3g2,mj2",
    "what it sends is no MPEG-TS, FLV, Matroska or MP4",
)

_FILE = LibavPolicy(
    "file", _FILES, "it is no video, or one whose recording was cut off before it was finished"
)
_DEVICE = LibavPolicy("", "video4linux2,v4l2", "it is no camera", container="v4l2")
_RTSP = LibavPolicy(
    "rtsp,rtp,srtp,udp,tcp,tls,crypto",
    "rtsp,sdp,rtp,mpegts,asf",
    "what it sends is no video; set the camera to H.264 or H.265",
    # TCP loses no packets; but some cameras have UDP only.
    {"rtsp_transport": "udp+tcp", "rtsp_flags": "prefer_tcp"},
)
_RTMP = LibavPolicy("rtmp,rtmps,tcp,tls", "flv,live_flv", "what it sends is no FLV", {"rtmp_live": "live"})
_NO_TS = "what comes is no MPEG-TS; have the sender use it (ffmpeg: -f mpegts)"
_NETWORK = {
    "rtsp": _RTSP,
    "rtsps": _RTSP,
    "rtmp": _RTMP,
    "rtmps": _RTMP,
    "srt": LibavPolicy("srt", "mpegts", _NO_TS),
    "tcp": LibavPolicy("tcp", "mpegts", _NO_TS),
    # Packets for which there was no time are lost, as any are, and do not end the connection.
    "udp": LibavPolicy("udp", "mpegts", _NO_TS, {"overrun_nonfatal": "1"}),
}


def policy_of(address: SourceAddress) -> LibavPolicy:
    """Return the policy of an address; of one over HTTP that of a video, unless its answer says more."""
    match address.kind:
        case SourceKind.PATH:
            return _FILE
        case SourceKind.CAMERA:
            return _DEVICE
        case _:
            return _NETWORK.get(address.location.partition(":")[0], HTTP_VIDEO)


def has_protocol(name: str) -> bool:
    """Whether the installed libav was built with a protocol; nothing is sent."""
    try:
        av.open(f"{name}://127.0.0.1:1", container_options={"protocol_whitelist": "none"}).close()
    except av.error.ProtocolNotFoundError:
        return False
    except (av.error.FFmpegError, OSError, ValueError):
        pass
    return True
