"""Which clips events want, and which of them are one: pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from orchestrator.clips.settings import LONGEST_SHARED_SECONDS, ClipSettings

__all__ = ["Cut", "WantedClip", "next_cut", "wanted_clip"]

#: A camera's packets are in its ring this long after they were taken, s.
_LATE_SECONDS = 2.5


@dataclass(frozen=True, slots=True, order=True)
class WantedClip:
    """The clip that an event names.

    Attributes
    ----------
    begin, end : float
        What it shows: seconds since 1970, or since a video's first frame.
    path : str
        In the stream's folder.
    """

    begin: float
    end: float
    path: str


@dataclass(frozen=True, slots=True)
class Cut:
    """One clip to be made, for one event or several.

    Attributes
    ----------
    begin, end : float
        As of :class:`WantedClip`.
    paths : tuple of str
        All names that it gets.
    """

    begin: float
    end: float
    paths: tuple[str, ...]


def wanted_clip(event: dict[str, Any], settings: ClipSettings) -> WantedClip | None:
    """Return what an event of ``events.jsonl`` wants, None if that is no clip."""
    path = event.get("clip")
    if path is None:
        return None
    at = event["time"] if event["clock"] is None else datetime.fromisoformat(event["clock"]).timestamp()
    return WantedClip(at - settings.before, at + settings.after, path)


def next_cut(wanted: Sequence[WantedClip], now: float) -> Cut | None:
    """Return the oldest clip if all of it has been taken by now.

    Events that overlap with it share it, as long as it does not get too long.
    """
    if not wanted:
        return None
    first, *others = sorted(wanted)
    end, paths = first.end, [first.path]
    for one in others:
        together = max(end, one.end)
        if one.begin > end or together - first.begin > max(LONGEST_SHARED_SECONDS, end - first.begin):
            break
        end = together
        paths.append(one.path)
    return Cut(first.begin, end, tuple(paths)) if now >= end + _LATE_SECONDS else None
