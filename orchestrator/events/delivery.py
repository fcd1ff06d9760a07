"""Sends the events of a run to a target: at least once, in the order of each stream, without holding it up.

The files ``events.jsonl`` are the queue. For each target the run's folder holds how far every stream's file
was acknowledged. Lines that are not committed yet are sent, too, though a stream that goes back replaces
them; so only the committed part of a file is counted by its length, the rest by its ids.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from mlbs_actors.wording import count_of
from orchestrator.events.event_file import EVENTS, committed_bytes
from orchestrator.events.targets import DeliveryError, EventTarget, Sender, open_sender
from orchestrator.run.durable_files import replace_file
from orchestrator.sources.live_buffer import retry_seconds

__all__ = ["Delivery", "delivering"]

#: Between two looks at the files, s.
_LOOK_SECONDS = 0.1

#: How long the end of a run waits for what has not been delivered, s.
_GRACE_SECONDS = 5.0


@dataclass(slots=True)
class _Position:
    """How far a stream's events were acknowledged.

    Attributes
    ----------
    length : int
        All of this many bytes were, and they do not change.
    ids : list of str
        And these events behind them.
    """

    length: int = 0
    ids: list[str] = field(default_factory=list)


_POSITIONS = TypeAdapter(dict[str, _Position])


@contextmanager
def delivering(targets: Sequence[EventTarget], folder: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Deliver the events of a run's folder to all targets while the ``with`` block runs."""
    with ExitStack() as stack:
        for target in targets:
            delivery = Delivery(target.shown, target.url, partial(open_sender, target), folder, say)
            stack.callback(delivery.close)
        yield


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
        self._positions = _read_positions(self._path)
        self._looked: dict[Path, tuple[int, int]] = {}
        self._faulty: set[Path] = set()
        self._last_look, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

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
        for length, event in self._waiting(path):
            if not self._send(event, sender):
                return
            self._acknowledge(path, length, event)
        self._looked[path] = seen

    def _waiting(self, path: Path) -> Iterator[tuple[int, bytes]]:
        """Yield each event that was not acknowledged, with the length of the file up to its end."""
        position = self._positions.get(path.parent.name, _Position())
        known, length = set(position.ids), position.length
        with path.open("rb") as file:
            file.seek(length)
            for line in file:
                if not line.endswith(b"\n"):
                    return  # it is being written
                length += len(line)
                if json.loads(line)["id"] not in known:
                    yield length, line.rstrip()

    def _send(self, event: bytes, sender: Sender) -> bool:
        failures = 0
        while not self._stop.is_set():
            try:
                sender.send(event)
            except DeliveryError as error:
                failures += 1
                if failures == 1:
                    self._say(f"Events cannot be delivered to {self._name}: {error}. It is tried again.")
                self._stop.wait(retry_seconds(failures))
            else:
                if failures:
                    self._say(f"Events are delivered to {self._name} again.")
                return True
        return False

    def _acknowledge(self, path: Path, length: int, event: bytes) -> None:
        position = self._positions.setdefault(path.parent.name, _Position())
        position.ids.append(json.loads(event)["id"])
        end = min(length, committed_bytes(path.parent))
        if end > position.length:
            with path.open("rb") as file:
                file.seek(position.length)
                lines = file.read(end - position.length).splitlines()
            final = {json.loads(line)["id"] for line in lines}
            if final.issubset(position.ids):
                position.length, position.ids = end, [one for one in position.ids if one not in final]
        replace_file(self._path, _POSITIONS.dump_json(self._positions))


def _read_positions(path: Path) -> dict[str, _Position]:
    try:
        return _POSITIONS.validate_json(path.read_bytes())
    except (FileNotFoundError, ValidationError):
        return {}
