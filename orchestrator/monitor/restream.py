"""A stream's newest pictures as Motion JPEG, which browsers, players and other programs show."""

from __future__ import annotations

import time
from collections.abc import Iterator

from orchestrator.monitor.board import Board

__all__ = ["BOUNDARY", "motion_jpeg"]

BOUNDARY = "picture"

#: Between two looks at the newest picture, s.
_LOOK_SECONDS = 0.05

#: A picture that stays is sent again after this time, s, to find out whether the viewer is still there.
_REPEAT_SECONDS = 5.0


def motion_jpeg(board: Board, name: str) -> Iterator[bytes]:
    """Yield the parts of the answer, an empty one where there is none yet, until the stream has ended."""
    sent, sent_at = None, -_REPEAT_SECONDS
    while True:
        ended = board.has_ended(name)
        board.watch(name)
        version, now = board.version(name), time.monotonic()
        if version is not None and (version != sent or now - sent_at >= _REPEAT_SECONDS):
            picture = board.picture_of(name)
            if picture is not None:
                sent, sent_at = version, now
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
                yield head.encode() + picture + b"\r\n"
        if ended:
            return
        yield b""
        time.sleep(_LOOK_SECONDS)
