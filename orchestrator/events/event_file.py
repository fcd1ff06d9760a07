"""``events.jsonl`` of a stream: the events of its record, a JSON object a line.

A line is appended as soon as it is certain, so that it can be sent at once, and counts with the commit of the
row that made it certain. ``.events`` holds what the events continue from after the last two commits, and how
many there were then: a record that is opened again cuts the file off behind those, and goes on, by other
rules if they have changed. That is worked out from the rows when they are committed, for nobody knows before
which of a camera's rows will be the last of a commit. Events are numbered, because the oldest lines can be
deleted.
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

from mlbs_actors.record.frame_row import FrameRow
from orchestrator.counts.count_files import CountFiles
from orchestrator.counts.tally import CountState, Tally
from orchestrator.events.clip_names import clip_name
from orchestrator.events.event import Event, EventKind
from orchestrator.events.event_state import EventState
from orchestrator.events.happenings import Happenings
from orchestrator.events.pictures import picture_name
from orchestrator.events.situation import situation_after
from orchestrator.events.zones import EventRules
from orchestrator.storage.durable_files import publish, replace_file, temporary_path

__all__ = ["EVENTS", "EventFile", "committed_events", "event_id"]

EVENTS = "events.jsonl"

_MARKS = ".events"

#: Events of an object that have a picture, if the stream has zones.
_PICTURED = frozenset[EventKind](("born", "entered", "left", "crossed", "rule"))


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
    rules : str, optional
        What tells the rules by which they were made from others; an earlier version's have none.
    counts : CountState
        What rows and events have come to.
    asked : mapping of str to object, optional
        What these rules and the other settings were.
    """

    rows: int
    events: int
    began: float | None = None
    state: EventState = field(default_factory=EventState)
    rules: str | None = None
    counts: CountState = field(default_factory=CountState)
    asked: dict[str, Any] | None = None


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
        found = [mark for mark in _read_marks(self._marks_path) if mark.rows == rows]
        # Without a mark, of an earlier version's record, what is there stays and the objects are born again.
        self._count_files = CountFiles(folder, stream)
        mark = found[-1] if found else _Mark(rows, _cut(self._path, math.inf if rows else 0))
        if not found and rows:
            mark.counts.closed_bytes = self._count_files.length
        _cut(self._path, mark.events)
        self._kept = _MARK.dump_json(mark)
        # Rows that are not committed go through twice: as they come, and with their commit.
        self._newest = _EventLines(stream, rules, mark)
        self._tally = Tally(mark.counts)
        self._committed = _EventLines(stream, rules, _MARK.validate_json(self._kept), self._tally)
        self._later: deque[_Step] = deque()
        self._unwritten: list[str] = []
        if found and mark.rows and mark.rules != rules.digest:
            self.configure(rules)

    @property
    def state(self) -> EventState:
        """What the next events depend on."""
        return self._newest.state

    @property
    def unwritten(self) -> bool:
        """Whether there are lines to write."""
        return bool(self._unwritten)

    def add(self, row: FrameRow, taken: float | None) -> dict[int, set[str]]:
        """Add the next row of the record; return the objects whose pictures the lines name, with their zones.

        Parameters
        ----------
        row : FrameRow
        taken : float, optional
            When a camera took it, seconds since 1970.
        """
        return self._take(_Step(row, None if taken is None else taken - row.pts))

    def silent(self) -> None:
        """Add that the source sends nothing after the rows so far."""
        self._take(_Step(None, None))

    def configure(self, rules: EventRules) -> None:
        """Follow other rules after the rows so far."""
        self._take(_Step(None, None, rules))

    def taken_at(self, pts: float) -> float | None:
        """Return when a camera took the frame of a time of the stream, seconds since 1970, if known."""
        return self._newest.taken_at(pts)

    def write(self) -> None:
        """Append the lines; OSError as the disk says."""
        with self._path.open("a", encoding="utf-8") as file:
            file.writelines(self._unwritten)
        self._unwritten = []

    def drafts(self, rows: int) -> list[Path]:
        """Sync the events of the first ``rows`` rows; return the files to publish before their commit."""
        while self._later and (self._later[0].row is None or self._later[0].row.frame < rows):
            self._committed.after(self._later.popleft())
        counted = self._count_files.drafts(self._tally)
        mark = self._committed.mark(rows)
        self._sync()
        temporary_path(self._marks_path).write_bytes(b"[" + self._kept + b",\n" + mark + b"]\n")
        self._kept = mark
        return [*counted, self._marks_path]

    def finish(self, rows: int) -> None:
        """Write what is certain as the stream has come to its end after so many rows."""
        while self._later:
            self._committed.after(self._later.popleft())
        self._committed.at_end()
        self._unwritten += self._newest.at_end()
        self.write()
        counted = self._count_files.drafts(self._tally, at_once=True)
        self._sync()
        self._kept = self._committed.mark(rows)
        temporary_path(self._marks_path).write_bytes(b"[" + self._kept + b"]\n")
        publish([*counted, self._marks_path])

    def show_counts(self) -> None:
        """Write the counts as they were with the last commit."""
        publish(self._count_files.drafts(self._tally, at_once=True))

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

    def _take(self, step: _Step) -> dict[int, set[str]]:
        lines = self._newest.after(step)
        self._unwritten += lines
        self._later.append(step)
        return self._newest.pictured

    def _sync(self) -> None:
        with self._path.open("ab") as file:
            os.fsync(file.fileno())


@dataclass(frozen=True, slots=True)
class _Step:
    """What comes next.

    Attributes
    ----------
    row : FrameRow, optional
        None for other rules, or else a silence.
    began : float, optional
        When the stream began by that row, seconds since 1970.
    rules : EventRules, optional
        Other ones, from here on.
    """

    row: FrameRow | None
    began: float | None
    rules: EventRules | None = None


class _EventLines:
    """Makes lines of rows, from a mark on, and counts them if there is a tally."""

    def __init__(self, stream: str, rules: EventRules, mark: _Mark, tally: Tally | None = None) -> None:
        self._stream = stream
        self._tally = tally
        self._happenings = Happenings(rules, mark.state)
        self._asked = mark.asked if mark.rows else rules.described()
        self._was: dict[str, Any] | None = None
        self.pictured: dict[int, set[str]] = {}  # objects that the newest lines name pictures of, their zones
        self._events, self._began = mark.events, mark.began

    @property
    def state(self) -> EventState:
        return self._happenings.state

    def taken_at(self, pts: float) -> float | None:
        return None if self._began is None else self._began + pts

    def after(self, step: _Step) -> list[str]:
        if step.began is not None:
            self._began = step.began
        if step.rules is not None:
            events = self._happenings.configured(step.rules)
            self._was, self._asked = self._asked, step.rules.described()
        elif step.row is None:
            events = self._happenings.silent()
        else:
            events = self._happenings.after(step.row, self.taken_at(step.row.pts))
            if self._tally is not None:
                situation = situation_after(step.row, self._happenings)
                self._tally.add(step.row, self.taken_at(step.row.pts), situation)
        return self._lines(events, step.row)

    def at_end(self) -> list[str]:
        return self._lines(self._happenings.end(), None)

    def mark(self, rows: int) -> bytes:
        state, rules = self._happenings.state, self._happenings.rules
        counts = CountState() if self._tally is None else self._tally.state
        return _MARK.dump_json(
            _Mark(rows, self._events, self._began, state, rules.digest, counts, self._asked)
        )

    def _lines(self, events: list[Event], row: FrameRow | None) -> list[str]:
        if self._tally is not None:
            share = self._happenings.state.dropped_share
            for event in events:
                self._tally.count(event.kind, event.zone, event.direction, share)
        here = set()
        if row is not None and row.result is not None and self._happenings.rules.zones:
            here = {layer.layer for layer in row.result.layers}
        self.pictured = {}
        for event in events:
            if event.kind in _PICTURED and event.layer is not None and event.layer in here:
                self.pictured.setdefault(event.layer, set()).update(filter(None, [event.zone]))
        first = self._events + 1
        self._events += len(events)
        described = (self._described(event, row, number) for number, event in enumerate(events, first))
        return [json.dumps(one) + "\n" for one in described]

    def _described(self, event: Event, row: FrameRow | None, number: int) -> dict[str, Any]:
        picture = None
        if row is not None and event.kind in _PICTURED and event.layer in self.pictured:
            picture = picture_name(row.frame, event.layer)
        identity = event_id(self._stream, event)
        was, now = (self._was, self._asked) if event.kind == "configured" else (None, None)
        return {
            "id": identity,
            "stream": self._stream,
            "kind": event.kind,
            "frame": event.frame,
            "time": round(event.pts, 3),
            "clock": None if (clock := self.taken_at(event.pts)) is None else _iso(clock),
            "object": event.layer,
            "box": None if event.region is None else list(event.region.box),
            "zone": event.zone,
            "direction": event.direction,
            "dropped_share": round(self.state.dropped_share, 3) if event.kind == "crossed" else None,
            "rule": event.rule,
            "objects": None if event.objects is None else list(event.objects),
            "score": _rounded(event.score),
            "area": event.area,
            "seconds": _rounded(event.seconds),
            "reason": event.reason,
            "replaced_by": event.replaced_by,
            "was": _other_than(now, was),
            "now": _other_than(was, now),
            "picture": picture,
            "clip": clip_name(event.frame, identity) if event.kind in self._happenings.rules.clips else None,
            "number": number,
        }


def event_id(stream: str, event: Event) -> str:
    """Return what no other event of the stream has, and the same event always.

    Of a camera, frames that were not committed before a kill are gone, and others get their numbers, but not
    their times.
    """
    name = event.reason if event.kind == "configured" else event.rule
    parts = (stream, event.frame, f"{event.pts:.3f}", event.kind, event.layer, event.zone, name)
    return "/".join(str(part) for part in parts if part is not None)


def _other_than(others: dict[str, Any] | None, settings: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the settings that are other ones there, or are not there; None if one of both is not known."""
    if others is None or settings is None:
        return None
    missing = object()
    return {name: value for name, value in settings.items() if others.get(name, missing) != value}


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


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
