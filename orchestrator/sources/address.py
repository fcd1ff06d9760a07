"""The addresses of the list of streams: their kinds and meanings.

Only these are accepted; anything else that libav could open (``concat:``, ``ftp:``, ``subfile:`` …) is
refused, because a list may come from somebody who should not read this machine's files or network.
"""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlsplit

from mlbs_actors.errors import ConfigError
from mlbs_actors.scenes.scene_scripts import SCRIPTS
from mlbs_actors.scenes.synthetic import LIMITS, SCHEME
from orchestrator.credentials import MASK, mask

__all__ = ["SourceAddress", "SourceKind", "fixed_part", "has_wildcards", "parse_address"]

_MAX_ADDRESS_BYTES = 4096
_SCHEME = re.compile(r"([^/:]*):")  # wider than the standard's: libav knows "subfile,,start,0,,:"
_VIDEO_ENDINGS = frozenset({".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm"})
_NETWORK_SCHEMES = ("rtsp", "rtsps", "http", "https", "rtmp", "rtmps", "srt", "udp", "tcp")
#: Parts of a transport stream's address: host, port, and for UDP the network interface by its own address.
_TRANSPORT_STREAM = re.compile(
    r"(?:udp://@?(?P<group>[^/\s?#@:]*|\[[\da-fA-F:.]+\])|tcp://(?P<host>[^/\s?#@:]+|\[[\da-fA-F:.]+\]))"
    r":(?P<port>\d{1,5})/?(?P<interface>\?localaddr=[\da-fA-F.:]+)?"
)
_CAMERA = re.compile(r"/dev/video\d{1,4}")


class SourceKind(Enum):
    """Kind of source that an address names."""

    PATH = "path"  # a video file, or a folder or glob of images
    NETWORK = "network"
    CAMERA = "camera"
    SYNTHETIC = "synthetic"


@dataclass(frozen=True, slots=True)
class SourceAddress:
    """A checked address.

    Attributes
    ----------
    kind : SourceKind
    location : str
        Absolute path, or the whole URI. May contain a password, so it is not part of ``repr``; show
        ``str(address)``, which hides it.
    default_name : str
        Last part of the path, without extension, wildcards and credentials; may be invalid as a name. Of an
        address of RTMP the part before it, as the last one may be a key.
    """

    kind: SourceKind
    location: str = field(repr=False)
    default_name: str

    def __str__(self) -> str:
        return mask(self.location)

    @property
    def live(self) -> bool:
        """Whether it is a camera, which gives no frame twice."""
        return self.kind not in (SourceKind.PATH, SourceKind.SYNTHETIC)

    @property
    def path(self) -> Path | None:
        """The file, device, or fixed folder of a glob that it reads; None for other kinds."""
        if self.kind not in (SourceKind.PATH, SourceKind.CAMERA):
            return None
        return fixed_part(Path(self.location))


def parse_address(text: str, folder: Path) -> SourceAddress:
    """Check one address.

    Parameters
    ----------
    text : str
    folder : Path
        Base of relative paths.

    Raises
    ------
    ConfigError
            If it is none of the known kinds. Existence is not checked: the file is read on the
            machine that runs the stream.
    """
    if not text or len(text.encode()) > _MAX_ADDRESS_BYTES:
        raise ConfigError(f"a source is named by 1 to {_MAX_ADDRESS_BYTES} bytes")
    match = _SCHEME.match(text)
    if match is None:
        return _path_address(text, folder)
    scheme = match[1].lower()
    text = scheme + text[match.end(1) :]
    match scheme:
        case "udp" | "tcp":
            return _transport_stream_address(text, scheme)
        case network if network in _NETWORK_SCHEMES:
            return _network_address(text)
        case "synthetic":
            return _synthetic_address(text)
        case "file":
            path = unquote(text.removeprefix("file://").removeprefix("file:"))
            raise ConfigError(f"a file has no scheme; write {shlex.quote(path)}, its path alone")
        case drive if len(drive) == 1:
            path = text[2:].replace("\\", "/").lstrip("/")
            # Without quotes a shell has removed its backslashes, and so the ends of its folders.
            there = (
                shlex.quote(f"/mnt/{drive}/{path}")
                if "/" in path
                else f"the path with / for \\ from /mnt/{drive}/ on"
            )
            raise ConfigError(
                f"{drive.upper()}: is a drive of Windows; write {there}, where WSL has its files"
            )
        case other:
            raise ConfigError(
                f"{other[:40]!r} is no known kind of source; use a path, "
                f"{', '.join(f'{one}://' for one in _NETWORK_SCHEMES)} or synthetic: "
                "(for a file whose name holds a colon, write ./NAME)"
            )


def has_wildcards(text: str) -> bool:
    """Whether a path, or a part of one, may be a glob."""
    return any(mark in text for mark in "*?[")


def fixed_part(path: Path) -> Path:
    """Return the part of a path in front of its wildcards; in what exists there are none."""
    while has_wildcards(str(path)) and not os.path.exists(path):  # noqa: PTH110, it also takes long names
        path = path.parent
    return path


def _path_address(text: str, folder: Path) -> SourceAddress:
    # Not resolved: the user's names are those of links, not of their targets.
    path = Path(folder.absolute(), Path(text).expanduser() if text.startswith("~/") else text)
    if _CAMERA.fullmatch(str(path)):
        return SourceAddress(SourceKind.CAMERA, str(path), path.name)
    fixed = fixed_part(path)
    varied = path.relative_to(fixed).parts
    plain = [*fixed.parts, *(part for part in varied if not has_wildcards(part))]
    last = Path(plain[-1])
    is_file_name = plain[-1] == path.name
    return SourceAddress(SourceKind.PATH, str(path), last.stem if is_file_name else last.name)


def _network_address(text: str) -> SourceAddress:
    match = re.fullmatch(r"[a-z]+://[^/\s?#]+([^\s]*)", text)
    if match is None:
        raise ConfigError(f"a camera's address is written {text.partition(':')[0]}://HOST/PATH")
    if text.startswith("http") and Path(match[1].partition("?")[0]).suffix.lower() in _VIDEO_ENDINGS:
        raise ConfigError(
            "only cameras are read over HTTP, no finished videos; download the video and name its file"
        )
    if "@" in match[1]:
        # libav would take what comes before the mark for the host, and ask the network for it.
        raise ConfigError(
            "the camera's user name or password holds a / ? or #; write them %2F, %3F and %23 "
            "(and an @ of its path %40)"
        )
    if text.startswith("http"):
        try:
            _ = urlsplit(text).port
        except ValueError:
            raise ConfigError(
                "the host or the port cannot be read; brackets of a password are written %5B and %5D"
            ) from None
    # The name is taken from the masked text: a password may look like any other part.
    visible = mask(text).partition("://")[2].partition("?")[0].rstrip("/")
    host_and_path = visible.rpartition("@")[2].removesuffix(f"/{MASK}")
    name = host_and_path.rpartition("/")[2] if "/" in host_and_path else host_and_path.partition(":")[0]
    return SourceAddress(SourceKind.NETWORK, text, Path(name).stem if "/" in host_and_path else name)


def _transport_stream_address(text: str, scheme: str) -> SourceAddress:
    match = _TRANSPORT_STREAM.fullmatch(text)
    if match is None or not 0 < int(match["port"]) < 1 << 16 or (scheme == "tcp" and match["interface"]):
        raise ConfigError(
            "an MPEG-TS is named udp://@:PORT where it is sent to this machine, udp://@GROUP:PORT where it "
            "is multicast (with ?localaddr=IP for the network interface of that address), or tcp://HOST:PORT"
        )
    host = match["group"] or match["host"] or ""
    location = f"{scheme}://{host}:{match['port']}{match['interface'] or ''}"
    return SourceAddress(SourceKind.NETWORK, location, host or f"{scheme}-{match['port']}")


def _synthetic_address(text: str) -> SourceAddress:
    name, _, query = text.removeprefix(SCHEME).partition("?")
    if not text.startswith(SCHEME) or name not in SCRIPTS:
        raise ConfigError(
            f"there is no scene {name!r}; write synthetic: and one of {', '.join(sorted(SCRIPTS))}"
        )
    seen: set[str] = set()
    for parameter, value in parse_qsl(query, keep_blank_values=True):
        low, high = LIMITS.get(parameter, (0, -1))
        if parameter in seen or not value.isdecimal() or not low <= int(value[:12]) <= high:
            known = ", ".join(f"{key} ({least} to {most})" for key, (least, most) in LIMITS.items())
            raise ConfigError(
                f"{parameter}={value} is no parameter of a scene; there are, each once, {known}"
            )
        if parameter == "objects" and SCRIPTS[name].objects is None:
            raise ConfigError(f"the scene {name!r} has its own objects; leave out objects={value}")
        seen.add(parameter)
    return SourceAddress(SourceKind.SYNTHETIC, text, name)
