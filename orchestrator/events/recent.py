"""The newest events of a stream, as its file has them, for whoever looks on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from orchestrator.events.event_file import EVENTS
from orchestrator.storage.last_lines import last_lines

__all__ = ["RecentEvents", "recent_events"]

#: Most bytes that an event takes, well measured.
_EVENT_BYTES = 4000


def recent_events(folder: Path, most: int) -> list[dict[str, Any]]:
    """Return the last events of a stream in the order of its file, at most so many."""
    return [json.loads(line) for line in last_lines(folder / EVENTS, most, _EVENT_BYTES)]


class RecentEvents:
    """The newest events of some streams; a file is read again when it has changed."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: dict[Path, tuple[tuple[int, int], list[dict[str, Any]]]] = {}

    def of(self, folder: Path) -> list[dict[str, Any]]:
        """Return those of a stream."""
        try:
            stat = (folder / EVENTS).stat()
        except OSError:
            return []
        seen = stat.st_size, stat.st_mtime_ns
        if folder not in self._known or self._known[folder][0] != seen:
            self._known[folder] = seen, recent_events(folder, self._most)
        return self._known[folder][1]
