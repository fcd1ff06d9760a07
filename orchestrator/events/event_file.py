"""``events.jsonl`` of a stream: the events of its record, a JSON object a line.

A line is appended as soon as it is certain, so that it can be sent at once, and counts with the commit of the
row that made it certain. ``.events`` holds what the events continue from after the last two commits, and how
many there were then: a record that is opened again cuts the file off behind those, and goes on. Events are
numbered, because the oldest lines can be deleted.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from orchestrator.events.happenings import Event, EventState, Happenings
from orchestrator.events.zones import EventRules
from orchestrator.run.durable_files import publish, replace_file, temporary_path
from orchestrator.sinks.tables import FrameRow

__all__ = ["EVENTS", "EventFile", "committed_events", "event_id"]

EVENTS = "events.jsonl"

_MARKS = ".events"

#: A difference of the clocks that is no delay: the machine's clock was set, s.
_CLOCK_SET_SECONDS = 60.0


@dataclass(slots=True)
class _Mark:
    """Where the events continue after ``rows`` rows.

    Attributes
    ----------
    rows : int
    events : int
        Number of them up to there.
    began : float, optional
        When a camera's stream began, seconds since 1970.
    state : EventState
    """

    rows: int
    events: int
    began: float | None = None
    state: EventState = field(default_factory=EventState)


_MARK = TypeAdapter(_Mark)
_MARKS_READ = TypeAdapter(list[_Mark])


class EventFile:
    """The events of one stream; made and written to only while other processes are kept out.

    Parameters
    ----------
    folder : Path
        Of the stream.
    stream : str
        Its name.
    rules : EventRules
    rows : int
        Rows of the record that count.
    """

    def __init__(self, folder: Path, stream: str, rules: EventRules, rows: int) -> None:
        self._path = folder / EVENTS
        self._marks_path = folder / _MARKS
        self._stream = stream
        found = [mark for mark in _read_marks(self._marks_path) if mark.rows == rows]
        # Without a mark, of an earlier version's record, what is there stays and the objects are born again.
        mark = found[-1] if found else _Mark(rows, _cut(self._path, math.inf if rows else 0))
        _cut(self._path, mark.events)
        self._happenings = Happenings(rules, mark.state)
        self._began = mark.began
        self._events = mark.events
        self._rows = rows
        self._kept = _MARK.dump_json(mark)
        self._later: deque[tuple[int, bytes]] = deque()
        self._unwritten: list[str] = []

    @property
    def unwritten(self) -> bool:
        """Whether there are lines to write."""
        return bool(self._unwritten)

    def set_clock(self, began: float) -> None:
        """Note that by the newest row a camera's stream began at a time, seconds since 1970."""
        # Rows come late by what they take; the least of all delays is nearest to the truth.
        if self._began is None or not self._began <= began < self._began + _CLOCK_SET_SECONDS:
            self._began = began

    def taken_at(self, pts: float) -> float:
        """Return when a camera took the frame of a time of the stream, seconds since 1970."""
        assert self._began is not None  # since the first row
        return self._began + pts

    def add(self, row: FrameRow) -> None:
        """Add the next row of the record."""
        self._rows = row.frame + 1
        self._say(self._happenings.after(row))
        self._later.append((self._rows, self._mark()))

    def write(self) -> None:
        """Append the lines; OSError as the disk says."""
        with self._path.open("a", encoding="utf-8") as file:
            file.writelines(self._unwritten)
        self._unwritten = []

    def draft(self, rows: int) -> Path:
        """Sync the events of the first ``rows`` rows; return the file to publish before their commit."""
        mark = self._kept
        while self._later and self._later[0][0] <= rows:
            mark = self._later.popleft()[1]
        self._sync()
        temporary_path(self._marks_path).write_bytes(b"[" + self._kept + b",\n" + mark + b"]\n")
        self._kept = mark
        return self._marks_path

    def finish(self) -> None:
        """Write what is certain as the stream has come to its end."""
        self._say(self._happenings.end())
        self.write()
        self._sync()
        self._kept = self._mark()
        temporary_path(self._marks_path).write_bytes(b"[" + self._kept + b"]\n")
        publish([self._marks_path])

    def forget_before(self, frame: int) -> None:
        """Delete the oldest lines, as far as they are of frames before a number."""
        with self._path.open("rb") as file:
            for line in file:
                if json.loads(line)["frame"] >= frame:
                    rest = line + file.read()
                    break
            else:
                rest = b""
        replace_file(self._path, rest)

    def _say(self, events: list[Event]) -> None:
        for event in events:
            self._events += 1
            self._unwritten.append(json.dumps(self._described(event)) + "\n")

    def _described(self, event: Event) -> dict[str, Any]:
        return {
            "id": event_id(self._stream, event),
            "stream": self._stream,
            "kind": event.kind,
            "frame": event.frame,
            "time": round(event.pts, 3),
            "clock": None if self._began is None else _iso(self._began + event.pts),
            "object": event.layer,
            "box": None if event.region is None else list(event.region.box),
            "zone": event.zone,
            "direction": event.direction,
            "reason": event.reason,
            "replaced_by": event.replaced_by,
            "number": self._events,
        }

    def _mark(self) -> bytes:
        return _MARK.dump_json(_Mark(self._rows, self._events, self._began, self._happenings.state))

    def _sync(self) -> None:
        with self._path.open("ab") as file:
            os.fsync(file.fileno())


def event_id(stream: str, event: Event) -> str:
    """Return what no other event of the stream has, and the same event always.

    Of a camera, frames that were not committed before a kill are gone, and others get their numbers, but not
    their times.
    """
    parts = (stream, event.frame, f"{event.pts:.3f}", event.kind, event.layer, event.zone)
    return "/".join(str(part) for part in parts if part is not None)


def committed_events(folder: Path) -> int:
    """Return the number of a stream's events that never change any more."""
    return min((mark.events for mark in _read_marks(folder / _MARKS)), default=0)


def _cut(path: Path, events: float) -> int:
    """Cut a file off behind the event of a number; return the number of the last one that is left."""
    if not path.exists():
        return 0
    last = length = 0
    with suppress(ValueError), path.open("rb") as file:  # a torn line is the last one
        for line in file:
            number = json.loads(line).get("number", 1)  # an earlier version's have none
            if number > events:
                break
            last, length = number, length + len(line)
    if length < path.stat().st_size:
        os.truncate(path, length)
    return last


def _read_marks(path: Path) -> list[_Mark]:
    try:
        return _MARKS_READ.validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):
        return []


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="milliseconds")
