"""What is still to be sent: a small database in the run's folder.

The last lines of ``events.jsonl`` may be replaced by others when a stream goes back to a commit. Here every
event is taken once, as soon as it is written, told from others by its id; then it waits for each target that
wants it, until that has acknowledged it. What is delivered has no other form: it does not wait any more.

Every step is one transaction, so a kill comes before it or after it. The database is in SQLite's WAL mode, of
which a power cut can take the last steps; then their events come again. It is opened for one process alone,
which the lock of the run's folder allows: so SQLite needs no memory shared between processes, and the folder
may be on a network.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from orchestrator.events.census import Census
from orchestrator.events.event import EventKind
from orchestrator.events.event_filter import EventFilter

__all__ = ["Outbox", "Standing"]

_TABLES = """
PRAGMA locking_mode = EXCLUSIVE;
PRAGMA journal_mode = WAL;
PRAGMA synchronous = NORMAL;
CREATE TABLE IF NOT EXISTS targets (
    target TEXT PRIMARY KEY, wanted TEXT NOT NULL, accepted INTEGER NOT NULL, refused INTEGER NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS waiting (
    place INTEGER PRIMARY KEY AUTOINCREMENT, target TEXT NOT NULL,
    stream TEXT NOT NULL, number INTEGER NOT NULL, event BLOB NOT NULL
);
CREATE INDEX IF NOT EXISTS by_target ON waiting (target, place);
CREATE TABLE IF NOT EXISTS streams (
    stream TEXT PRIMARY KEY, number INTEGER NOT NULL, census TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS taken (
    stream TEXT NOT NULL, id TEXT NOT NULL, number INTEGER NOT NULL, PRIMARY KEY (stream, id)
) WITHOUT ROWID;
"""

#: For so many final events of a stream the ids of those before are still known: when it has gone back, an
#: event can come again so much later in the file than before, as other rules may hold by then.
_REMEMBERED = 1000


@dataclass(frozen=True, slots=True)
class Standing:
    """How far a target is.

    Attributes
    ----------
    waiting : int
        Events that it has not acknowledged.
    accepted, refused : int
        Events.
    """

    waiting: int = 0
    accepted: int = 0
    refused: int = 0


class Outbox:
    """The events that wait; its methods may be called by several threads.

    Parameters
    ----------
    path : Path
        Of the database; made if missing.

    Raises
    ------
    sqlite3.Error
        Here and from every method, if the disk or the file does not allow it; then nothing has changed.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._db = sqlite3.connect(path, check_same_thread=False)
        try:
            self._db.executescript(_TABLES)
            self._wanted = {
                target: _filter_of(wanted)
                for target, wanted in self._db.execute("SELECT target, wanted FROM targets")
            }
            self._final: dict[str, tuple[int, Census]] = {
                stream: (number, Census.read(census))
                for stream, number, census in self._db.execute("SELECT * FROM streams")
            }
        except BaseException:
            self._db.close()
            raise

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._db.close()

    def copy_to(self, path: Path) -> None:
        """Write what it holds now to another file."""
        with self._lock, closing(sqlite3.connect(path)) as copy:
            self._db.backup(copy)

    def standing(self, target: str) -> Standing:
        """Return how far a target is; that takes milliseconds even if a hundred thousand events wait."""
        with self._lock:
            (waiting,) = self._db.execute(
                "SELECT count(*) FROM waiting WHERE target = ?", (target,)
            ).fetchone()
            counts = self._db.execute("SELECT accepted, refused FROM targets WHERE target = ?", (target,))
            return Standing(waiting, *(counts.fetchone() or (0, 0)))

    def retarget(self, wanted: Mapping[str, EventFilter]) -> None:
        """Send to these targets what they want.

        A new one gets the events that are taken from now on; of one that is gone all is forgotten; from one
        that wants something else what it does not want any more is taken.
        """
        with self._lock:
            with self._db:
                for target in self._wanted.keys() - wanted.keys():
                    self._db.execute("DELETE FROM waiting WHERE target = ?", (target,))
                    self._db.execute("DELETE FROM targets WHERE target = ?", (target,))
                for target, filter_ in wanted.items():
                    if self._wanted.get(target, filter_) != filter_:
                        self._take_back(target, filter_)
                    self._db.execute(
                        "INSERT INTO targets VALUES (?, ?, 0, 0)"
                        " ON CONFLICT (target) DO UPDATE SET wanted = excluded.wanted",
                        (target, filter_.model_dump_json()),
                    )
            self._wanted = dict(wanted)

    def rename(self, before: str, now: str) -> None:
        """Take what is known of a stream for that of another name."""
        with self._lock:
            with self._db:
                for table in ("waiting", "streams", "taken"):
                    self._db.execute(
                        f"UPDATE OR REPLACE {table} SET stream = ? WHERE stream = ?", (now, before)
                    )
            if before in self._final:
                self._final[now] = self._final.pop(before)

    def take(self, stream: str, lines: Callable[[int], Iterable[bytes]], final: int) -> Census:
        """Let the new events of a stream wait for the targets that want them.

        Parameters
        ----------
        stream : str
        lines : callable
            Returns the lines of the file behind an event's number, perhaps with some of before.
        final : int
            Number up to which the events never change any more, read before the lines.

        Returns
        -------
        Census
            What all events of the file come to.
        """
        with self._lock:
            number, census = self._final.get(stream, (0, Census()))
            certain, uncertain = deepcopy(census), list[dict[str, object]]()
            newest = number
            with self._db:
                for line in lines(number):
                    event = json.loads(line)
                    if event["number"] <= number:
                        continue
                    known = self._taken_as(stream, event["id"])
                    if known is None:
                        self._wait(stream, event, line)
                    if event["number"] <= final:
                        newest = event["number"]
                        certain.add(event, final=True)
                        continue
                    uncertain.append(event)
                    if known != event["number"]:
                        row = stream, event["id"], event["number"]
                        self._db.execute("INSERT OR REPLACE INTO taken VALUES (?, ?, ?)", row)
                if newest > number:
                    row = stream, newest, certain.text()
                    self._db.execute("INSERT OR REPLACE INTO streams VALUES (?, ?, ?)", row)
                    old = stream, newest - _REMEMBERED
                    self._db.execute("DELETE FROM taken WHERE stream = ? AND number <= ?", old)
            self._final[stream] = newest, certain
        census = deepcopy(certain)
        for event in uncertain:
            census.add(event, final=False)
        return census

    def drop_before(self, stream: str, number: int) -> None:
        """Forget the oldest events of a stream, delivered or not: those before a number."""
        with self._lock, self._db:
            self._db.execute("DELETE FROM waiting WHERE stream = ? AND number < ?", (stream, number))

    def first(self, target: str) -> tuple[int, bytes] | None:
        """Return the place and the line of the event that a target gets next; None if none waits."""
        with self._lock:
            found: tuple[int, bytes] | None = self._db.execute(
                "SELECT place, event FROM waiting WHERE target = ? ORDER BY place LIMIT 1", (target,)
            ).fetchone()
        return found

    def done(self, target: str, place: int, *, refused: bool = False) -> None:
        """Note that a target has accepted the event at a place, or refused it for good."""
        column = "refused" if refused else "accepted"
        with self._lock, self._db:
            self._db.execute("DELETE FROM waiting WHERE place = ?", (place,))
            self._db.execute(f"UPDATE targets SET {column} = {column} + 1 WHERE target = ?", (target,))

    def _taken_as(self, stream: str, name: str) -> int | None:
        """Return the number that an event had when it was taken, None if it was not."""
        row = self._db.execute("SELECT number FROM taken WHERE stream = ? AND id = ?", (stream, name))
        found = row.fetchone()
        return None if found is None else int(found[0])

    def _wait(self, stream: str, event: Mapping[str, object], line: bytes) -> None:
        self._db.executemany(
            "INSERT INTO waiting (target, stream, number, event) VALUES (?, ?, ?, ?)",
            [(one, stream, event["number"], line) for one, by in self._wanted.items() if by.wants(event)],
        )

    def _take_back(self, target: str, wanted: EventFilter) -> None:
        rows = self._db.execute("SELECT place, event FROM waiting WHERE target = ?", (target,))
        unwanted = [(place,) for place, event in rows if not wanted.wants(json.loads(event))]
        self._db.executemany("DELETE FROM waiting WHERE place = ?", unwanted)


def _filter_of(text: str) -> EventFilter:
    """Read a filter; for one of another version all waits until it is known what is wanted."""
    try:
        return EventFilter.model_validate_json(text)
    except ValidationError:
        return EventFilter(kinds=get_args(EventKind))
