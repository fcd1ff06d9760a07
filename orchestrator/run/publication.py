"""A run whose output is an object store: what happens before it, beside it and after it."""

from __future__ import annotations

import secrets
import shutil
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from filelock import FileLock, Timeout

from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.log import Log
from orchestrator.object_storage.fetching import fetch_files
from orchestrator.object_storage.held_files import HeldFiles, LostFolderError
from orchestrator.object_storage.ledger import FencedError, Ledger, Standing, at_work, await_holder
from orchestrator.object_storage.publisher import Publisher
from orchestrator.object_storage.store import ObjectStore, StoreError, open_store
from orchestrator.options import Arguments
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState, has_ended
from orchestrator.storage.durable_files import replace_file

__all__ = ["Publication"]

#: How long the end of a run waits for the store, s; less if the run has not come to its end.
_PATIENCE_SECONDS, _IMPATIENCE_SECONDS = 600.0, 20.0

#: File with what tells the holder of this scratch folder from all others.
_HOLDER = "holder"

#: Name of a run's folder while it is deleted.
_GONE = "gone"


class Publication:
    """Publishes a run until the end of a ``with`` block; an observer of the driver.

    It does nothing at all if the output is a folder of this machine.
    """

    def __init__(self) -> None:
        self._hold = ExitStack()
        self._ledger: Ledger | None = None
        self._prepared: Callable[[Mapping[str, Callable[[Path], bool]]], Publisher] | None = None
        self._publisher: Publisher | None = None
        self._folder = Path()

    def begin(self, asked: Arguments) -> None:
        """Take the address over, and make the run's folder as it is in the store.

        If nobody else has published since this folder was left, it is at least as far, and stays as it is.

        Raises
        ------
        ConfigError
            If the store cannot be used, another run is at work there, or it has a run that is not to go on.
        """
        if asked.store is None:
            return
        log = Log(asked.log, str(asked.store))
        address, place = str(asked.store), asked.output.parent
        store = open_store(asked.store)
        try:
            me = self._held(place, address)
            self._begin(store, me, address, asked, log)
        except StoreError as error:
            raise ConfigError(
                f"--output {address} cannot be used: {error}. See that the address is right, and the "
                "credentials of the environment, and that the store can be reached."
            ) from None
        except OSError as error:
            raise ConfigError(
                f"{place} cannot be written to: {error.strerror or error}; name another folder with "
                "--scratch."
            ) from None

    @property
    def figures(self) -> dict[str, Any] | None:
        """How far the store is; None without one."""
        return None if self._publisher is None else self._publisher.figures

    def start(self, copies: Mapping[str, Callable[[Path], bool]]) -> None:
        """Publish from now on.

        Parameters
        ----------
        copies : mapping of str to callable
            Names of files of the run that must not be read while they are in use → what writes a copy to a
            path, if there is one.
        """
        if self._prepared is not None:
            self._publisher = self._prepared(copies)
            self._publisher.start()

    def update(self, states: Sequence[StreamState]) -> None:
        """End the run, by SinkError, if it may not publish any more."""
        if self._publisher is not None:
            self._publisher.check()

    def __enter__(self) -> Publication:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Publish the last state, unless the run is ended at once."""
        with self._hold:
            if not (kind is None or issubclass(kind, MlbsError)):
                if self._publisher is not None:
                    self._publisher.abandon()
                return
            if self._publisher is None:
                if self._ledger is not None:  # nothing has changed
                    with suppress(StoreError, FencedError):
                        self._ledger.add({}, (), ended=True)
                return
            self._publisher.finish(_PATIENCE_SECONDS if kind is None else _IMPATIENCE_SECONDS)
            states = RunFolder(self._folder).states().values()
            if kind is None and all(map(has_ended, states)):  # nothing is left to go on with
                with suppress(OSError):
                    _remove(self._folder)

    def _held(self, place: Path, address: str) -> str:
        """Keep other runs out of the scratch folder; return who holds it."""
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = FileLock(place / ".lock")
        try:
            self._hold.enter_context(lock.acquire(timeout=0))
        except Timeout:
            raise at_work(address, "on this machine") from None
        holder = place / _HOLDER
        if not holder.exists() or not holder.stat().st_size:
            replace_file(holder, f"{socket.gethostname()} {secrets.token_hex(8)}".encode())
        return holder.read_text(encoding="utf-8")

    def _begin(self, store: ObjectStore, me: str, address: str, asked: Arguments, log: Log) -> None:
        found = await_holder(store, me, address, log.say)
        if "run.json" in found.files and not asked.resume:
            raise ConfigError(
                f"{address} holds a run already; choose another address with --output, or continue that run "
                "with --resume."
            )
        self._folder = asked.output
        _remove_leftovers(self._folder.parent)
        # An address without a generation may have been emptied: then this folder is the only copy.
        if found.owner != me and found.generation > 0:
            _remove(self._folder)
        self._ledger = Ledger(store, found, me, address)
        self._hold.callback(self._ledger.close)
        if not self._folder.exists():
            self._fetch(store, found, log, address)
        held = HeldFiles(self._folder, self._folder.with_name("held"), found.files)
        try:
            held.check()
        except LostFolderError as error:
            raise ConfigError(f"{error}") from None
        self._prepared = partial(Publisher, store, self._ledger, held, address, log.warn)

    def _fetch(self, store: ObjectStore, found: Standing, log: Log, address: str) -> None:
        if found.files:
            size = sum(part.size for parts in found.files.values() for part in parts)
            log.say(
                f"Fetching what was published at {address}: {len(found.files)} files, {size / 1e6:,.0f} MB."
            )
        fetch_files(store, found.files, self._folder, durable=True)


def _remove(folder: Path) -> None:
    """Delete a run's folder; OSError if it is still there. A kill leaves all of it or nothing."""
    if folder.exists():
        gone = folder.with_name(_GONE)
        folder.rename(gone)
        shutil.rmtree(gone, ignore_errors=True)


def _remove_leftovers(place: Path) -> None:
    """Delete from the scratch folder what a kill has left of fetching and deleting."""
    for path in (place / _GONE, *place.glob(".*.part")):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
