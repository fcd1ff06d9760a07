"""Marks in the events of a stream: where they continue after a row, and how many there were up to there.

After a kill the record goes on from its last commit, so with each commit its mark is published, in
``.events``. There are those of the last two commits, as a mark is published before its commit, which may
never come. Which of a camera's rows will be the last of a commit is known only when it is due; so the mark of
every row waits in memory until then, as part of a *step*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from mlbs_actors.record.frame_row import FrameRow
from orchestrator.counts.tally import CountState, Situation
from orchestrator.events.event import Event
from orchestrator.events.event_state import EventState
from orchestrator.storage.durable_files import temporary_path

__all__ = ["Mark", "Step", "committed_events", "draft_of_marks", "marks_in", "state_text"]

_MARKS = ".events"


@dataclass(slots=True)
class Mark:
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

    def text(self) -> bytes:
        """Return it as JSON."""
        return _MARK.dump_json(self)


_STATE = TypeAdapter(EventState)
_MARK = TypeAdapter(Mark)
_MARKS_READ = TypeAdapter(list[Mark])


@dataclass(frozen=True, slots=True)
class Step:
    """What counts with a commit: a row, or what came between two of them, such as other rules.

    Attributes
    ----------
    mark : Mark
        Where the events continue after it, without counts, and of its state without what is in ``followed``.
    followed : bytes
        The state as JSON, as of the last step that changed more than numbers in it; steps share it, as a
        camera can have thousands of rows between two commits.
    said : sequence of Event
    row : FrameRow, optional
    clock : float, optional
        When it was taken, seconds since 1970.
    situation : Situation, optional
        After it.
    """

    mark: Mark
    followed: bytes
    said: Sequence[Event] = ()
    row: FrameRow | None = None
    clock: float | None = None
    situation: Situation | None = None

    def whole_mark(self, rows: int, counts: CountState) -> bytes:
        """Return the mark after so many rows as JSON, with these counts."""
        known = _STATE.validate_json(self.followed)
        state = replace(
            self.mark.state, shown=known.shown, objects=known.objects, rules=known.rules, faults=known.faults
        )
        return replace(self.mark, rows=rows, state=state, counts=counts).text()


def state_text(state: EventState) -> bytes:
    """Return a state as JSON, as steps have it."""
    return _STATE.dump_json(state)


def marks_in(folder: Path) -> list[Mark]:
    """Return the marks of a stream; none if there is no file of them that can be read."""
    try:
        return _MARKS_READ.validate_json((folder / _MARKS).read_bytes())
    except (FileNotFoundError, ValidationError):
        return []


def draft_of_marks(folder: Path, marks: Sequence[bytes]) -> Path:
    """Write marks, as JSON, under a temporary name; return the name to be published."""
    path = folder / _MARKS
    temporary_path(path).write_bytes(b"[" + b",\n".join(marks) + b"]\n")
    return path


def committed_events(folder: Path) -> int:
    """Return the number of a stream's events that never change any more."""
    return min((mark.events for mark in marks_in(folder)), default=0)
