"""``events.jsonl`` of a stream: the events of its record, a JSON object a line.

A line is appended as soon as it is certain, so that it can be sent at once, and counts with the commit of the
row that made it certain. After a kill the record goes on from the mark of its last commit
(:mod:`.event_marks`), by other rules if they have changed, and the lines behind it are cut off.

Whoever sends the lines needs three things: numbers that ascend (the oldest lines can be deleted), ids that an
event keeps if it comes again, and how many lines are final (:func:`.event_marks.committed_events`).
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from mlbs_actors.record.frame_row import FrameRow
from orchestrator.counts.count_files import CountFiles
from orchestrator.counts.tally import Situation, Tally
from orchestrator.events.event import Event, EventKind
from orchestrator.events.event_marks import Mark, Step, draft_of_marks, marks_in, state_text
from orchestrator.events.event_state import EventState
from orchestrator.events.file_names import clip_name, picture_name
from orchestrator.events.happenings import Happenings
from orchestrator.events.zones import EventRules
from orchestrator.storage.durable_files import publish, replace_file

__all__ = ["EVENTS", "EventFile", "event_id"]

EVENTS = "events.jsonl"

#: Events of an object that have a picture, if the stream has zones.
_PICTURED = frozenset[EventKind](("born", "entered", "left", "crossed", "rule"))


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
        self._folder = folder
        self._stream = stream
        found = [mark for mark in marks_in(folder) if mark.rows == rows]
        # Without a mark, of an earlier version's record, what is there stays and the objects are born again.
        self._count_files = CountFiles(folder, stream)
        mark = found[-1] if found else Mark(rows, _cut(self._path, math.inf if rows else 0))
        if not found and rows:
            mark.counts.closed_bytes = self._count_files.length
        _cut(self._path, mark.events)
        self._kept = mark.text()
        self._events, self._began = mark.events, mark.began
        self._happenings = Happenings(rules, mark.state)
        self._digest = rules.digest
        self._asked = mark.asked if mark.rows else rules.described()
        self._was: dict[str, Any] | None = None
        self._tally = Tally(mark.counts)  # of the steps that count
        self._followed = state_text(mark.state)
        self._settled = Step(self._mark(), self._followed)  # the last of them
        self._steps: deque[Step] = deque()  # the others
        self._unwritten: list[str] = []
        if found and mark.rows and mark.rules != self._digest:
            self.configure(rules)

    @property
    def state(self) -> EventState:
        """What the next events depend on."""
        return self._happenings.state

    def add(self, row: FrameRow, taken: float | None) -> dict[int, set[str]]:
        """Add the next row of the record; return the objects whose pictures the lines name, with their zones.

        Parameters
        ----------
        row : FrameRow
        taken : float, optional
            When a camera took it, seconds since 1970.
        """
        if taken is not None:
            self._began = taken - row.pts
        clock = self.taken_at(row.pts)
        return self._take(self._happenings.after(row, clock), row, clock, self._happenings.situation(row))

    def silent(self) -> None:
        """Add that the source sends nothing after the rows so far."""
        if said := self._happenings.silent():
            self._take(said)

    def configure(self, rules: EventRules) -> None:
        """Follow other rules after the rows so far."""
        self._digest = rules.digest
        self._was, self._asked = self._asked, rules.described()
        self._take(self._happenings.configured(rules))

    def taken_at(self, pts: float) -> float | None:
        """Return when a camera took the frame of a time of the stream, seconds since 1970, if known."""
        return None if self._began is None else self._began + pts

    @property
    def unwritten(self) -> bool:
        """Whether there are lines to write."""
        return bool(self._unwritten)

    def write(self) -> None:
        """Append the lines; OSError as the disk says."""
        with self._path.open("a", encoding="utf-8") as file:
            file.writelines(self._unwritten)
        self._unwritten = []

    def drafts(self, rows: int, *, at_end: bool = False) -> list[Path]:
        """Let the events of the first ``rows`` rows count; return the files to publish before their commit.

        Parameters
        ----------
        rows : int
        at_end : bool
            Whether all is committed, and what comes with the stream's end counts, too.
        """
        while self._steps and (at_end or self._steps[0].mark.rows <= rows):
            self._settled = step = self._steps.popleft()
            if step.row is not None:
                self._tally.add(step.row, step.clock, step.situation)
            for event in step.said:
                self._tally.count(event.kind, event.zone, event.direction, step.mark.state.dropped_share)
        counted = self._count_files.drafts(self._tally, at_once=at_end)
        before, self._kept = self._kept, self._settled.whole_mark(rows, self._tally.state)
        marks = [self._kept] if at_end else [before, self._kept]
        with self._path.open("ab") as file:
            os.fsync(file.fileno())
        return [*counted, draft_of_marks(self._folder, marks)]

    def finish(self, rows: int) -> None:
        """Write what is certain as the stream has come to its end after so many rows."""
        self._take(self._happenings.end())
        self.write()
        publish(self.drafts(rows, at_end=True))

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

    def _take(
        self,
        said: Sequence[Event],
        row: FrameRow | None = None,
        clock: float | None = None,
        situation: Situation | None = None,
    ) -> dict[int, set[str]]:
        """Make lines of what is certain, which counts later; return the objects whose pictures they name."""
        pictured = {} if row is None else self._pictured(said, row)
        for event in said:
            self._events += 1
            picture = None
            if row is not None and event.kind in _PICTURED and event.layer in pictured:
                picture = picture_name(row.frame, event.layer)
            self._unwritten.append(json.dumps(self._described(event, picture)) + "\n")
        if row is None or row.result is not None:
            self._followed = state_text(self.state)
        self._steps.append(Step(self._mark(), self._followed, said, row, clock, situation))
        return pictured

    def _mark(self) -> Mark:
        """Return where the events continue now, without what they follow and have come to."""
        state = replace(self.state, shown=None, objects={}, rules={}, faults=[])
        return Mark(state.rows, self._events, self._began, state, self._digest, asked=self._asked)

    def _pictured(self, said: Sequence[Event], row: FrameRow) -> dict[int, set[str]]:
        pictured: dict[int, set[str]] = {}
        if row.result is None or not self._happenings.rules.zones:
            return pictured
        here = {layer.layer for layer in row.result.layers}
        for event in said:
            if event.kind in _PICTURED and event.layer is not None and event.layer in here:
                pictured.setdefault(event.layer, set()).update(filter(None, [event.zone]))
        return pictured

    def _described(self, event: Event, picture: str | None) -> dict[str, Any]:
        """Return the newest event as its line has it."""
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
            "number": self._events,
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


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="milliseconds")


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
