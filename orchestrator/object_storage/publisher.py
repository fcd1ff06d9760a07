"""Publishes a run's folder while the run goes on, in a thread; an outage of the store holds nothing up.

Every ten seconds the folder's state is held, what is new in it is written to the store, and then one
manifest makes it count. What is replaced or deleted is taken from the store a minute after the first manifest
that does not name it, for those who read. A publication that fails is tried again as it is; meanwhile the run
goes on in its folder.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from mlbs_actors.errors import SinkError
from orchestrator.object_storage.held_files import HeldFile, HeldFiles, LostFolderError
from orchestrator.object_storage.ledger import FencedError, Ledger
from orchestrator.object_storage.manifest import Part
from orchestrator.object_storage.store import ObjectStore, StoreError
from orchestrator.object_storage.uploads import Changes, Upload, plan
from orchestrator.retries import retry_seconds

__all__ = ["PUBLISH_SECONDS", "Publisher"]

#: From the end of one publication to the begin of the next, s.
PUBLISH_SECONDS = 10.0

#: For so long those who read an earlier manifest find what it names, s.
_GRACE_SECONDS = 60.0

_REQUESTS_AT_ONCE = 8

#: How long a run that is ended at once waits for the requests under way, s.
_ABANDON_SECONDS = 2.0

#: So often in a row a stream may not let itself be taken before that is told; commits can take that long.
_BUSY_FAILURES = 5


class _AbandonedError(Exception):
    """The run was ended at once."""


@dataclass(slots=True)
class _Garbage:
    """Objects that count no more, and since when."""

    since: float
    keys: list[str]


@dataclass(slots=True)
class _Named:
    """How many files each object is named by."""

    uses: Counter[str] = field(default_factory=Counter)

    def replace(self, before: Sequence[Part], after: Sequence[Part]) -> list[str]:
        """Follow a file that has other parts now; return the objects that no file needs any more."""
        self.uses.update(part.key for part in after)
        self.uses.subtract(part.key for part in before)
        unused = [key for key in dict.fromkeys(part.key for part in before) if not self.uses[key]]
        for key in unused:
            del self.uses[key]
        return unused


class Publisher:
    """Publishes one run.

    Parameters
    ----------
    store : ObjectStore
    ledger : Ledger
        Of this holder.
    held : HeldFiles
        Of the run's folder.
    address : str
        For messages.
    say : callable
        Takes a sentence for the user.
    copies : mapping of str to callable
        Names of files of the run that must not be read while they are in use → what writes a copy to a path,
        if there is one.
    clock : callable
        Monotonic time, s.
    """

    def __init__(
        self,
        store: ObjectStore,
        ledger: Ledger,
        held: HeldFiles,
        address: str,
        say: Callable[[str], None],
        copies: Mapping[str, Callable[[Path], bool]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store = store
        self._ledger = ledger
        self._held = held
        self._copies = copies
        self._address = address
        self._say = say
        self._clock = clock
        self._known: dict[str, HeldFile] = {}
        self._published = dict(ledger.files)
        self._named = _Named()
        for parts in self._published.values():
            self._named.replace((), parts)
        self._due: Changes | None = None
        self._written: set[str] = set()  # keys of that one
        self._number = 0
        self._garbage: deque[_Garbage] = deque()
        self._swept = False
        self._published_at: float | None = None
        self._away_since: float | None = None
        self._reason = ""
        self._fault: Exception | None = None
        self._ending, self._abandoned = threading.Event(), threading.Event()
        self._working = threading.Thread(target=self._work, daemon=True)

    def start(self) -> None:
        """Begin to publish."""
        self._working.start()

    @property
    def figures(self) -> dict[str, Any]:
        """How far the store is, for ``status.json``."""
        due = self._due
        waiting = () if due is None else [one for one in due.uploads if one.key not in self._written]
        return {
            "address": self._address,
            "published": None if self._published_at is None else _iso(self._published_at),
            "waiting_bytes": sum(upload.size for upload in waiting),
            "away_since": None if self._away_since is None else _iso(self._away_since),
            "reason": None if self._away_since is None else self._reason,
        }

    def check(self) -> None:
        """Raise SinkError if this run may not publish any more, or cannot."""
        if isinstance(self._fault, FencedError):
            raise SinkError(
                f"Another run has taken {self._address} over, as this one was away for a while, so it ends "
                "here. What it had published is kept; the other one goes on from there."
            )
        if isinstance(self._fault, LostFolderError):
            raise SinkError(f"{self._fault}")
        if self._fault is not None:
            raise SinkError(f"Publishing to {self._address} failed unexpectedly: {self._fault!r}.")

    def abandon(self) -> None:
        """Publish nothing more: what is published counts, and nobody is told that there will be no other."""
        self._abandoned.set()
        self._ending.set()
        self._working.join(_ABANDON_SECONDS)

    def finish(self, seconds: float) -> None:
        """Publish the last state, and say that there will be no other.

        Raises
        ------
        SinkError
            If that is not done within a time, or not possible.
        """
        self._ending.set()
        self._working.join(seconds)
        self._ledger.close()
        self.check()
        if self._working.is_alive():
            raise SinkError(
                f"Not all results could be published to {self._address}: "
                f"{self._reason or 'that takes long'}. They are kept on this machine; the same command with "
                "--resume publishes them."
            )

    def publish(self, *, last: bool = False) -> None:
        """Publish the state of now, or first the one that could not be published before.

        Raises
        ------
        FencedError, StoreError, OSError, SinkError
            If that did not succeed; the next call goes on with it.
        """
        if self._due is not None:
            self._complete(self._due, last=False)
        self._number += 1
        moment = time.time()
        taken = self._held.take(self._known, self._copies)
        number = f"{self._ledger.epoch}.{self._number}"
        self._due = plan(taken, self._known, self._published, self._held.path, number, moment)
        self._complete(self._due, last=last)
        self._collect(everything=last)

    def _complete(self, due: Changes, *, last: bool) -> None:
        """Write what is missing of a publication, and make it count."""
        try:
            self._upload(due.uploads)
        except OSError:  # what was held cannot be read: the next publication begins anew
            self._let_go(list(self._written))
            raise
        self._ledger.add(due.files, due.gone, ended=last)
        unused = []
        for name in (*due.files, *due.gone):
            after = due.files.get(name, ())
            unused += self._named.replace(self._published.pop(name, ()), after)
        self._published |= due.files
        self._known = dict(due.taken)
        self._published_at = due.moment
        self._let_go(unused)

    def _let_go(self, unused: list[str]) -> None:
        """Forget the publication that was due, and in a while these objects."""
        self._garbage.append(_Garbage(self._clock(), unused))
        self._due = None
        self._written = set()
        self._held.drop()

    def _upload(self, uploads: Sequence[Upload]) -> None:
        """Write those objects that are not written yet, until the first error.

        Not by a pool: its threads are waited for when the interpreter ends, whatever is left for them to do.
        """
        left = deque(one for one in uploads if one.key not in self._written)
        faults: list[BaseException] = []

        def write() -> None:
            with suppress(IndexError):  # nothing is left
                while not (faults or self._abandoned.is_set()):
                    self._write(left.popleft(), faults)

        count = min(_REQUESTS_AT_ONCE, len(left))
        threads = [threading.Thread(target=write, daemon=True) for _ in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if faults:
            raise faults[0]
        if left:
            raise _AbandonedError

    def _write(self, upload: Upload, faults: list[BaseException]) -> None:
        try:
            self._store.put(upload.key, upload.content(self._held.path))
            self._written.add(upload.key)
        except BaseException as error:  # for the thread that publishes
            faults.append(error)

    def _collect(self, *, everything: bool) -> None:
        """Delete objects that nobody needs; what is left of them the next start deletes."""
        until = self._clock() - _GRACE_SECONDS
        with suppress(StoreError):
            if not self._swept:
                self._store.delete(self._ledger.leftovers())
                self._swept = True
            while self._garbage and (everything or self._garbage[0].since <= until):
                self._store.delete(self._garbage[0].keys)
                self._garbage.popleft()

    def _work(self) -> None:
        failures = 0
        while True:
            if self._abandoned.is_set():
                return
            last = self._ending.is_set()
            try:
                self.publish(last=last)
            except _AbandonedError:
                return
            except LostFolderError as error:  # what is there later would not be the run either
                self._fault = error
                return
            except (StoreError, SinkError, OSError) as error:
                failures += 1
                self._note(error, failures)
            except Exception as error:  # FencedError, or what nobody has thought of
                self._fault = error
                return
            else:
                if self._away_since is not None:
                    self._say(f"{self._address} can be written again; all results are there.")
                failures, self._away_since, self._reason = 0, None, ""
                if last:
                    return
            self._ending.wait(retry_seconds(failures) if failures else PUBLISH_SECONDS)
            if failures and self._ending.is_set():
                time.sleep(retry_seconds(1))  # the event does not let anybody wait any more

    def _note(self, error: Exception, failures: int) -> None:
        self._reason = str(error).rstrip(".")
        if isinstance(error, SinkError) and failures < _BUSY_FAILURES:
            return
        if self._away_since is None and not self._abandoned.is_set():
            self._away_since = time.time()
            self._say(
                f"Nothing can be published to {self._address}: {self._reason}. The run goes on; its results "
                "wait on this machine."
            )


def _iso(moment: float) -> str:
    return datetime.fromtimestamp(moment, timezone.utc).isoformat(timespec="seconds")
