"""Carries the events that wait for a target to it, one after the other, in a thread of its own.

An event that the target refuses is set aside, and the next one is sent.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, urlsplit

from orchestrator.events.home_assistant import Camera, HomeAssistant
from orchestrator.events.intake import Intake
from orchestrator.events.mqtt import Mqtt
from orchestrator.events.outbox import Outbox
from orchestrator.events.senders import DeliveryError, RefusedEventError, Sender, Webhook
from orchestrator.events.targets import MQTT_PORTS, EventTarget
from orchestrator.retries import retry_seconds

__all__ = ["Carrier", "Mail"]

#: File of the run's folder with what targets have refused.
_REFUSED = "events-refused.jsonl"

#: Between two looks at what Home Assistant is to be told, s.
_LOOK_SECONDS = 0.1

#: Longest wait of a target that came back for the end of what was still being sent to it, s.
_LEAVING_SECONDS = 60.0

#: Keys of an event that name a file of the stream's record, and those of its address.
_LINKS = {"picture": "picture_url", "clip": "clip_url"}


@dataclass(frozen=True, slots=True)
class Mail:
    """What the carriers of a run share.

    Attributes
    ----------
    folder : Path
        Of the run.
    outbox : Outbox
    intake : Intake
    say : callable
        Receives a sentence when a target goes away, when it is back, and when it refuses an event.
    page : str, optional
        Address of the live page.
    cameras : callable
        Returns what Home Assistant is told of the streams.
    """

    folder: Path
    outbox: Outbox
    intake: Intake
    say: Callable[[str], None]
    page: str | None
    cameras: Callable[[], Sequence[Camera]]


class Carrier:
    """Delivers to one target.

    Parameters
    ----------
    target : EventTarget
    name : str
        Of the target, without secrets.
    mail : Mail
    before : Carrier, optional
        One of the same target that was given up: it ends first, as the last that it does is to take back
        what it has told.

    Attributes
    ----------
    name : str
        Of the target, without secrets.
    away_since : float, optional
        When it stopped accepting events, seconds since 1970; None while it does.
    """

    def __init__(self, target: EventTarget, name: str, mail: Mail, before: Carrier | None = None) -> None:
        self.name = name
        self.away_since: float | None = None
        self._target = target
        self._key = target.key
        self._mail = mail
        self._before = before
        self._failures = 0
        # Place of an event that was sent, and whether it was refused.
        self._unnoted: tuple[int, bool] | None = None
        # What Home Assistant is told, behind what that was made of.
        self._told: tuple[object, dict[str, bytes]] = (None, {})
        self._is_gone = False
        self._news, self._hurry = threading.Event(), threading.Event()
        self._last_look, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin where an earlier one was."""
        self._thread.start()

    def wake(self) -> None:
        """Look for events now."""
        self._news.set()

    def replace(self, target: EventTarget) -> None:
        """Go on with another filter or password."""
        self._target = target
        self._hurry.set()

    def give_up(self) -> None:
        """Stop now, as the target gets nothing any more."""
        self._is_gone = True
        self._end()

    def finish(self) -> None:
        """Stop as soon as all is delivered."""
        self._last_look.set()
        self._news.set()

    def close(self, until: float) -> None:
        """Wait for that, until a time of the monotonic clock."""
        self._thread.join(max(until - time.monotonic(), 0.0))
        self._end()

    def _end(self) -> None:
        for event in (self._stop, self._hurry, self._news):
            event.set()

    def _run(self) -> None:
        if self._before is not None:
            self._before._thread.join(_LEAVING_SECONDS)
            self._before = None
        target = self._target
        home, sender = self._opened(target)
        while not self._stop.is_set():
            last = self._last_look.is_set()
            self._news.clear()
            if target != self._target:
                self._leave(sender, for_good=target.home_assistant != self._target.home_assistant)
                target = self._target
                home, sender = self._opened(target)
            try:
                is_empty = not self._carry_one(home, sender)
            except (DeliveryError, OSError, sqlite3.Error) as error:
                self._failed(str(error))
                continue
            self._succeeded()
            if is_empty and last:
                break
            if is_empty:
                self._news.wait(_LOOK_SECONDS)
        self._leave(sender, for_good=self._is_gone)

    def _opened(self, target: EventTarget) -> tuple[HomeAssistant | None, Sender]:
        if urlsplit(target.url).scheme not in MQTT_PORTS:
            return None, Webhook(target)
        home = None
        if target.home_assistant is not None:
            home = HomeAssistant(target, self._mail.folder, self._mail.page)
        self._told = None, {}
        return home, Mqtt(target, home)

    def _leave(self, sender: Sender, *, for_good: bool) -> None:
        if for_good and self._told[1]:
            with suppress(DeliveryError):
                sender.hold({})
        sender.close()

    def _carry_one(self, home: HomeAssistant | None, sender: Sender) -> bool:
        """Send the next event and note it; return whether there was one."""
        self._note()
        if home is not None:
            sender.hold(self._standing(home))
        found = self._mail.outbox.first(self._key)
        if found is None:
            return False
        place, line = found
        event = json.loads(line)
        self._unnoted = place, not self._is_accepted(event, sender)
        self._note()
        return True

    def _note(self) -> None:
        """Note what was sent; if the disk does not allow it, before anything else is."""
        if self._unnoted is not None:
            place, is_refused = self._unnoted
            self._mail.outbox.done(self._key, place, refused=is_refused)
            self._unnoted = None

    def _standing(self, home: HomeAssistant) -> Mapping[str, bytes]:
        cameras, censuses = tuple(self._mail.cameras()), dict(self._mail.intake.censuses)
        if self._told[0] != (cameras, censuses):
            self._told = (cameras, censuses), home.standing(cameras, censuses)
        return self._told[1]

    def _is_accepted(self, event: dict[str, object], sender: Sender) -> bool:
        try:
            sender.send(json.dumps(event | self._links(event)).encode())
        except RefusedEventError as error:
            standing = self._mail.outbox.standing(self._key)
            if not (error.is_certain or standing.accepted or standing.refused):
                raise
            self._set_aside(event, str(error), is_first=standing.refused == 0)
            return False
        return True

    def _links(self, event: Mapping[str, object]) -> dict[str, str]:
        if self._mail.page is None:
            return {}
        records = f"{self._mail.page.rstrip('/')}/records/{quote(str(event['stream']), safe='')}"
        return {link: f"{records}/{quote(str(event[key]))}" for key, link in _LINKS.items() if event.get(key)}

    def _set_aside(self, event: Mapping[str, object], answer: str, *, is_first: bool) -> None:
        """Keep an event that will never be accepted where the operator finds it; say so the first time."""
        line = {"target": self.name, "answer": answer, "event": event}
        with (self._mail.folder / _REFUSED).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        if is_first:
            self._mail.say(
                f"{self.name} refuses an event: {answer.rstrip('.')}. It is set aside in {_REFUSED}, and so "
                "will be others; the next one is sent."
            )

    def _failed(self, reason: str) -> None:
        if self._stop.is_set():
            return  # nobody waits for it any more, and the outbox may be closed
        self._failures += 1
        if self._failures == 1:
            self.away_since = time.time()
            words = reason.rstrip(".")
            self._mail.say(f"Events cannot be delivered to {self.name}: {words}. It is tried again.")
        self._hurry.wait(retry_seconds(self._failures))
        if not self._stop.is_set():
            self._hurry.clear()

    def _succeeded(self) -> None:
        if self._failures:
            self._mail.say(f"Events are delivered to {self.name} again.")
        self._failures, self.away_since = 0, None
