"""Names of files that begin with the number of a frame, of eight digits, or of more if it has more."""

from __future__ import annotations

import re
import sys

__all__ = ["frame_of", "in_order"]

_FRAME = re.compile(r"\d+(?=-)", re.ASCII)


def frame_of(name: str) -> int:
    """Return the frame by which a name begins; one behind all frames if it begins otherwise."""
    found = _FRAME.match(name)
    return sys.maxsize if found is None else int(found[0])


def in_order(name: str) -> tuple[int, str]:
    """Return a key by which names are sorted in the order of their frames."""
    return frame_of(name), name
