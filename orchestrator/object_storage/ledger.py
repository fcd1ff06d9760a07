"""Who may publish: the chain of manifests, to which one holder adds at a time.

Every generation is written only if there is none of its number yet, which the store decides. So a chain never
forks: a start that takes an address over begins with the next generation, and whoever held it before finds
that number taken with its next one, and is *fenced*: it has lost the address and publishes nothing more. No
clock decides that. The same chain is the lease: a holder adds a generation at least every ten seconds, even
if nothing has changed; one that added none for thirty is taken to be dead.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field

from mlbs_actors.errors import ConfigError
from orchestrator.object_storage.manifest import (
    MANIFESTS,
    OBJECTS,
    Manifest,
    Part,
    epoch_of,
    manifest_key,
)
from orchestrator.object_storage.store import MissingObjectError, ObjectStore, StoreError

__all__ = [
    "BEAT_SECONDS",
    "EXPIRY_SECONDS",
    "FencedError",
    "Ledger",
    "Standing",
    "await_holder",
    "read_standing",
]

#: The most time between two generations of a holder, s.
BEAT_SECONDS = 10.0

#: A holder that has added none for so long is dead, s.
EXPIRY_SECONDS = 30.0

#: Between two looks at a holder, s.
_LOOK_SECONDS = 1.0

#: Generations after which there is a full one again.
_FULL_EVERY = 100

#: How often reading is begun anew, because what was to be read has been replaced meanwhile.
_ATTEMPTS = 10

_REQUESTS_AT_ONCE = 8


class FencedError(Exception):
    """Another holder has taken the address over."""


@dataclass(frozen=True, slots=True)
class Standing:
    """What counts at an address.

    Attributes
    ----------
    generation : int
        0 if there is none.
    owner : str
        Who published it.
    ended : bool
        Whether that one publishes no more.
    files : mapping of str to sequence of Part
        Path in the run's folder → its content.
    """

    generation: int = 0
    owner: str = ""
    ended: bool = True
    files: Mapping[str, Sequence[Part]] = field(default_factory=dict)


def read_standing(store: ObjectStore) -> Standing:
    """Read what counts now; StoreError if the store cannot be read."""
    for _ in range(_ATTEMPTS):
        keys = store.keys(MANIFESTS)
        if not keys:
            return Standing()
        try:
            newest = _manifest(store, keys[-1])
            older = map(manifest_key, range(newest.since, newest.generation))
            with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
                manifests = [*pool.map(lambda key: _manifest(store, key), older), newest]
        except MissingObjectError:
            continue  # a full one has replaced them
        files: dict[str, Sequence[Part]] = {}
        for manifest in manifests:
            for path in manifest.gone:
                files.pop(path, None)
            files.update(manifest.files)
        return Standing(newest.generation, newest.owner, newest.ended, files)
    raise StoreError("its manifests are replaced faster than they can be read")


def _manifest(store: ObjectStore, key: str) -> Manifest:
    """Read a manifest; StoreError if it is none."""
    try:
        return Manifest.read(store.get(key))
    except ValueError as error:
        raise StoreError(f"{key} cannot be read: {error}") from None


def await_holder(
    store: ObjectStore,
    me: str,
    address: str,
    say: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
) -> Standing:
    """Return what counts once nobody else is at work there.

    Parameters
    ----------
    store : ObjectStore
    me : str
        The holder to be, who need not wait for itself.
    address : str
        For messages.
    say : callable
        Takes a sentence for the user.
    sleep : callable

    Raises
    ------
    ConfigError
        If another one is.
    StoreError
    """
    found = read_standing(store)
    if found.ended or found.owner == me:
        return found
    say(
        f"The run at {address} was not ended by {found.owner}; it is taken over unless something is "
        f"published there within {EXPIRY_SECONDS:.0f} s."
    )
    waited = 0.0
    while waited < EXPIRY_SECONDS:
        sleep(_LOOK_SECONDS)
        waited += _LOOK_SECONDS
        if store.keys(MANIFESTS, manifest_key(found.generation)):
            found = read_standing(store)
            if found.ended:
                return found
            raise at_work(address, found.owner)
    return found


def at_work(address: str, owner: str) -> ConfigError:
    """Return what says that another run publishes at an address."""
    return ConfigError(
        f"Another run is at work at {address} ({owner}); wait for its end, or choose another address with "
        "--output."
    )


class Ledger:
    """The chain of an address, taken over by this holder; several threads may add to it.

    Making one writes the first generation of its epoch, a full one. From then on it adds one at least every
    ten seconds, until it is closed or fenced.

    Parameters
    ----------
    store : ObjectStore
    found : Standing
        What counts, from :func:`await_holder`.
    me : str
        Tells this holder from all others.
    address : str
        For messages.
    clock : callable
        Monotonic time, s.

    Attributes
    ----------
    epoch : int
    files : dict of str to sequence of Part
        What counts now.

    Raises
    ------
    ConfigError
        If another start was faster, or the store does not keep to the condition.
    StoreError
    """

    def __init__(
        self,
        store: ObjectStore,
        found: Standing,
        me: str,
        address: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store = store
        self._me = me
        self._clock = clock
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._fenced = False
        self.files = dict(found.files)
        self.epoch = self._generation = self._since = found.generation + 1
        first = Manifest(self.epoch, self.epoch, me, False, self.epoch, self.files)
        key = manifest_key(self.epoch)
        if not store.create(key, first.content()) and _manifest(store, key) != first:
            raise at_work(address, read_standing(store).owner)
        if store.create(key, first.content()):
            raise ConfigError(
                f"The store of {address} knows no conditional writes ('If-None-Match: *' has no effect), so "
                "two runs could not be kept apart; use another one, or a folder."
            )
        self._added_at = clock()
        self._beating = threading.Thread(target=self._beat, daemon=True)
        self._beating.start()

    def add(self, files: Mapping[str, Sequence[Part]], gone: Iterable[str], *, ended: bool = False) -> None:
        """Make it count that files have changed and others are gone; with ``ended`` as the last word.

        Raises
        ------
        FencedError
            If another holder has taken the address over; nothing has changed.
        StoreError
            If it is not certain whether it counts; it may be added again.
        """
        with self._lock:
            self._add(files, tuple(gone), ended=ended)
            if ended:
                self._closed.set()

    def close(self) -> None:
        """Add nothing more."""
        self._closed.set()
        self._beating.join(_LOOK_SECONDS)  # longer only in a request that hangs

    def leftovers(self) -> list[str]:
        """Return the keys of objects of earlier epochs that count no more."""
        with self._lock:
            named = {part.key for parts in self.files.values() for part in parts}
        before = [key for key in self._store.keys(MANIFESTS) if key < manifest_key(self.epoch)]
        for key in self._store.keys(OBJECTS):
            epoch = epoch_of(key)
            if key not in named and epoch is not None and epoch < self.epoch:
                before.append(key)
        return before

    def _add(self, files: Mapping[str, Sequence[Part]], gone: tuple[str, ...], *, ended: bool) -> None:
        if self._fenced:
            raise FencedError
        while True:
            generation = self._generation + 1
            if generation - self._since < _FULL_EVERY:
                wanted = Manifest(generation, self.epoch, self._me, ended, self._since, files, gone)
            else:
                after = self.files | dict(files)
                for path in gone:
                    after.pop(path, None)
                wanted = Manifest(generation, self.epoch, self._me, ended, generation, after)
            key = manifest_key(generation)
            if not self._store.create(key, wanted.content()):
                there = _manifest(self._store, key)
                if there.owner != self._me or there.epoch != self.epoch:
                    self._fenced = True
                    raise FencedError
                if there != wanted:
                    # One of ours of which we had not heard that it was written.
                    self._follow(there)
                    continue
            self._follow(wanted)
            return

    def _follow(self, newest: Manifest) -> None:
        """Note what counts now that a generation is there."""
        self._generation = newest.generation
        self._added_at = self._clock()
        if newest.since != newest.generation:
            for path in newest.gone:
                self.files.pop(path, None)
            self.files.update(newest.files)
            return
        self.files = dict(newest.files)
        before, self._since = self._since, newest.since
        with suppress(StoreError):  # the next full one does it, or the next start
            # One full generation more than needed is left to those who are reading.
            self._store.delete([key for key in self._store.keys(MANIFESTS) if key < manifest_key(before)])

    def _beat(self) -> None:
        while not self._closed.wait(_LOOK_SECONDS):
            with self._lock:
                if self._closed.is_set() or self._clock() - self._added_at < BEAT_SECONDS:
                    continue
                try:
                    self._add({}, (), ended=False)
                except StoreError:
                    continue  # publishing says so
                except FencedError:
                    return
