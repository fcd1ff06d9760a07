"""Sends the events of a run to its targets: at least once, in the order of each stream, holding nothing up.

One thread takes what is written into the outbox; each target has a carrier for what waits for it there.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any

from mlbs_actors.errors import ConfigError
from mlbs_actors.wording import count_of
from orchestrator.events.carrier import Carrier, Mail
from orchestrator.events.home_assistant import Camera
from orchestrator.events.intake import Intake
from orchestrator.events.outbox import Outbox, Standing
from orchestrator.events.targets import EventTarget

__all__ = ["OUTBOX", "Backlog", "Deliveries"]

#: The outbox, in the run's folder.
OUTBOX = ".outbox.sqlite"

#: Between two looks at the files, s.
_LOOK_SECONDS = 0.1

#: How long the end of a run waits for what has not been delivered, s.
_GRACE_SECONDS = 5.0


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
    """Delivers the events of a run's folder to all targets, from the start to the end of a ``with`` block.

    Parameters
    ----------
    targets : sequence of EventTarget, optional
        None while they are not known: then what waits goes on waiting.
    folder : Path
        Of the run, which is locked for this process.
    say : callable
        Receives a sentence when a target goes away, when it is back, and at the end.
    page : str, optional
        Address of the live page, below which pictures and clips of events are found.
    cameras : callable
        Returns what Home Assistant is told of the streams; asked again and again, by other threads.
    """

    def __init__(
        self,
        targets: Sequence[EventTarget] | None,
        folder: Path,
        say: Callable[[str], None],
        page: str | None = None,
        cameras: Callable[[], Sequence[Camera]] = tuple,
    ) -> None:
        self._targets = targets
        self._folder = folder
        self._say = say
        self._page = page
        self._cameras = cameras
        self._mail: Mail | None = None
        self._carriers: dict[str, Carrier] = {}
        self._leaving: dict[str, Carrier] = {}  # of targets that are gone, and may come back
        self._standings: dict[str, Standing] = {}  # as they were last known
        self._last: list[Backlog] | None = None  # as it was at the end
        self._lock = threading.Lock()  # one at a time takes events, or changes who gets them
        self._stop = threading.Event()
        self._looking = threading.Thread(target=self._look_again, daemon=True)

    def __enter__(self) -> Deliveries:
        if self._targets is not None:
            try:
                self.retarget(self._targets)
            except sqlite3.Error as error:
                self._stop.set()
                if self._mail is not None:
                    self._looking.join()
                    self._mail.outbox.close()
                path = self._folder / OUTBOX
                raise ConfigError(
                    f"--events: {path} cannot be written: {error}. See that its disk has room and allows it."
                ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        """Deliver what there is, for a limited time, and stop."""
        self._stop.set()
        if self._mail is None:
            return
        self._looking.join()
        self._mail.intake.look()
        until = time.monotonic() + _GRACE_SECONDS
        for carrier in self._carriers.values():
            carrier.finish()
        for carrier in self._carriers.values():
            carrier.close(until)
        self._last = self.backlogs()
        self._mail.outbox.close()
        for backlog in self._last:
            if backlog.waiting:
                self._say(
                    f"{count_of(backlog.waiting, 'event')} could not be delivered to {backlog.target}; the "
                    "same command with --resume tries again."
                )

    def retarget(self, targets: Sequence[EventTarget]) -> None:
        """Send to these targets from now on.

        A new one gets the events that happen from then on. One that is gone gets none any more, those that
        wait included. One with another filter or password goes on where it was, without the events that it
        does not want any more.

        Raises
        ------
        ConfigError
            If the outbox cannot be opened.
        sqlite3.Error
            If the disk does not allow it; then nothing has changed.
        """
        wanted = {target.key: target for target in targets}
        with self._lock:
            if self._mail is None:
                if not wanted and not (self._folder / OUTBOX).exists():
                    return
                self._mail = self._opened()
                self._looking.start()
            self._mail.intake.look()  # what has happened so far is for those who were there
            self._mail.outbox.retarget({key: target.wanted for key, target in wanted.items()})
            for key in self._carriers.keys() - wanted.keys():
                self._leaving[key] = self._carriers.pop(key)
                self._leaving[key].give_up()
            for key, target in wanted.items():
                if key in self._carriers:
                    self._carriers[key].replace(target)
                else:
                    before = self._leaving.pop(key, None)
                    self._carriers[key] = Carrier(target, self._free_name(target), self._mail, before)
                    self._carriers[key].start()

    def rename(self, before: str, now: str) -> None:
        """Give the folder of a stream another name; nothing of it is sent again.

        Raises
        ------
        OSError, sqlite3.Error
            If the disk does not allow it; then nothing is lost.
        """
        with self._lock:
            path = self._folder / OUTBOX
            if self._mail is not None:
                self._rename_with(self._mail.outbox, before, now)
            elif path.exists():
                with closing(Outbox(path)) as outbox:
                    self._rename_with(outbox, before, now)
            else:
                (self._folder / before).rename(self._folder / now)

    def copy_outbox(self, path: Path) -> bool:
        """Write what is still to be sent to another file; return whether there is an outbox.

        Raises
        ------
        OSError
            If the disk does not allow it.
        """
        with self._lock:
            there = self._folder / OUTBOX
            try:
                if self._mail is not None and self._last is None:
                    self._mail.outbox.copy_to(path)
                elif there.exists():
                    with closing(Outbox(there)) as outbox:
                        outbox.copy_to(path)
            except sqlite3.Error as error:
                raise OSError(f"{there} cannot be copied: {error}") from None
            return path.exists()

    def backlogs(self) -> list[Backlog]:
        """Return what each target has not acknowledged, as far as the disk can be read."""
        if self._mail is None or self._last is not None:
            return self._last or []
        found = []
        for key, carrier in list(self._carriers.items()):
            with suppress(sqlite3.Error):  # of what the disk does not tell, the last that it told
                self._standings[key] = self._mail.outbox.standing(key)
            standing = self._standings.get(key, Standing())
            found.append(Backlog(carrier.name, standing.waiting, carrier.away_since, standing.refused))
        return found

    def _rename_with(self, outbox: Outbox, before: str, now: str) -> None:
        outbox.rename(before, now)
        try:
            (self._folder / before).rename(self._folder / now)
        except OSError:
            outbox.rename(now, before)
            raise

    def _opened(self) -> Mail:
        path = self._folder / OUTBOX
        try:
            outbox = Outbox(path)
        except sqlite3.OperationalError as error:
            raise ConfigError(f"--events: {path} cannot be used: {error}.") from None
        except sqlite3.DatabaseError:
            aside = path.with_name(f"{path.name}.damaged")
            path.replace(aside)
            path.with_name(f"{path.name}-wal").unlink(missing_ok=True)  # it would be taken for the new one's
            self._say(f"{path} is damaged and was renamed to {aside.name}: events that waited are not sent.")
            outbox = Outbox(path)
        intake = Intake(self._folder, outbox, self._say)
        return Mail(self._folder, outbox, intake, self._say, self._page, self._cameras)

    def _free_name(self, target: EventTarget) -> str:
        """Return what a target is called; those that differ only in what is not shown are numbered."""
        taken = {carrier.name for carrier in self._carriers.values()}
        names = (target.shown if number == 1 else f"{target.shown} ({number})" for number in count(1))
        return next(name for name in names if name not in taken)

    def _look_again(self) -> None:
        while not self._stop.wait(_LOOK_SECONDS):
            with self._lock:
                if self._mail is not None and self._mail.intake.look():
                    for carrier in self._carriers.values():
                        carrier.wake()
