"""Sends the events of a run to a target: at least once, in the order of each stream, without holding it up.

The files ``events.jsonl`` are the queue. For each target the run's folder holds how far every stream's file
was acknowledged. Lines that are not committed yet are sent, too, though a stream that goes back replaces
them; so only the committed part of a file is counted by numbers, the rest by its ids. The oldest lines of a
camera can be deleted, delivered or not, as the queue is bounded. An event that a target refuses is set aside,
and the next one is sent.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from pydantic import TypeAdapter, ValidationError

from mlbs_actors.wording import count_of
from orchestrator.events.event_file import EVENTS, committed_events
from orchestrator.events.recent import recent_events
from orchestrator.events.targets import DeliveryError, EventTarget, RefusedEventError, Sender, open_sender
from orchestrator.sources.live_buffer import retry_seconds
from orchestrator.storage.durable_files import replace_file

__all__ = ["Backlog", "Deliveries", "Delivery"]

#: File of the run's folder with what targets have refused.
_REFUSED = "events-refused.jsonl"

#: Between two looks at the files, s.
_LOOK_SECONDS = 0.1

#: How long the end of a run waits for what has not been delivered, s.
_GRACE_SECONDS = 5.0


@dataclass(slots=True)
class _Position:
    """How far a stream's events were acknowledged.

    Attributes
    ----------
    number : int
        All events up to this number were, and they do not change.
    ids : dict of str to int
        And these events behind them, with their numbers.
    """

    number: int = 0
    ids: dict[str, int] = field(default_factory=dict)


_POSITIONS = TypeAdapter(dict[str, _Position])


@dataclass(frozen=True, slots=True)
class Backlog:
    """What a target has not acknowledged.

    Attributes
    ----------
    target : str
        Without secrets.
    waiting : int
        Events.
    away_since : float, optional
        When it stopped accepting them, seconds since 1970; None while it does.
    refused : int
        Events that it refused, which are set aside.
    """

    target: str
    waiting: int
    away_since: float | None
    refused: int = 0

    @property
    def away_seconds(self) -> float:
        """For how long it has accepted nothing, s; 0 while it does."""
        return 0.0 if self.away_since is None else max(time.time() - self.away_since, 0.0)

    def figures(self) -> dict[str, Any]:
        """All values, by name, in JSON types."""
        away = None
        if self.away_since is not None:
            away = datetime.fromtimestamp(self.away_since, timezone.utc).isoformat(timespec="seconds")
        return {"target": self.target, "waiting": self.waiting, "away_since": away, "refused": self.refused}


class Deliveries:
    """Delivers the events of a run's folder to all targets, from the start to the end of a ``with`` block."""

    def __init__(self, targets: Sequence[EventTarget], folder: Path, say: Callable[[str], None]) -> None:
        self._all = [
            Delivery(name, target.url, partial(open_sender, target), folder, say)
            for name, target in zip(_names(targets), targets, strict=True)
        ]
        self._closing = ExitStack()

    def __enter__(self) -> Deliveries:
        for delivery in self._all:
            delivery.start()
            self._closing.callback(delivery.close)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        self._closing.close()

    def backlogs(self) -> list[Backlog]:
        """Return what each target has not acknowledged."""
        return [delivery.backlog() for delivery in self._all]


class Delivery:
    """Delivers to one target, in a thread of its own.

    Parameters
    ----------
    name : str
        Of the target, without secrets, for messages.
    key : str
        What tells it from other targets.
    open_sender : callable
        Returns a way to it.
    folder : Path
        Of the run.
    say : callable
        Receives a sentence when the target goes away, when it is back, and at the end.
    """

    def __init__(
        self,
        name: str,
        key: str,
        open_sender: Callable[[], Sender],
        folder: Path,
        say: Callable[[str], None],
    ) -> None:
        self._name = name
        self._open_sender = open_sender
        self._folder = folder
        self._say = say
        self._path = folder / f".delivered-{hashlib.sha256(key.encode()).hexdigest()[:12]}.json"
        self._positions: dict[str, _Position] = {}
        self._away_since: float | None = None
        self._refused = 0
        self._has_accepted = False
        self._looked: dict[Path, tuple[int, int]] = {}
        # Of each file the inode, and where its first line is that may be waiting.
        self._starts: dict[Path, tuple[int, int]] = {}
        self._faulty: set[Path] = set()
        self._last_look, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Go on where an earlier run was; the run's folder is locked."""
        self._positions = _read_positions(self._path)
        self._has_accepted = any(one.number or one.ids for one in self._positions.values())
        self._refused = sum(one.get("target") == self._name for one in _refused_events(self._folder))
        self._thread.start()

    def backlog(self) -> Backlog:
        """Return what the target has not acknowledged, counted by numbers, as that takes no time."""
        waiting = 0
        for path in self._files():
            position = self._positions.get(path.parent.name, _Position())
            oldest, newest = _numbers(path)
            waiting += max(newest - max(position.number, oldest - 1) - len(position.ids), 0)
        return Backlog(self._name, waiting, self._away_since, self._refused)

    def close(self) -> None:
        """Deliver what there is, for a limited time, and stop."""
        self._last_look.set()
        self._thread.join(_GRACE_SECONDS)
        self._stop.set()
        left = sum(1 for path in self._files() for _ in self._waiting(path))
        if left:
            self._say(
                f"{count_of(left, 'event')} could not be delivered to {self._name}; the same command with "
                "--resume tries again."
            )

    def _run(self) -> None:
        sender = self._open_sender()
        try:
            while not self._stop.is_set():
                last = self._last_look.is_set()
                for path in self._files():
                    try:
                        self._deliver(path, sender)
                    except (OSError, ValueError) as error:
                        self._complain(path, error)
                if last:
                    break
                self._last_look.wait(_LOOK_SECONDS)
        finally:
            sender.close()

    def _complain(self, path: Path, error: Exception) -> None:
        """Say once why a file's events wait; a line that is just replaced cannot be read for a moment."""
        if isinstance(error, OSError) and path not in self._faulty:
            self._faulty.add(path)
            self._say(f"Events of {path.parent.name} wait: {error.strerror} ({path}). It is tried again.")

    def _files(self) -> list[Path]:
        return sorted(self._folder.glob(f"*/{EVENTS}"))

    def _deliver(self, path: Path, sender: Sender) -> None:
        stat = path.stat()
        seen = stat.st_size, stat.st_mtime_ns
        if self._looked.get(path) == seen:
            return
        for event in self._waiting(path):
            if not self._send(event, sender):
                return
            self._acknowledge(path, event)
        self._looked[path] = seen

    def _waiting(self, path: Path) -> Iterator[bytes]:
        """Yield each event that was not acknowledged."""
        known = set(self._position(path).ids)
        for line, event in self._behind_position(path):
            if event["id"] not in known:
                yield line.rstrip()

    def _position(self, path: Path) -> _Position:
        return self._positions.setdefault(path.parent.name, _Position())

    def _behind_position(self, path: Path) -> Iterator[tuple[bytes, dict[str, Any]]]:
        """Yield the lines behind a file's position, with their contents."""
        number = self._position(path).number
        with path.open("rb") as file:
            inode = os.fstat(file.fileno()).st_ino
            before, place = self._starts.get(path, (inode, 0))
            place = place if before == inode else 0
            file.seek(place)
            for line in file:
                if not line.endswith(b"\n"):
                    return  # it is being written
                place += len(line)
                event = json.loads(line)
                if event.get("number", 0) > number:  # an earlier version's have none
                    yield line, event
                else:
                    self._starts[path] = inode, place

    def _send(self, event: bytes, sender: Sender) -> bool:
        failures = 0
        while not self._stop.is_set():
            try:
                self._send_or_set_aside(event, sender)
            except (DeliveryError, OSError) as error:
                failures += 1
                if failures == 1:
                    self._away_since = time.time()
                    reason = str(error).rstrip(".")
                    self._say(f"Events cannot be delivered to {self._name}: {reason}. It is tried again.")
                self._stop.wait(retry_seconds(failures))
            else:
                self._away_since, self._has_accepted = None, True
                if failures:
                    self._say(f"Events are delivered to {self._name} again.")
                return True
        return False

    def _send_or_set_aside(self, event: bytes, sender: Sender) -> None:
        try:
            sender.send(event)
        except RefusedEventError as error:
            if not (error.is_certain or self._has_accepted):
                raise
            self._set_aside(event, str(error))

    def _set_aside(self, event: bytes, answer: str) -> None:
        """Keep an event that will never be accepted where the operator finds it; say so the first time."""
        line = {"target": self._name, "answer": answer, "event": json.loads(event)}
        with (self._folder / _REFUSED).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self._refused += 1
        if self._refused == 1:
            self._say(
                f"{self._name} refuses an event: {answer.rstrip('.')}. It is set aside in {_REFUSED}, and so "
                "will be others; the next one is sent."
            )

    def _acknowledge(self, path: Path, line: bytes) -> None:
        position, event = self._position(path), json.loads(line)
        position.ids[event["id"]] = event["number"]
        end = min(event["number"], committed_events(path.parent))
        if end > position.number:
            final = {event["id"] for _, event in self._behind_position(path) if event["number"] <= end}
            if final.issubset(position.ids):
                position.number = end
                position.ids = {one: number for one, number in position.ids.items() if number > end}
        replace_file(self._path, _POSITIONS.dump_json(self._positions))


def _read_positions(path: Path) -> dict[str, _Position]:
    try:
        return _POSITIONS.validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):
        return {}


def _refused_events(folder: Path) -> list[dict[str, Any]]:
    try:
        lines = (folder / _REFUSED).read_text(encoding="utf-8").splitlines(keepends=True)
    except FileNotFoundError:
        return []
    events = []
    for line in lines:
        with suppress(ValueError):  # a torn one
            events.append(json.loads(line))
    return [one for one in events if isinstance(one, dict)]


def _names(targets: Sequence[EventTarget]) -> list[str]:
    """Return what each target is called; those that differ only in what is not shown are numbered."""
    shown = [target.shown for target in targets]
    earlier = [shown[:place].count(name) for place, name in enumerate(shown)]
    return [f"{name} ({many + 1})" if many else name for name, many in zip(shown, earlier, strict=True)]


def _numbers(path: Path) -> tuple[int, int]:
    """Return the numbers of the oldest and the newest event of a file; 1 and 0 if it has none.

    So it has for a moment while its last lines are replaced.
    """
    try:
        with path.open("rb") as file:
            oldest = json.loads(file.readline())
        [newest] = recent_events(path.parent, 1)
    except (OSError, ValueError):
        return 1, 0
    return oldest.get("number", 1), newest.get("number", 0)
