"""Where JPEGs begin and end in a row of bytes, by their own markers."""

from __future__ import annotations

import re
from collections.abc import Iterator

__all__ = ["JpegFinder", "is_cut_off_jpeg"]

_BEGIN = b"\xff\xd8\xff"
_END = b"\xff\xd9"
_BEGIN_CODE, _END_CODE = 0xD8, 0xD9

#: A marker, which in the coded picture only another one than a restart can be.
_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


class JpegFinder:
    """Cuts JPEGs out of bytes that come piece by piece; what stands between them does not matter.

    Parameters
    ----------
    most_bytes : int
        Longest picture; what is longer has lost its end, and is cut off.
    """

    def __init__(self, most_bytes: int = 1 << 25) -> None:
        self._most_bytes = most_bytes
        self._bytes = bytearray()
        self._place = 0  # up to here the picture at the front has been walked through; 0: none has begun

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the pictures that end in the next bytes, also where the next one cuts them off."""
        self._bytes += data
        while self._begin():
            end = self._end()
            if end is None:
                return
            picture = bytes(self._bytes[:end])
            del self._bytes[:end]
            self._place = 0
            yield picture

    def _begin(self) -> bool:
        """Bring the beginning of a picture to the front; False if none is there."""
        if self._place == 0:
            begin = self._bytes.find(_BEGIN)
            del self._bytes[: begin if begin >= 0 else max(0, len(self._bytes) - len(_BEGIN) + 1)]
            self._place = 2 if begin >= 0 else 0
        return self._place > 0

    def _end(self) -> int | None:
        """Return where the picture at the front ends; None if that has not come yet."""
        # Segments are skipped by their length: one of them may hold a thumbnail, with an end of its own.
        while marker := _MARKER.search(self._bytes, self._place):
            if marker[0][1] == _END_CODE:
                return marker.end()
            if marker[0][1] == _BEGIN_CODE:
                return marker.start()
            self._place, length = marker.start(), self._bytes[marker.end() : marker.end() + 2]
            if len(length) < 2:
                break
            self._place = marker.end() + int.from_bytes(length, "big")
        else:
            # Its last byte may be the first half of a marker.
            self._place = max(self._place, len(self._bytes) - 1)
        return len(self._bytes) if len(self._bytes) > self._most_bytes else None


def is_cut_off_jpeg(data: bytes) -> bool:
    """Whether a JPEG has no end."""
    return not next(JpegFinder(len(data)).feed(data), b"").endswith(_END)
