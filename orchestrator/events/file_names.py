"""Names of pictures and clips of events: they follow from the event alone, so its line can tell them at once.

Each begins with the number of a frame, of eight digits, or of more if it has more.
"""

from __future__ import annotations

import hashlib
import re
import sys
from pathlib import Path

__all__ = ["CLIPS", "PICTURES", "clip_name", "forget_clips_before", "frame_of", "in_order", "picture_name"]

#: Folders of the pictures and the clips, in the stream's.
PICTURES, CLIPS = "events", "clips"

_FRAME = re.compile(r"\d+(?=-)", re.ASCII)


def picture_name(frame: int, layer: int) -> str:
    """Return the path, in the stream's folder, of an object in the frame that made its events certain."""
    return f"{PICTURES}/{frame:08d}-{layer}.jpg"


def clip_name(frame: int, event_id: str) -> str:
    """Return the path, in the stream's folder, of the clip of an event that began at a frame."""
    return f"{CLIPS}/{frame:08d}-{hashlib.sha256(event_id.encode()).hexdigest()[:8]}.mp4"


def frame_of(name: str) -> int:
    """Return the frame by which a name begins; one behind all frames if it begins otherwise."""
    found = _FRAME.match(name)
    return sys.maxsize if found is None else int(found[0])


def in_order(name: str) -> tuple[int, str]:
    """Return a key by which names are sorted in the order of their frames."""
    return frame_of(name), name


def forget_clips_before(folder: Path, frame: int) -> None:
    """Delete the clips in a stream's folder of events that began before a frame."""
    for path in (folder / CLIPS).glob("*.mp4"):
        if frame_of(path.name) < frame:
            path.unlink(missing_ok=True)
