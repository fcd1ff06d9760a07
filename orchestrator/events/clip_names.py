"""Names of the clips of events. A name follows from the event alone, so its line can tell it at once."""

from __future__ import annotations

import hashlib
from pathlib import Path

from orchestrator.events.frame_names import frame_of

__all__ = ["CLIPS", "clip_name", "forget_clips_before"]

#: Folder of the clips, in the stream's.
CLIPS = "clips"


def clip_name(frame: int, event_id: str) -> str:
    """Return the path, in the stream's folder, of the clip of an event that began at a frame."""
    return f"{CLIPS}/{frame:08d}-{hashlib.sha256(event_id.encode()).hexdigest()[:8]}.mp4"


def forget_clips_before(folder: Path, frame: int) -> None:
    """Delete the clips in a stream's folder of events that began before a frame."""
    for path in (folder / CLIPS).glob("*.mp4"):
        if frame_of(path.name) < frame:
            path.unlink(missing_ok=True)
