"""Who keeps what a camera sends, from the point of view of its reader: undecoded, packet by packet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from av.audio.stream import AudioStream
from av.packet import Packet
from av.stream import Stream
from av.video.stream import VideoStream

__all__ = ["JpegKeeper", "PacketKeeper", "PacketStore"]


class PacketKeeper(Protocol):
    """Keeps the packets of one connection; what goes wrong with that is its own affair."""

    def keep(self, packet: Packet[Stream]) -> None:
        """Take the next one, which nobody else needs any more."""

    def close(self) -> None:
        """Take note that there are no more."""


class JpegKeeper(Protocol):
    """The same for a connection that sends JPEGs and is not libav's."""

    def keep(self, jpeg: bytes) -> None:
        """Take the next one, which has just come."""

    def close(self) -> None:
        """Take note that there are no more."""


class PacketStore(Protocol):
    """Where the packets of a camera are kept."""

    def recorder(self, streams: Sequence[VideoStream | AudioStream]) -> PacketKeeper:
        """Begin a new connection with these streams, of which the first one is the video."""

    def jpeg_recorder(self) -> JpegKeeper:
        """Begin a new connection that sends JPEGs."""
